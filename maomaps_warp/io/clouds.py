"""Point clouds in files: PCD, PLY, text and NPZ."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.cloud_writing import write_cloud, write_xyz
from maomaps_warp.io.pcd import is_pcd, read_pcd, write_pcd
from maomaps_warp.io.ply import read_ply
from maomaps_warp.io.tables import HEAD_BYTES, column_count, not_of_kind, read_bytes, read_table, signature
from maomaps_warp.io.trajectories import TRAJECTORY_NAMES, are_byte_values, recognise_trajectory
from maomaps_warp.model.cloud import PointCloud

__all__ = ["CloudFormat", "read_cloud", "recognise_cloud", "write_cloud", "write_pcd", "write_xyz"]

CloudFormat = Literal["pcd", "ply", "xyz", "npz"]

#: What a reader finds: points, (N, 3) float64 metres, NaN included; colours, (N, 3) of the file's own type, or None;
#: notes on what was not used.
Parts = tuple[NDArray[np.float64], NDArray[np.generic] | None, tuple[str, ...]]

_FORMATS_HINT = "clouds are PCD, PLY, text (x y z a row, r g b and more may follow) or NPZ"


def read_cloud(path: Path, *, format: CloudFormat | Literal["auto"] = "auto") -> PointCloud:
    """Reads a point cloud.

    Args:
        path: the file.
        format: "auto" recognises it by its content, not by its name.

    Returns:
        At least one point. Points that are NaN or infinite are dropped and counted; colours are None where
        the file has none or they are not understood, which a note says.

    Raises:
        InputError: the file is no cloud, not one of this format, damaged or empty.
    """
    path = Path(path)
    if format not in ("auto", *_READERS):
        raise ValueError(f"format must be auto or one of {', '.join(_READERS)}, got {format!r}")
    # A text of six columns has to be read whole to be recognised; whoever names it xyz spares that.
    found = "xyz" if format == "xyz" else recognise_cloud(path)
    if found is None and format == "auto":
        raise _not_a_cloud(path)
    if found is None or format not in ("auto", found):
        raise _another_format(path, format, found)
    points, colors, notes = _READERS[found](path)
    return _finished(path, points, colors, notes)


def recognise_cloud(path: Path) -> CloudFormat | None:
    """The format of a point cloud by its content, or None if it is none (or a folder).

    Texts that `recognise_trajectory` takes for poses are no clouds.

    Raises:
        InputError: the file cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        return None
    head = read_bytes(path, HEAD_BYTES)
    if is_pcd(head):
        return "pcd"
    if head.startswith((b"ply\n", b"ply\r")):
        return "ply"
    if head.startswith((b"PK\x03\x04", b"\x93NUMPY")):
        return "npz"
    shape = column_count(head)
    if shape is None or shape[0] < 3 or recognise_trajectory(path) is not None:
        return None
    return "xyz"


def _read_xyz(path: Path) -> Parts:
    table = read_table(path, is_map=True)
    columns = table.values.shape[1]
    if columns < 3:
        raise InputError(table.where(0), f"{columns} values a row, but a point has 3", _FORMATS_HINT)
    points, rest = table.values[:, :3], table.values[:, 3:]
    if columns >= 6 and are_byte_values(rest[:, :3]):
        notes = (f"columns 4 to 6 are colours; {columns - 6} more columns are not used",) if columns > 6 else ()
        return points, rest[:, :3].astype(np.uint8), notes
    return (
        points,
        None,
        (f"{columns - 3} columns after x y z are not colours and are not used",) if columns > 3 else (),
    )


#: What NumPy, and the archive and the header's parser beneath it, raise for damaged files.
_NPZ_ERRORS = (
    *(ValueError, OSError, EOFError, KeyError, MemoryError, OverflowError, RuntimeError, SyntaxError),
    *(struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error),
)


