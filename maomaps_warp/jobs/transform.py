"""Moves a cloud or a trajectory: read, move, write."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import recognise_bag
from maomaps_warp.io.cloud_writing import CLOUD_SUFFIXES, cloud_suffix
from maomaps_warp.io.clouds import write_cloud
from maomaps_warp.io.outputs import check_writable
from maomaps_warp.io.sample_directories import read_start_pose
from maomaps_warp.io.sources import Source, SourceOptions, open_source
from maomaps_warp.io.trajectories import write_maomaps_poses, write_tum
from maomaps_warp.io.trajectory_formats import timestamps_beside
from maomaps_warp.io.transforms import parse_tum_line, read_transform
from maomaps_warp.model.alignment import Alignment
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.scoring.moves import inverse_move, similarity_move, start_pose_move

PoseFormat = Literal["tum", "maomaps"]


@dataclass(frozen=True)
class Moved:
    """What was moved.

    Attributes:
        kind: what the input was recognised as.
        count: points or poses.
        unit: "points" or "poses".
        written: the files.
        notes: what was decided or left out in reading.
    """

    kind: str
    count: int
    unit: str
    written: tuple[Path, ...]
    notes: tuple[str, ...] = ()


def read_move(
    *,
    start_pose: Path | None = None,
    yaw_correction: float | None = None,
    matrix: Path | None = None,
    tum: str | None = None,
    scale: float = 1.0,
    inverse: bool = False,
) -> Alignment:
    """The move that was asked for: p -> scale * R p + t, or with `inverse` its inverse.

    Args:
        start_pose: a `start_pose_*.txt` of MAOMaps: rotate about z by yaw + pi + correction, then add the position.
        yaw_correction: radians; with `start_pose` only.
        matrix: a file with one rigid transform, see `read_transforms`.
        tum: a line `t x y z qx qy qz qw`.
        scale: metres of the output per unit of the input.
        inverse: take the move back, its scale too.

    Raises:
        InputError: none or several of the three ways, a file that holds something else, a scale that is none.
    """
    given = {"--start-pose": start_pose, "--matrix": matrix, "--tum": tum}
    ways = [name for name, value in given.items() if value is not None]
    if len(ways) != 1:
        found = f"{' and '.join(ways)} given together" if ways else "no transform given"
        raise InputError("transform", found, f"give one of {', '.join(given)}")
    if yaw_correction is not None and start_pose is None:
        raise InputError("--yaw-correction", "given without --start-pose", "it is added to the yaw of a start pose")
    if not 0.0 < scale < math.inf:
        raise InputError(f"--scale {scale:g}", "is no scale", "a number above 0")
    if start_pose is not None:
        move = replace(start_pose_move(read_start_pose(start_pose), yaw_correction or 0.0), scale=scale)
    else:
        move = similarity_move(read_transform(matrix) if matrix else parse_tum_line(tum or ""), scale)
    return inverse_move(move) if inverse else move


def transform(
    path: Path,
    output: Path,
    move: Alignment,
    *,
    format: str = "auto",
    pose_frame: str = "auto",
    to: PoseFormat | None = None,
    overwrite: bool = False,
) -> Moved:
    """Move a cloud, whose colours stay, or a trajectory, whose stamps stay.

    Args:
        path: a file with either, recognised by its content.
        output: the file to write; of clouds its suffix names the format.
        move: how.
        format: what to read the file as.
        pose_frame: what the recorded poses mean, see `parse_convention`.
        to: how to write a trajectory; None: as it was, if that is one of them, else TUM if there are stamps.
        overwrite: replace what stands at `output`.

    Raises:
        InputError: the file is neither or cannot be read; `output` exists, cannot be written or has a suffix that
            does not fit.
    """
    if path.exists() and (path.is_dir() or recognise_bag(path)):
        what = "a folder" if path.is_dir() else "a bag"
        raise InputError(path, f"is {what}", "one file is moved; `extract` takes clouds and trajectories out of a bag")
    _check_output(output, path, overwrite)
    source = open_source(path, SourceOptions(format=format, pose_frame=pose_frame), "one")
    if source.cloud is not None:
        return _move_cloud(source, output, move, pose_frame, to)
    assert source.trajectory is not None
    kind = _pose_format(source.kind, source.trajectory) if to is None else to
    return _move_trajectory(source, source.trajectory, output, move, kind, overwrite)


def _move_cloud(source: Source, output: Path, move: Alignment, pose_frame: str, to: PoseFormat | None) -> Moved:
    assert source.cloud is not None
    for option, is_given in (("--pose-frame", pose_frame != "auto"), ("--to", to is not None)):
        if is_given:
            found = f"given for a cloud (it was read as: {source.kind})"
            raise InputError(option, found, "it is for trajectories; --format names another kind")
    cloud_suffix(output)
    with np.errstate(over="ignore", invalid="ignore"):
        points = move.apply_points(source.cloud.points)
    _check_finite(points, source.name)
    write_cloud(output, points, source.cloud.colors)
    return Moved(source.kind, len(source.cloud), "points", (output,), source.notes)


def _move_trajectory(
    source: Source, trajectory: Trajectory, output: Path, move: Alignment, kind: PoseFormat, overwrite: bool
) -> Moved:
    suffix = output.suffix.lower()
    if suffix in CLOUD_SUFFIXES and suffix != ".txt":
        found = f"is named {suffix}, but {source.name} holds poses (it was read as: {source.kind})"
        raise InputError(output, found, "name it .txt or .tum")
    with np.errstate(over="ignore", invalid="ignore"):
        _check_finite(move.apply_points(trajectory.positions), source.name)
    moved = move.apply_trajectory(trajectory)
    written: tuple[Path, ...] = (output,)
    if kind == "tum":
        write_tum(output, moved)
    else:
        if moved.stamps_ns is not None:
            written += (timestamps_beside(output),)
            _check_output(written[1], Path(source.name), overwrite)
        write_maomaps_poses(output, moved)
    return Moved(source.kind, len(trajectory), "poses", written, source.notes + _turned(trajectory, kind))


def _check_finite(moved: NDArray[np.float64], source: str) -> None:
    if not np.isfinite(moved).all():
        raise InputError(source, "the move puts its coordinates beyond what numbers hold", "check it, and --scale")


def _turned(trajectory: Trajectory, kind: PoseFormat) -> tuple[str, ...]:
    """What writing made of the poses' frame, where it is not what was recorded."""
    if kind == "tum" and trajectory.pose_frame != "optical":
        return (f"the poses were read as {trajectory.pose_frame} and written as the camera's (z forward)",)
    if kind == "maomaps" and trajectory.is_assumed:
        return (f"the poses were taken for {trajectory.pose_frame}, and written as the body's; --pose-frame tells it",)
    return ()


def _pose_format(kind: str, trajectory: Trajectory) -> PoseFormat:
    """The input's own format, if it is one that is written; else TUM, or without stamps MAOMaps."""
    if kind.startswith("MAOMaps"):
        return "maomaps"
    return "maomaps" if trajectory.stamps_ns is None else "tum"


def _check_output(output: Path, path: Path, overwrite: bool) -> None:
    if output.resolve() in (path.resolve(), timestamps_beside(path).resolve()):
        raise InputError(output, "is the input, or belongs to it", "give the output a file of its own")
    if output.is_file() and not overwrite:
        raise InputError(output, "exists already", "--overwrite replaces it; or choose another file")
    check_writable(output)
