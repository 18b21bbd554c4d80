"""Sample directories of the MAOMaps dataset: map, poses and start pose of two runs through the same scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from maomaps_warp.errors import InputError
from maomaps_warp.io.clouds import read_cloud
from maomaps_warp.io.source import Part, Source, notes_of
from maomaps_warp.io.tables import data_rows, decode_text, parse_rows, read_bytes, read_table
from maomaps_warp.io.trajectories import are_byte_values, read_trajectory
from maomaps_warp.model.cloud import PointCloud

RUNS = ("first", "second")
#: A map comes as text, whose order `gt_colors_*.txt` follows, or as PCD.
_MAP_NAMES = ("gt_points_{run}.txt", "gt_points_{run}.pcd")

StartPose = tuple[float, float, float, float]


def is_sample_directory(path: Path) -> bool:
    """Whether a folder holds the map or the poses of a run."""
    names = (*_MAP_NAMES, "gt_poses_{run}.txt")
    return any((path / name.format(run=run)).is_file() for run in RUNS for name in names)


def read_sample(path: Path, run: str | None, *, pose_frame: str = "auto", part: Part = "all") -> Source:
    """Read one run of a MAOMaps sample directory.

    Args:
        path: the directory.
        run: "first" or "second"; None is refused, for the two are different recordings.
        pose_frame: what the poses mean, see `parse_convention`; "auto" is the body frame (x forward, y left, z up).
        part: what is wanted of it.

    Raises:
        InputError: no run was named, files are missing, or one of them is damaged.
    """
    if run not in RUNS:
        found = "holds several runs" if run is None else f"has no run {run!r}"
        raise InputError(path, found, "choose with --run first or --run second")
    maps = [path / name.format(run=run) for name in _MAP_NAMES]
    poses, stamps = path / f"gt_poses_{run}.txt", path / f"gt_poses_{run}_timestamps.txt"
    start = path / f"start_pose_{run}.txt"
    needed = [start, *((poses, stamps) if part != "map" else ())]
    missing = [file.name for file in needed if not file.is_file()]
    existing_map = next((file for file in maps if file.is_file()), None)
    if part != "trajectory" and existing_map is None:
        missing.append(" or ".join(file.name for file in maps))
    if missing:
        raise InputError(path, f"missing: {', '.join(missing)}", "a MAOMaps sample directory needs them")
    cloud = trajectory = None
    if part != "trajectory" and existing_map is not None:
        cloud = _colored(read_cloud(existing_map), path / f"gt_colors_{run}.txt")
    if part != "map":
        trajectory = read_trajectory(poses, format="maomaps", pose_frame=pose_frame)
    return Source(
        str(path),
        f"MAOMaps sample directory, run {run}",
        trajectory,
        cloud,
        start_pose=read_start_pose(start),
        notes=notes_of(cloud, trajectory),
    )


def read_start_pose(path: Path) -> StartPose:
    """The start pose (x, y, z, yaw), metres and radians: a line `x y z`, then a line with the yaw.

    Raises:
        InputError: the file is absent or holds something else.
    """
    rows, lines = data_rows(decode_text(path, read_bytes(path)))
    if [len(row.split()) for row in rows] != [3, 1]:
        found = f"{len(rows)} lines of numbers: {' / '.join(row[:40] for row in rows[:3])}"
        raise InputError(path, found, "a line `x y z` and a line with the yaw are expected")
    (x, y, z), (yaw,) = (parse_rows(path, [row], [line])[0] for row, line in zip(rows, lines, strict=True))
    if not np.isfinite([x, y, z, yaw]).all():
        raise InputError(path, "a value is NaN or infinite", "a start pose is four finite numbers")
    return float(x), float(y), float(z), float(yaw)


def _colored(cloud: PointCloud, path: Path) -> PointCloud:
    """The cloud with the colours of a file of `r g b` lines, one a point, or with a note on what stood against it."""
    if not path.is_file():
        note = f"no {path.name}: the map has no colours"
        return cloud if cloud.colors is not None else replace(cloud, notes=(note, *cloud.notes))
    if cloud.dropped_nonfinite:
        note = f"{path.name} not used: points were dropped, colours no longer belong to points"
        return replace(cloud, notes=(note, *cloud.notes))
    table = read_table(path, columns={3})
    if len(table) != len(cloud):
        found = f"holds {len(table)} colours, but {Path(cloud.source).name} holds {len(cloud)} points"
        raise InputError(path, found, "colour i belongs to point i; without this file the map has no colours")
    if not are_byte_values(table.values):
        raise InputError(path, "colours are not whole numbers in 0..255", "`r g b` lines are expected")
    return replace(cloud, colors=table.values.astype(np.uint8))