def _read_npz(path: Path) -> Parts:
    try:
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            is_lone = isinstance(loaded, np.ndarray)
            arrays = {"points": loaded} if is_lone else {name: loaded[name] for name in loaded.files}
    except _NPZ_ERRORS as error:
        raise InputError(path, f"cannot be read as NPZ: {error}", "write it by np.savez(file, points=...)") from None
    name = next((key for key in ("points", "xyz") if key in arrays), None)
    if name is None and len(arrays) == 1:
        name = next(iter(arrays))
    if name is None:
        raise InputError(path, f"NPZ with {', '.join(arrays) or 'no arrays'}", "an array `points` (N, 3) is needed")
    points = arrays[name]
    if not _is_numeric(points) or points.ndim != 2 or points.shape[1] < 3:
        found = f"array {name} is {getattr(points, 'shape', '')} {getattr(points, 'dtype', 'no array')}"
        raise InputError(path, found, "an array `points` (N, 3) of numbers is needed")
    colors = arrays.get("colors")
    if colors is not None and (not _is_numeric(colors) or colors.shape != (len(points), 3)):
        raise InputError(path, f"array colors is {colors.shape} {colors.dtype}", f"({len(points)}, 3) is needed")
    extra = points.shape[1] - 3
    notes = (f"{extra} columns of array {name} after x y z are not used",) if extra else ()
    with np.errstate(invalid="ignore"):  # a signalling NaN may warn; all NaN are counted later
        return points[:, :3].astype(np.float64), colors, notes


_READERS: dict[str, Callable[[Path], Parts]] = {
    "pcd": read_pcd,
    "ply": read_ply,
    "xyz": _read_xyz,
    "npz": _read_npz,
}


def _is_numeric(array: object) -> bool:
    return isinstance(array, np.ndarray) and array.dtype.kind in "iuf"


def _finished(
    path: Path, points: NDArray[np.float64], colors: NDArray[np.generic] | None, notes: tuple[str, ...]
) -> PointCloud:
    dropped = 0
    if not np.isfinite(points).all():
        finite = np.isfinite(points).all(axis=1)
        dropped = len(points) - int(finite.sum())
    if dropped == len(points):
        found = f"all of its {dropped} points are NaN or infinite" if dropped else "holds no points"
        raise InputError(path, found, "a map needs at least one point")
    if dropped:
        notes = (*notes, f"{dropped} of {len(points)} points are NaN or infinite and were dropped")
        points, colors = points[finite], None if colors is None else colors[finite]
    bytes_ = None if colors is None else _byte_colors(colors)
    if colors is not None and bytes_ is None:
        notes = (*notes, f"colours ({colors.dtype}) lie neither in 0..255 nor in 0..1 and were not used")
    return PointCloud(np.ascontiguousarray(points), bytes_, dropped, str(path), notes=notes)


def _byte_colors(colors: NDArray[np.generic]) -> NDArray[np.uint8] | None:
    """(N, 3) uint8: whole numbers 0..255 as they are, fractions 0..1 times 255; None if they are neither."""
    if colors.dtype == np.uint8:
        return np.array(colors, np.uint8)
    values = colors.astype(np.float64)
    if colors.dtype.kind == "f" and bool(((values >= 0) & (values <= 1)).all()):
        return np.rint(values * 255).astype(np.uint8)
    return values.astype(np.uint8) if are_byte_values(values) else None


def _another_format(path: Path, format: str, found: CloudFormat | None) -> InputError:
    looks = f"a {found.upper()} cloud" if found else signature(read_bytes(path, HEAD_BYTES)) or "something else"
    return InputError(
        path,
        f"is not a {format.upper()} file; it looks like {looks}",
        f"{_FORMATS_HINT}; or leave it to auto",
    )


def _not_a_cloud(path: Path) -> InputError:
    trajectory = recognise_trajectory(path)
    if trajectory is not None:
        found = f"looks like poses ({TRAJECTORY_NAMES[trajectory]} trajectory), not a point cloud"
        return InputError(path, found, "if it is a cloud, name the format xyz")
    return not_of_kind(path, "a point cloud", _FORMATS_HINT)
