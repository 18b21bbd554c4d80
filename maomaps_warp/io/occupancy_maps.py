"""Maps of the ground as files: the pairs of ROS's map_server (YAML and image), and PNG images."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import recognise_bag
from maomaps_warp.io.bags import open_contents
from maomaps_warp.io.bags.occupancy import read_bag_grid
from maomaps_warp.io.file_sets import check_file_set, write_file_set
from maomaps_warp.io.map_server import read_map_server
from maomaps_warp.io.outputs import write_whole
from maomaps_warp.model.occupancy import Cell, OccupancyGrid

_YAML_SUFFIXES = (".yaml", ".yml")
_IMAGE_SUFFIXES = (".pgm", ".png", ".ppm", ".pnm", ".bmp", ".tif", ".tiff", ".jpg", ".jpeg", ".gif")
#: Values of unknown, free and occupied cells: in the original program's images, and in those of map_server.
_PNG_VALUES = {Cell.UNKNOWN: 127, Cell.FREE: 255, Cell.OCCUPIED: 0}
_PGM_VALUES = {Cell.UNKNOWN: 205, Cell.FREE: 254, Cell.OCCUPIED: 0}

ACCEPTED = "a map of the ground is the .yaml of a map_server pair, or a bag with a nav_msgs/OccupancyGrid"


def read_occupancy(path: Path, topics: Sequence[str] = (), topic_option: str = "--topic") -> OccupancyGrid:
    """Read a map of the ground: a map_server pair by its YAML file, or a bag's OccupancyGrid.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        topics: names of a bag's topics that the user gave.
        topic_option: how the command line calls the option that names topics, for errors.

    Raises:
        InputError: something else, or damaged.
    """
    if recognise_bag(path):
        with open_contents(path, topics, topic_option, with_grids=True) as contents:
            return read_bag_grid(contents)
    if topics:
        raise InputError(f"{topic_option} {topics[0]}", f"{path}: not a bag", "topics are only in bags")
    if not path.exists():
        raise InputError(path, "no such file or folder", ACCEPTED)
    if path.suffix.lower() in _YAML_SUFFIXES:
        return read_map_server(path)
    if path.suffix.lower() in _IMAGE_SUFFIXES:
        beside = [path.with_suffix(suffix) for suffix in _YAML_SUFFIXES]
        yaml = next((file for file in beside if file.is_file()), None)
        found = "an image alone does not say how large its cells are, where they lie, and which values are occupied"
        hint = (
            f"give {yaml}" if yaml else f"give the .yaml of the map_server pair; there is no {beside[0].name} beside it"
        )
        raise InputError(path, found, hint)
    raise InputError(path, "is no map of the ground", ACCEPTED)


def holds_occupancy(path: Path, topics: Sequence[str] = (), topic_option: str = "--topic") -> bool:
    """Whether a path is, or is meant as, a map of the ground: else it may be a 3D map.

    A YAML file and an image always are; a bag is if it has an OccupancyGrid and no topic of another kind was named.

    Raises:
        InputError: a damaged bag, or one without a named topic.
    """
    if recognise_bag(path):
        with open_contents(path, topics, topic_option, with_grids=True) as contents:
            return bool(contents.named("grids") if topics else contents.grids)
    return path.suffix.lower() in (*_YAML_SUFFIXES, *_IMAGE_SUFFIXES)


def png_values(grid: OccupancyGrid) -> NDArray[np.uint8]:
    """The image of a grid in the original program's values, (H, W) uint8; row 0 has the highest y."""
    return _values(grid, _PNG_VALUES)


def write_png(path: Path, grid: OccupancyGrid) -> None:
    """Write the image of a grid: 127 unknown, 255 free, 0 occupied, one pixel a cell, the highest y on top.

    Raises:
        InputError: the file cannot be written.
    """
    from PIL import Image

    with write_whole(path, "wb") as file:
        Image.fromarray(png_values(grid)).save(file, format="PNG")


