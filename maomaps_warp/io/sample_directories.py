"""Sample directories of the MAOMaps dataset: map, poses and start pose of runs through the same scene."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from maomaps_warp.errors import InputError
from maomaps_warp.io.clouds import read_cloud
from maomaps_warp.io.source import Part, Source, notes_of
from maomaps_warp.io.tables import data_rows, decode_text, parse_rows, read_bytes, read_table
from maomaps_warp.io.trajectories import are_byte_values, read_trajectory
from maomaps_warp.model.cloud import PointCloud

#: Runs of a sample. The data set has two; more are allowed.
RUN_NAMES = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
#: In the place of a run's name: the map of all runs.
MERGED = "merged"
#: A map comes as text, whose order `gt_colors_*.txt` follows, or as PCD.
_MAP_NAMES = ("gt_points_{run}.txt", "gt_points_{run}.pcd")
_MAP_FILES = (*_MAP_NAMES, "gt_colors_{run}.txt")
_POSE_FILES = ("gt_poses_{run}.txt", "gt_poses_{run}_timestamps.txt", "start_pose_{run}.txt", "goal_pose_{run}.txt")

_DIGITS = re.compile(r"([0-9]+)")

StartPose = tuple[float, float, float, float]


def is_sample_directory(path: Path) -> bool:
    """Whether a folder holds the map or the poses of a run."""
    return bool(runs_of(path))


def runs_of(folder: Path) -> tuple[str, ...]:
    """The runs that a folder holds the map or the poses of, in order."""
    names = (*_MAP_NAMES, "gt_poses_{run}.txt")
    return tuple(run for run in RUN_NAMES if any((folder / name.format(run=run)).is_file() for name in names))


def run_files(run: str) -> tuple[str, ...]:
    """Names of the files that a run may consist of."""
    return tuple(name.format(run=run) for name in (*_MAP_FILES, *_POSE_FILES))


def merged_files() -> tuple[str, ...]:
    """Names of the files that a merged map may consist of."""
    return tuple(name.format(run=MERGED) for name in _MAP_FILES)


def sample_directories(folder: Path) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """The sample directories in a folder, and the other folders in it, sorted as people count: sample2, sample10.

    A sample directory holds one file of the layout or more. A folder that is one itself is the only one.

    Raises:
        InputError: the folder cannot be read.
    """
    if _holds_sample_files(folder):
        return (folder,), ()
    try:
        folders = [entry for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith(".")]
    except FileNotFoundError:
        raise InputError(folder, "no such folder") from None
    except NotADirectoryError:
        raise InputError(folder, "is a file", "give a folder of sample directories, or one of them") from None
    except OSError as error:
        raise InputError(folder, f"cannot be read: {error.strerror}") from error
    folders.sort(key=_counting_order)
    samples = tuple(entry for entry in folders if _holds_sample_files(entry))
    return samples, tuple(entry for entry in folders if entry not in samples)


def read_sample(path: Path, run: str | None, *, pose_frame: str = "auto", part: Part = "all") -> Source:
    """Read one run of a MAOMaps sample directory.

    Args:
        path: the directory.
        run: "first", "second" and so on; None is refused, for they are different recordings.
        pose_frame: what the poses mean, see `parse_convention`; "auto" is the body frame (x forward, y left, z up).
        part: what is wanted of it.

    Raises:
        InputError: no run was named, files are missing, or one of them is damaged.
    """
    present = runs_of(path)
    choices = [name for name in RUN_NAMES if name in present or name in RUN_NAMES[:2]]
    if run not in choices:
        found = "holds several runs" if run is None else f"has no run {run!r}"
        raise InputError(path, found, f"choose with {' or '.join(f'--run {name}' for name in choices)}")
    poses, stamps = path / f"gt_poses_{run}.txt", path / f"gt_poses_{run}_timestamps.txt"
    start = path / f"start_pose_{run}.txt"
    needed = [start, *((poses, stamps) if part != "map" else ())]
    missing = [file.name for file in needed if not file.is_file()]
    if part != "trajectory" and _map_file(path, run) is None:
        missing.append(_map_names(run))
    if missing:
        raise InputError(path, f"missing: {', '.join(missing)}", "a MAOMaps sample directory needs them")
    cloud = trajectory = None
    if part != "trajectory":
        cloud = _read_map(path, run)
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


def read_merged(folder: Path) -> PointCloud:
    """The merged map of a sample directory, with its colours.

    Raises:
        InputError: it is missing or damaged.
    """
    return _read_map(folder, MERGED)


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


def _counting_order(entry: Path) -> tuple[list[int | str], str]:
    # Split at a group, every second part is a number; the whole name settles "sample1" and "sample01".
    parts = _DIGITS.split(entry.name)
    return [int(part) if place % 2 else part for place, part in enumerate(parts)], entry.name


def is_sample_file(name: str) -> bool:
    """Whether a file of this name belongs to a sample: a map, poses, or a recording."""
    return name in _sample_files()


def _sample_files() -> tuple[str, ...]:
    return (*merged_files(), *(name for run in RUN_NAMES for name in (*run_files(run), f"{run}.bag")))


def _holds_sample_files(folder: Path) -> bool:
    return any((folder / name).is_file() for name in _sample_files())


def _map_file(folder: Path, run: str) -> Path | None:
    paths = (folder / name.format(run=run) for name in _MAP_NAMES)
    return next((path for path in paths if path.is_file()), None)


def _map_names(run: str) -> str:
    return " or ".join(name.format(run=run) for name in _MAP_NAMES)


def _read_map(folder: Path, run: str) -> PointCloud:
    path = _map_file(folder, run)
    if path is None:
        raise InputError(folder, f"missing: {_map_names(run)}", "a MAOMaps sample directory needs them")
    return _colored(read_cloud(path), folder / f"gt_colors_{run}.txt")


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
