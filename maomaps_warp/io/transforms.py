"""Rigid transforms in text: what a merge prints, and what moves a cloud."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.outputs import write_whole
from maomaps_warp.io.rotations import (
    ORTHONORMALITY_TOLERANCE,
    checked_quaternions,
    checked_rotations,
    matrices_from_quaternions,
    poses,
)
from maomaps_warp.io.tables import Table, check_finite, read_table

_FORMS = (
    "transforms are 4x4 matrices (four lines of four numbers, or sixteen in one), 3x3 ones of the plane (three lines "
    "of three, or nine in one), lines `x y yaw`, or TUM lines `t x y z qx qy qz qw`; a matrix of zeros means not merged"
)


@dataclass(frozen=True, eq=False)
class MergeTransforms:
    """Where a merge puts each of its maps.

    Attributes:
        T_merged_source: (4, 4) float64, metres, of each source in their order: source coordinates to the merged
            map's; None for one that was not merged.
        is_planar: they were given in two dimensions.
    """

    T_merged_source: tuple[NDArray[np.float64] | None, ...]
    is_planar: bool = False


def read_transforms(path: Path) -> MergeTransforms:
    """Read the transforms of a merge, in the order of its maps.

    Forms: 4x4 matrices, 3x3 homogeneous matrices of the plane, lines `x y yaw` (metres, radians), or TUM lines
    whose stamps are not looked at. A matrix of zeros alone means that a map was not merged, as map_merge_3d prints it.
    Lines `x y yaw` and lines of 3x3 matrices both have three numbers: three lines that end in `0 0 1`, or are all
    zero, are a matrix.

    Raises:
        InputError: absent, of another form, or a matrix that is no rigid transform.
    """
    table = read_table(Path(path))
    check_finite(table)
    columns = table.values.shape[1]
    if columns == 8:
        rotations = matrices_from_quaternions(checked_quaternions(table.values[:, 4:8], table.where))
        return MergeTransforms(tuple(poses(table.values[:, 1:4], rotations)))
    if columns == 16 or (columns == 4 and len(table) % 4 == 0):
        return MergeTransforms(_rigid(table.values.reshape(-1, 4, 4), table, 4 if columns == 4 else 1))
    if columns == 9 or (columns == 3 and _are_plane_matrices(table.values)):
        flat = table.values.reshape(-1, 3, 3)
        return MergeTransforms(_rigid(_lifted(flat), table, 3 if columns == 3 else 1), is_planar=True)
    if columns == 3:
        return MergeTransforms(tuple(planar_transform(*row) for row in table.values), is_planar=True)
    raise InputError(path, f"{len(table)} lines of {columns} numbers", _FORMS)


def read_transform(path: Path) -> NDArray[np.float64]:
    """One rigid transform, (4, 4) float64, metres, of a file in a form of `read_transforms`.

    Raises:
        InputError: as `read_transforms`, or the file holds several or a matrix of zeros.
    """
    found = read_transforms(path).T_merged_source
    if len(found) != 1 or found[0] is None:
        what = f"{len(found)} transforms" if len(found) != 1 else "a matrix of zeros"
        raise InputError(path, what, "one rigid transform is expected")
    return found[0]


def parse_tum_line(text: str) -> NDArray[np.float64]:
    """The transform, (4, 4) float64, metres, of a TUM line `t x y z qx qy qz qw`, or of one without the stamp.

    Raises:
        InputError: something else.
    """
    where = f"transform {text!r}"
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        values = np.empty(0)
    if len(values) not in (7, 8) or not np.isfinite(values).all():
        raise InputError(where, "no TUM line", "`t x y z qx qy qz qw` or `x y z qx qy qz qw`, metres")
    quaternion = checked_quaternions(values[None, -4:], lambda _row: where)
    return np.asarray(poses(values[None, -7:-4], matrices_from_quaternions(quaternion))[0])


def planar_transform(x: float, y: float, yaw: float) -> NDArray[np.float64]:
    """(4, 4) float64 of a turn by `yaw` radians about z and a shift by x, y metres."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def write_transforms(path: Path, transforms: Sequence[NDArray[np.float64] | None]) -> None:
    """Write 4x4 matrices, four lines each with an empty line between; zeros for None.

    Raises:
        InputError: the file cannot be written.
    """
    blocks = []
    for T in transforms:
        rows = np.zeros((4, 4)) if T is None else T
        blocks.append("\n".join(" ".join(map(repr, row)) for row in rows.tolist()))
    with write_whole(path, "w") as file:
        file.write("\n\n".join(blocks) + "\n")


def _are_plane_matrices(values: NDArray[np.float64]) -> bool:
    if len(values) % 3:
        return False
    last = values[2::3]
    blocks = values.reshape(-1, 9)
    return bool(((last == (0.0, 0.0, 1.0)).all(axis=1) | ~blocks.any(axis=1)).all())


def _lifted(flat: NDArray[np.float64]) -> NDArray[np.float64]:
    """4x4 of 3x3 homogeneous matrices of the plane; zeros stay zeros."""
    T = np.zeros((len(flat), 4, 4))
    T[:, :2, :2], T[:, :2, 3] = flat[:, :2, :2], flat[:, :2, 2]
    T[:, 3, :2], T[:, 3, 3] = flat[:, 2, :2], flat[:, 2, 2]
    T[flat.any(axis=(1, 2)), 2, 2] = 1.0
    return T


def _rigid(matrices: NDArray[np.float64], table: Table, lines_each: int) -> tuple[NDArray[np.float64] | None, ...]:
    return tuple(_rigid_or_none(matrix, table.where(n * lines_each)) for n, matrix in enumerate(matrices))


def _rigid_or_none(matrix: NDArray[np.float64], where: str) -> NDArray[np.float64] | None:
    """A rigid transform, (4, 4); None for all zeros: not merged."""
    if not matrix.any():
        return None
    if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), rtol=0.0, atol=1e-6):
        raise InputError(where, f"the last row is {matrix[3].tolist()}", "a rigid transform ends in 0 0 0 1")
    _refuse_similarity(matrix[:3, :3], where)
    rotation = checked_rotations(matrix[None, :3, :3], lambda _row: where)
    return np.asarray(poses(matrix[None, :3, 3], rotation)[0])


def _refuse_similarity(matrix: NDArray[np.float64], where: str) -> None:
    """Raise InputError for a rotation times a scale other than 1, which deserves a better word than "no rotation"."""
    determinant = float(np.linalg.det(matrix))
    if determinant <= 0.0:
        return
    scale = determinant ** (1 / 3)
    is_rotation = np.abs(matrix.T @ matrix / scale**2 - np.eye(3)).max() <= ORTHONORMALITY_TOLERANCE
    if is_rotation and abs(scale - 1.0) > ORTHONORMALITY_TOLERANCE:
        found = f"a similarity of scale {scale:g}, not a rigid transform"
        hint = f"divide the upper left 3x3 by its scale; `transform` takes it as --scale {scale:.9g}"
        raise InputError(where, found, hint)
