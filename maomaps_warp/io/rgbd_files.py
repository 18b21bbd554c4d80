"""The small files inside RGB-D folders: pose matrices, pose logs, camera matrices."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.rotations import checked_quaternions, checked_rotations, matrices_from_quaternions, poses
from maomaps_warp.io.tables import check_finite, data_rows, decode_text, parse_rows, place, read_bytes, read_table
from maomaps_warp.model.camera import Camera

#: What to do where a folder does not state its camera.
CAMERA_HINT = "give --camera WIDTHxHEIGHT:fx,fy,cx,cy"

#: How Windows programs print what is no number; in our tables "#" would start a comment.
_WINDOWS_NAN = re.compile(r"[-+]?1\.#\S+")
_METADATA_LINE = re.compile(r"-?\d+\s+-?\d+\s+-?\d+")


def read_pose_matrix(path: Path) -> NDArray[np.float64] | None:
    """The camera-to-world pose of a file with one 4x4 matrix.

    Returns:
        (4, 4) float64, metres; None if a value is NaN or infinite, which is how 7-Scenes marks lost tracking.

    Raises:
        InputError: the file is absent or holds something else than a rigid transform.
    """
    rows, lines = data_rows(_WINDOWS_NAN.sub("nan", decode_text(path, read_bytes(path))))
    if len(rows) != 4:
        raise InputError(path, f"{len(rows)} rows of numbers", "a 4x4 camera-to-world matrix is expected")
    matrix = parse_rows(path, rows, lines)
    if not np.isfinite(matrix).all():
        return None
    return _rigid(matrix, place(path, lines[0]))


def read_pose_log(path: Path) -> NDArray[np.float64]:
    """The camera-to-world poses of an Open3D or Redwood log: three integers, then a 4x4 matrix, and so on.

    Returns:
        (N, 4, 4) float64, metres, in the order of the file.

    Raises:
        InputError: the file is absent, cut off, or holds something else.
    """
    rows, lines = data_rows(decode_text(path, read_bytes(path)))
    if not rows or len(rows) % 5:
        raise InputError(path, f"{len(rows)} lines", "each pose takes 5: three integers, then a 4x4 matrix")
    T = []
    for start in range(0, len(rows), 5):
        if not _METADATA_LINE.fullmatch(rows[start]):
            where = place(path, lines[start])
            raise InputError(where, f"{rows[start][:40]!r}", "three integers are expected before each matrix")
        block = slice(start + 1, start + 5)
        T.append(_rigid(parse_rows(path, rows[block], lines[block]), place(path, lines[start + 1])))
    return np.stack(T)


def read_pose_lines(path: Path) -> NDArray[np.float64]:
    """The camera-to-world poses of `x y z qx qy qz qw` lines without stamps: (N, 4, 4) float64, metres."""
    table = read_table(path, columns={7})
    check_finite(table)
    rotations = matrices_from_quaternions(checked_quaternions(table.values[:, 3:], table.where))
    return poses(table.values[:, :3], rotations)


def read_camera_matrix(path: Path, width: int, height: int) -> Camera:
    """The camera of a text file with a 3x3 matrix, for images of `width` x `height` pixels."""
    K = read_table(path, columns={3}).values
    if len(K) != 3:
        raise InputError(path, f"{len(K)} rows", "a 3x3 camera matrix is expected")
    return _camera(path, width, height, K)


def read_json_camera(folder: Path) -> Camera:
    """The camera of the one JSON file in a folder that has `intrinsic_matrix`, as Open3D writes it.

    Raises:
        InputError: there is none, there are several, or it is damaged.
    """
    found = [
        (path, content) for path in sorted(folder.glob("*.json")) if "intrinsic_matrix" in (content := _json(path))
    ]
    if len(found) != 1:
        names = ", ".join(path.name for path, _ in found) or "none"
        hint = CAMERA_HINT if not found else "remove all but one, or " + CAMERA_HINT
        raise InputError(folder, f"needs one JSON file with intrinsic_matrix, found {names}", hint)
    path, content = found[0]
    try:
        K = np.array(content["intrinsic_matrix"], np.float64).reshape(3, 3).T  # stored column by column
        width, height = int(content["width"]), int(content["height"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(path, f"needs width, height and 9 numbers of intrinsic_matrix ({error})") from None
    return _camera(path, width, height, K)


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(decode_text(path, read_bytes(path)))
    except json.JSONDecodeError as error:
        raise InputError(path, f"is not JSON: {error}") from None
    return content if isinstance(content, dict) else {}


def _camera(path: Path, width: int, height: int, K: NDArray[np.float64]) -> Camera:
    """The camera of a matrix K, (3, 3) float64."""
    zeros = (K[0, 1], K[1, 0], K[2, 0], K[2, 1], K[2, 2] - 1.0)
    if any(zeros):
        raise InputError(path, f"is no camera matrix without skew: {K.tolist()}", "fx 0 cx / 0 fy cy / 0 0 1")
    try:
        return Camera(width, height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    except ValueError as error:
        raise InputError(path, str(error)) from None


def _rigid(matrix: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    """A 4x4 matrix with its rotation projected onto SO(3); raises InputError if it is no rigid transform."""
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise InputError(where, f"no finite 4x4 matrix, but {matrix.shape[0]}x{matrix.shape[1]}", "4 rows of 4 numbers")
    if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 0.0:
        raise InputError(where, f"the last row is {matrix[3].tolist()}", "0 0 0 1 in a rigid transform")
    return np.asarray(poses(matrix[None, :3, 3], checked_rotations(matrix[None, :3, :3], lambda _: where))[0])