def write_map_server(path: Path, grid: OccupancyGrid, *, overwrite: bool = False) -> tuple[Path, Path]:
    """Write the pair that ROS's map_server reads; both files or none.

    Args:
        path: the YAML file, NAME.yaml; the image is NAME.pgm beside it.
        grid: the map.
        overwrite: replace what stands there; else it is refused.

    Returns:
        Both paths, the YAML file first.

    Raises:
        InputError: a file exists, or cannot be written.
    """
    if path.suffix not in _YAML_SUFFIXES:
        raise ValueError(f"path: expected NAME.yaml, got {path}")
    image = path.with_suffix(".pgm")
    with write_file_set(path.parent, (path.name, image.name), overwrite=overwrite) as folder:
        _write_pair(folder / path.name, folder / image.name, grid)
    return path, image


def projection_files(stem: Path) -> tuple[Path, Path, Path]:
    """The files of `write_projection`: NAME.png, NAME.yaml, NAME.pgm."""
    png, yaml, pgm = (stem.with_name(stem.name + suffix) for suffix in (".png", ".yaml", ".pgm"))
    return png, yaml, pgm


def check_projection(stem: Path, *, overwrite: bool = False) -> None:
    """Find out, before a long computation, whether `write_projection` could begin.

    Raises:
        InputError: as `write_projection`.
    """
    if not stem.name:
        raise InputError(f"--output {stem}", "names no files", "give a name inside the folder, as map")
    if stem.suffix.lower() in (*_YAML_SUFFIXES, *_IMAGE_SUFFIXES):
        hint = f"give {stem.with_suffix('')}: the endings .png, .yaml and .pgm are added"
        raise InputError(stem, "ends like one of the files that are written", hint)
    check_file_set(stem.parent, [file.name for file in projection_files(stem)], overwrite=overwrite)


def write_projection(stem: Path, grid: OccupancyGrid, *, overwrite: bool = False) -> tuple[Path, Path, Path]:
    """Write a grid as PNG and as the pair of map_server: all three files or none.

    Args:
        stem: their path without the ending.
        grid: the map.
        overwrite: replace what stands there; else it is refused.

    Returns:
        NAME.png, NAME.yaml, NAME.pgm.

    Raises:
        InputError: a file exists, or cannot be written, or the stem ends like one of them.
    """
    check_projection(stem, overwrite=overwrite)
    files = projection_files(stem)
    with write_file_set(stem.parent, [file.name for file in files], overwrite=overwrite) as folder:
        png, yaml, pgm = (folder / file.name for file in files)
        write_png(png, grid)
        _write_pair(yaml, pgm, grid)
    return files


def _write_pair(yaml: Path, image: Path, grid: OccupancyGrid) -> None:
    values = _values(grid, _PGM_VALUES)
    with write_whole(image, "wb") as file:
        file.write(f"P5\n{values.shape[1]} {values.shape[0]}\n255\n".encode())
        file.write(values.tobytes())
    name = image.name if re.fullmatch(r"[A-Za-z][\w.-]*", image.name, re.ASCII) else json.dumps(image.name)
    with write_whole(yaml) as file:
        file.write(f"image: {name}\n")
        file.write("mode: trinary\n")
        file.write(f"resolution: {_decimal(grid.resolution)}\n")
        file.write(f"origin: [{', '.join(map(_decimal, grid.origin))}]\n")
        file.write("negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n")


def _values(grid: OccupancyGrid, values: dict[Cell, int]) -> NDArray[np.uint8]:
    table = np.array([values[cell] for cell in Cell], dtype=np.uint8)
    return np.ascontiguousarray(table[grid.cells[::-1]])


def _decimal(value: float) -> str:
    """A number that YAML 1.1 and 1.2 read back exactly: 1e-05, without a point, is a text to the first."""
    return str(np.format_float_positional(value, trim="0"))
