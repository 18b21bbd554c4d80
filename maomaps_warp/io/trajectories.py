"""Trajectories in text files: TUM, KITTI, EuRoC and MAOMaps."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.outputs import write_whole
from maomaps_warp.io.rotations import quaternions_from_matrices, rpy_from_matrices
from maomaps_warp.io.stamp_order import check_stamp_order, seconds_text
from maomaps_warp.io.tables import HEAD_BYTES, column_count, not_of_kind, read_bytes, read_table
from maomaps_warp.io.trajectory_formats import (
    COLUMN_MEANINGS,
    PoseRows,
    read_euroc_rows,
    read_kitti_rows,
    read_maomaps_rows,
    read_tum_rows,
    timestamps_beside,
)
from maomaps_warp.model.pose_convention import T_BODY_CAMERA, parse_convention
from maomaps_warp.model.trajectory import Trajectory

TrajectoryFormat = Literal["tum", "kitti", "euroc", "maomaps"]
#: The formats as people write them.
TRAJECTORY_NAMES = {"tum": "TUM", "kitti": "KITTI", "euroc": "EuRoC", "maomaps": "MAOMaps"}

_READERS: dict[TrajectoryFormat, Callable[[Path], PoseRows]] = {
    "tum": read_tum_rows,
    "kitti": read_kitti_rows,
    "euroc": read_euroc_rows,
    "maomaps": read_maomaps_rows,
}
_FORMATS_HINT = (
    "trajectories are TUM (8 values a row), KITTI (12), EuRoC csv (8 or more, commas) or MAOMaps (6); "
    "name the format if it is one of them"
)


def read_trajectory(
    path: Path,
    *,
    format: TrajectoryFormat | Literal["auto"] = "auto",
    pose_frame: str = "auto",
) -> Trajectory:
    """Reads camera poses from a text file.

    Args:
        path: the file; stamps of KITTI and MAOMaps poses are looked for beside it.
        format: "auto" recognises it by its content.
        pose_frame: what the file's poses mean, see `parse_convention`: "optical" if they are the camera's,
            "body" if those of a body frame (x forward, y left, z up) that shares the camera's origin, and so
            on. "auto" is body for MAOMaps and optical for all others.

    Returns:
        Poses in the optical frame, at least one. Stamps are None where the source has none.

    Raises:
        InputError: the file is no trajectory or not one of this format; stamps are not ascending, or not in
            the format's unit; a rotation is none.
    """
    path = Path(path)
    if format not in ("auto", *_READERS):
        raise ValueError(f"format must be auto or one of {', '.join(_READERS)}, got {format!r}")
    known = recognise_trajectory(path) if format == "auto" else format
    if known is None:
        raise not_of_kind(path, "a trajectory", _FORMATS_HINT, COLUMN_MEANINGS)
    rows = _READERS[known](path)
    T, stamps_ns, notes = rows.T, rows.stamps_ns, rows.notes
    if stamps_ns is not None:
        keep, more = check_stamp_order(stamps_ns, T, rows.where_stamp)
        T, stamps_ns, notes = T[keep], stamps_ns[keep], (*notes, *more)
    usual = "body" if known == "maomaps" else "optical"
    frame = usual if pose_frame == "auto" else pose_frame
    return Trajectory(
        parse_convention(frame).camera_poses(T),
        stamps_ns,
        str(path),
        pose_frame=frame,
        is_assumed=pose_frame == "auto" and known != "maomaps",
        notes=notes,
    )


def recognise_trajectory(path: Path) -> TrajectoryFormat | None:
    """The format of a trajectory file by its content, or None if it is no trajectory (or a folder).

    Six values a row are MAOMaps poses or points with colours: poses if a file of stamps stands beside them,
    else points if the last three are all whole numbers in 0..255 and not all zero.

    Raises:
        InputError: the file cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        return None
    head = read_bytes(path, HEAD_BYTES)
    shape = column_count(head)
    if shape is None:
        return None
    columns, delimited = shape
    if columns == 6:
        return None if _is_coloured_cloud(path) else "maomaps"
    if columns == 12:
        return "kitti"
    if columns == 17 or (columns >= 8 and delimited):
        return "euroc"
    return "tum" if columns == 8 else None


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Writes `t x y z qx qy qz qw`, seconds with 9 decimals, all digits of the numbers, optical frame.

    Raises:
        InputError: the trajectory has no stamps, or the file cannot be written.
    """
    if trajectory.stamps_ns is None:
        raise InputError(trajectory.source, "has no stamps, which TUM files need", "write MAOMaps poses instead")
    quaternions = quaternions_from_matrices(trajectory.T_world_camera[:, :3, :3])
    with write_whole(path, "w") as file:
        file.write("# timestamp tx ty tz qx qy qz qw\n")
        for stamp, position, xyzw in zip(
            trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), quaternions.tolist(), strict=True
        ):
            file.write(f"{seconds_text(stamp)} {' '.join(map(repr, position + xyzw))}\n")


def write_maomaps_poses(path: Path, trajectory: Trajectory) -> None:
    """Writes `x y z roll pitch yaw` of the body frame; stamps, if any, in seconds to `<stem>_timestamps.txt`.

    Raises:
        InputError: a file cannot be written, or old stamps stand beside poses that have none.
    """
    path = Path(path)
    stamps_path = timestamps_beside(path)
    if trajectory.stamps_ns is None and stamps_path.exists():
        raise InputError(stamps_path, "would be taken for the stamps of poses that have none", "remove it first")
    T_world_body = trajectory.T_world_camera @ T_BODY_CAMERA.T
    rows = np.hstack([T_world_body[:, :3, 3], rpy_from_matrices(T_world_body[:, :3, :3])])
    with ExitStack() as both:
        # Opened together, so that neither appears without the other.
        file = both.enter_context(write_whole(path, "w"))
        if trajectory.stamps_ns is not None:
            stamps_file = both.enter_context(write_whole(stamps_path, "w"))
            stamps_file.writelines(f"{seconds_text(stamp)}\n" for stamp in trajectory.stamps_ns.tolist())
        file.writelines(" ".join(map(repr, row)) + "\n" for row in rows.tolist())


def _is_coloured_cloud(path: Path) -> bool:
    if timestamps_beside(path).exists():
        return False
    table = read_table(path, columns={6}, is_map=True)  # a large one most likely is
    return are_byte_values(table.values[:, 3:6]) and bool(table.values[:, 3:6].any())


def are_byte_values(values: NDArray[np.float64]) -> bool:
    """Whether all are whole numbers in 0..255."""
    return bool(((values >= 0) & (values <= 255) & (values == np.rint(values))).all())
