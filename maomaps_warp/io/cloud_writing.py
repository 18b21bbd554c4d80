"""Point clouds into files: text, PLY, NPZ; PCD is in `pcd`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.outputs import write_whole
from maomaps_warp.io.pcd import FLOAT32_REACH_M, write_pcd
from maomaps_warp.io.text_rows import text_rows


def write_cloud(path: Path, points: NDArray[np.float64], colors: NDArray[np.uint8] | None = None) -> None:
    """Writes a cloud in the format that the path's suffix names.

    - `.pcd`: binary, float32, or float64 where a coordinate exceeds FLOAT32_REACH_M; colours as PCL packs them.
    - `.ply`: binary little endian, float64, colours as three bytes.
    - `.txt`, `.xyz`: `x y z` a line, or `x y z r g b`, in the fewest digits that give the float64 back.
    - `.npz`: arrays `points` float64 and `colors` uint8.

    The same cloud gives the same bytes.

    Args:
        path: the file.
        points: (N, 3) float64, metres.
        colors: (N, 3) uint8 RGB, or None.

    Raises:
        InputError: another suffix, or the file cannot be written.
    """
    write = _WRITERS[cloud_suffix(path)]
    if colors is not None and colors.shape != points.shape:
        raise ValueError(f"colors must be {points.shape}, got {colors.shape}")
    write(path, points, colors)


def cloud_suffix(path: Path) -> str:
    """The suffix of a cloud's file to be, in small letters, one of those that `write_cloud` takes.

    Raises:
        InputError: another suffix.
    """
    suffix = path.suffix.lower()
    if suffix not in _WRITERS:
        found = f"no cloud can be written as {suffix!r}" if suffix else "has no suffix that says how to write a cloud"
        raise InputError(path, found, f"allowed: {', '.join(_WRITERS)}")
    return suffix


def write_xyz(
    path: Path, points: NDArray[np.float64], colors: NDArray[np.uint8] | None = None, *, exact: bool = False
) -> None:
    """Writes `x y z` a line, or `x y z r g b`, in the fewest digits that give the float32 back: "-4.6 -7 0.5".

    Where a coordinate exceeds FLOAT32_REACH_M, all are written in the digits that float64 needs.

    Args:
        path: the file.
        points: (N, 3) float64, metres.
        colors: (N, 3) uint8 RGB, or None.
        exact: write the digits that float64 needs anywhere.
    """
    large = bool(len(points)) and float(np.abs(points).max()) > FLOAT32_REACH_M
    numbers = points.astype(np.float64 if large or exact else np.float32) + 0  # + 0 turns -0 into 0
    columns = [*numbers.T, *(() if colors is None else colors.T)]
    with write_whole(path, "wb") as file:
        file.writelines(text_rows(columns, lambda number: str(number).removesuffix(".0")))


def write_ply(path: Path, points: NDArray[np.float64], colors: NDArray[np.uint8] | None = None) -> None:
    """Writes a binary little-endian PLY: vertices x, y, z (double), and red, green, blue (uchar).

    Args:
        path: the file.
        points: (N, 3) float64, metres.
        colors: (N, 3) uint8 RGB, or None.
    """
    names = ("red", "green", "blue") if colors is not None else ()
    records = np.empty(len(points), [*((axis, "<f8") for axis in "xyz"), *((name, "u1") for name in names)])
    for column, axis in enumerate("xyz"):
        records[axis] = points[:, column]
    if colors is not None:
        for column, name in enumerate(names):
            records[name] = colors[:, column]
    properties = [f"property double {axis}" for axis in "xyz"] + [f"property uchar {name}" for name in names]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *properties, "end_header"]
    with write_whole(path, "wb") as file:
        file.write("".join(f"{line}\n" for line in lines).encode("ascii"))
        file.write(records.tobytes())


def _write_exact_xyz(path: Path, points: NDArray[np.float64], colors: NDArray[np.uint8] | None) -> None:
    write_xyz(path, points, colors, exact=True)


def _write_npz(path: Path, points: NDArray[np.float64], colors: NDArray[np.uint8] | None) -> None:
    arrays = {"points": points} if colors is None else {"points": points, "colors": colors}
    with write_whole(path, "wb") as file:
        np.savez(file, **arrays)


_WRITERS: dict[str, Callable[[Path, NDArray[np.float64], NDArray[np.uint8] | None], None]] = {
    ".pcd": write_pcd,
    ".ply": write_ply,
    ".txt": _write_exact_xyz,
    ".xyz": _write_exact_xyz,
    ".npz": _write_npz,
}

#: What the files of clouds are called.
CLOUD_SUFFIXES = tuple(_WRITERS)
