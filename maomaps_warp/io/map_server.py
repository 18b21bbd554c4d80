"""Reading the pairs of ROS's map_server: a YAML file and the image that it names."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.model.occupancy import Cell, OccupancyGrid

MODES = ("trinary", "scale", "raw")
_REQUIRED = ("image", "resolution", "origin", "occupied_thresh", "free_thresh")
_EXAMPLE = "a map_server file has image, resolution, origin, negate, occupied_thresh, free_thresh and maybe mode"
#: Pillow's names of images of 8 bits a channel: grey, colours, palettes, black and white, with alpha or without.
_IMAGE_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")


@dataclass(frozen=True)
class _Description:
    """What a map_server file says.

    Attributes:
        image: the image, as a path.
        resolution: edge of a cell, metres.
        origin: x, y, metres, and yaw, radians, of the outer corner of the image's lower left pixel.
        negate: whether bright pixels are occupied.
        occupied, free: thresholds of the probability of being occupied, 0..1.
        mode: one of MODES.
    """

    image: Path
    resolution: float
    origin: tuple[float, float, float]
    negate: bool
    occupied: float
    free: float
    mode: str


def read_map_server(path: Path) -> OccupancyGrid:
    """Read a map_server pair.

    Of a pixel of value v the probability of being occupied is (255 - v) / 255, or v / 255 if negated; colours are
    averaged. Above occupied_thresh a cell is occupied, below free_thresh free, between them unknown, in the mode
    "scale" too, whose probabilities between are neither. In the mode "raw" v, or 255 - v if negated, is the
    probability in per cent, and above 100 unknown. A transparent pixel is unknown in every mode.

    Args:
        path: the YAML file; a relative path of the image starts in its folder.

    Raises:
        InputError: a file is absent or damaged, or a field is missing or impossible.
    """
    told = _description(path)
    values, is_opaque = _pixels(told.image, path)
    shown = 255.0 - values if told.negate else values
    occupied = shown / 100.0 if told.mode == "raw" else (255.0 - shown) / 255.0
    known = is_opaque & (shown <= 100.0) if told.mode == "raw" else is_opaque
    cells = np.full(values.shape, Cell.UNKNOWN, dtype=np.uint8)
    cells[known & (occupied < told.free)] = Cell.FREE
    cells[known & (occupied > told.occupied)] = Cell.OCCUPIED
    notes: tuple[str, ...] = ()
    if not is_opaque.all():
        notes = (f"{np.count_nonzero(~is_opaque)} transparent pixels are unknown",)
    return OccupancyGrid(np.ascontiguousarray(cells[::-1]), told.resolution, told.origin, str(path), notes=notes)


def _description(path: Path) -> _Description:
    document = _yaml(path)
    if not isinstance(document, Mapping) or "image" not in document:
        raise InputError(path, "is not the YAML file of a map_server pair", _EXAMPLE)
    missing = [name for name in _REQUIRED if name not in document]
    if missing:
        raise InputError(path, f"no {', '.join(missing)}", _EXAMPLE)
    image, mode = document["image"], document.get("mode", "trinary")
    if not isinstance(image, str) or not image:
        raise InputError(path, f"image: {image!r} is no file name", _EXAMPLE)
    if mode not in MODES:
        raise InputError(path, f"mode: {mode!r}", f"allowed: {', '.join(MODES)}")
    negate = document.get("negate", 0)
    if negate not in (0, 1):
        raise InputError(path, f"negate: {negate!r}", "allowed: 0 and 1")
    origin = document["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise InputError(path, f"origin: {origin!r}", "x, y and yaw are expected, as [0.0, 0.0, 0.0]")
    x, y, yaw = (_number(path, "origin", value) for value in origin)
    resolution = _number(path, "resolution", document["resolution"])
    if resolution <= 0:
        raise InputError(path, f"resolution: {resolution:g}", "the edge of a cell in metres, above 0")
    occupied, free = (_number(path, name, document[name]) for name in ("occupied_thresh", "free_thresh"))
    if not 0 <= free <= occupied <= 1:
        found = f"free_thresh {free:g}, occupied_thresh {occupied:g}"
        raise InputError(path, found, "0 <= free_thresh <= occupied_thresh <= 1 is expected")
    return _Description(path.parent / image, resolution, (x, y, yaw), bool(negate), occupied, free, mode)


def _yaml(path: Path) -> Any:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        return YAML(typ="safe").load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, YAMLError, ValueError, RecursionError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(path, f"not a YAML file: {reason}", _EXAMPLE) from error


def _number(path: Path, name: str, value: object) -> float:
    try:
        number = math.nan if isinstance(value, bool) or not isinstance(value, int | float) else float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(path, f"{name}: {repr(value)[:60]} is no number", _EXAMPLE)
    return number


def _pixels(path: Path, yaml: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The mean of a pixel's colours, (H, W) float64, 0..255, row 0 on top; and whether it is opaque, (H, W) bool."""
    from PIL import Image
    from PIL.Image import DecompressionBombError

    if not path.is_file():
        raise InputError(yaml, f"its image {path} does not exist", "the image's path starts in the folder of the .yaml")
    try:
        image = Image.open(io.BytesIO(path.read_bytes()))
        image.load()
    # Pillow's decoders raise all of these for damaged data, SyntaxError for a broken PNG chunk included.
    except (OSError, SyntaxError, ValueError, EOFError, struct.error, IndexError, OverflowError) as error:
        raise InputError(path, f"the image cannot be read: {error}", "it is damaged or not an image") from error
    except DecompressionBombError as error:
        raise InputError(path, f"the image is too large: {error}") from error
    if image.mode not in _IMAGE_MODES:
        raise InputError(path, f"pixels of the kind {image.mode}", "a map has 8 bits a channel, grey or RGB")
    channels = np.asarray(image.convert("RGBA"))
    return channels[..., :3].mean(axis=2), channels[..., 3] == 255
