"""Writing sample directories in the layout and the formats of the MAOMaps dataset."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.file_sets import check_file_set, write_file_set
from maomaps_warp.io.outputs import write_whole
from maomaps_warp.io.pcd import write_pcd
from maomaps_warp.io.sample_directories import MERGED, RUN_NAMES, merged_files, run_files
from maomaps_warp.io.text_rows import text_rows
from maomaps_warp.io.trajectories import write_maomaps_poses
from maomaps_warp.model.pose_convention import T_BODY_CAMERA
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelMap

BagsMode = Literal["copy", "link", "none"]

#: Horizontal part of an optical axis below which its heading is noise: 0.06 degrees from the vertical.
VERTICAL_AXIS = 1e-3


@dataclass(frozen=True, eq=False)
class SampleRun:
    """One run of a sample.

    Attributes:
        voxels: its map.
        trajectory: its poses.
    """

    voxels: VoxelMap
    trajectory: Trajectory


@dataclass(frozen=True)
class SamplePlace:
    """Where a sample is to be written, and how.

    Attributes:
        folder: the sample directory; made if there is none. Other files in it stay.
        bags: the recordings, by run, which are laid beside the maps as `first.bag` and so on.
        mode: copy the recordings, lay symbolic links to them, or leave them where they are. One that lies in its
            place already is not touched.
        overwrite: replace the maps and poses of every run, and recordings of the same name.
    """

    folder: Path
    bags: Mapping[str, Path]
    mode: BagsMode = "copy"
    overwrite: bool = False


def write_run(
    folder: Path, run: str, voxels: VoxelMap, trajectory: Trajectory, *, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write the map, the poses, and the start and goal poses of one run: all files or none.

    `gt_points_{run}.pcd` holds the colours too; `gt_colors_{run}.txt` is only there if the map has some, and
    `gt_poses_{run}_timestamps.txt` (seconds, exact) if the poses have stamps. What an older run of this name left is
    never left beside new files.

    Points in the text are exact decimal multiples of the voxel size as it is written ("0.35", never
    "0.35000000000000003"), so that every reader gets each voxel back by dividing and rounding.

    Args:
        folder: a sample directory; made if there is none.
        run: one of RUN_NAMES.
        voxels: at least one.
        trajectory: at least one pose.
        overwrite: replace the files of a run of this name.

    Returns:
        The files written.

    Raises:
        InputError: there is such a run already, or a file cannot be written.
    """
    _check_run_name(run)
    with write_file_set(folder, run_files(run), overwrite=overwrite) as staging:
        _fill_run(staging, run, voxels, trajectory)
    return _existing(folder, run_files(run))


def check_run_writable(folder: Path, run: str, *, overwrite: bool = False) -> None:
    """Find out before the work whether `write_run` could write; leaves nothing behind.

    Raises:
        InputError: as `write_run`.
    """
    _check_run_name(run)
    check_file_set(folder, run_files(run), overwrite=overwrite)


def write_sample(place: SamplePlace, runs: Mapping[str, SampleRun], merged: VoxelMap) -> tuple[Path, ...]:
    """Write a whole sample directory: it appears complete, or nothing changes.

    Args:
        place: where.
        runs: by name, of RUN_NAMES.
        merged: the union of their maps.

    Returns:
        The files and folders written.

    Raises:
        InputError: there is something already, a recording to be replaced is an input, or writing fails.
    """
    check_sample_writable(place)
    names, targets = _sample_files(place), bag_targets(place)
    with write_file_set(place.folder, names, overwrite=place.overwrite) as staging:
        for name, run in runs.items():
            _fill_run(staging, name, run.voxels, run.trajectory)
        _fill_map(staging, MERGED, merged)
        for name, target in targets.items():
            _lay(place.bags[name], staging / target.name, place.mode)
    return _existing(place.folder, names)


def check_sample_writable(place: SamplePlace) -> None:
    """Find out before the work whether `write_sample` could write; leaves nothing behind.

    Raises:
        InputError: as `write_sample`.
    """
    for run in place.bags:
        _check_run_name(run)
    inputs = {path.resolve() for path in place.bags.values()}
    if taken := [target for target in bag_targets(place).values() if target.exists() and target.resolve() in inputs]:
        raise InputError(taken[0], "is an input, and another recording would take its place", "choose another folder")
    if around := [bag for bag in place.bags.values() if place.folder.resolve().is_relative_to(bag.resolve())]:
        raise InputError(place.folder, f"is inside the bag {around[0]}, an input", "choose another folder")
    check_file_set(place.folder, _sample_files(place), overwrite=place.overwrite)


def bag_targets(place: SamplePlace) -> dict[str, Path]:
    """Where each recording comes to lie, by run: "first" and a file's own suffix; those that lie there are left out."""
    if place.mode == "none":
        return {}
    targets = {run: place.folder / f"{run}{bag.suffix if bag.is_file() else ''}" for run, bag in place.bags.items()}
    return {run: target for run, target in targets.items() if target.resolve() != place.bags[run].resolve()}


def heading_notes(trajectory: Trajectory) -> tuple[str, ...]:
    """What to say about start and goal poses whose camera looks straight up or down."""
    axes = trajectory.T_world_camera[[0, -1], :2, 2]
    return tuple(
        f"{name} pose: the camera looks straight up or down; its heading is that of the camera pitched to the horizon"
        for name, axis in zip(("start", "goal"), axes, strict=True)
        if math.hypot(*axis) < VERTICAL_AXIS
    )


def point_lines(voxels: VoxelMap) -> Iterator[bytes]:
    """`x y z` of each voxel's centre, metres: the exact decimal multiple of the voxel size as Python writes it."""
    grid = voxels.grid
    size, offset = Decimal(repr(grid.voxel_size)), Decimal(repr(grid.center_offset))
    cells = voxels.ijk.astype(np.int64) + grid.origin_ijk
    return text_rows(list(cells.T), lambda index: format(((int(index) + offset) * size).normalize(), "f"))


def _fill_run(folder: Path, run: str, voxels: VoxelMap, trajectory: Trajectory) -> None:
    if not len(trajectory):
        raise ValueError("a run needs at least one pose")
    _fill_map(folder, run, voxels)
    write_maomaps_poses(folder / f"gt_poses_{run}.txt", trajectory)
    for name, T_world_camera in zip(("start", "goal"), trajectory.T_world_camera[[0, -1]], strict=True):
        x, y, z = T_world_camera[:3, 3].tolist()
        yaw = _wrapped(_heading(T_world_camera) - math.pi)
        with write_whole(folder / f"{name}_pose_{run}.txt") as file:
            file.write(f"{x!r} {y!r} {z!r}\n{yaw!r}\n")


def _fill_map(folder: Path, run: str, voxels: VoxelMap) -> None:
    if not len(voxels):
        raise ValueError("a map needs at least one voxel")
    write_pcd(folder / f"gt_points_{run}.pcd", voxels.points, voxels.colors)
    with write_whole(folder / f"gt_points_{run}.txt", "wb") as file:
        file.writelines(point_lines(voxels))
    if voxels.colors is not None:
        with write_whole(folder / f"gt_colors_{run}.txt", "wb") as file:
            file.writelines(text_rows(list(voxels.colors.T), str))


def _heading(T_world_camera: NDArray[np.float64]) -> float:
    """Direction of the body's x axis in the plane, radians.

    Of a camera that looks straight down the direction of the image's upper edge, straight up that of its lower edge:
    where the camera would look if it were pitched to the horizon.
    """
    ahead, up = (T_world_camera[:3, :3] @ T_BODY_CAMERA[:3, :3].T)[:, [0, 2]].T
    if math.hypot(ahead[0], ahead[1]) < VERTICAL_AXIS:
        ahead = -math.copysign(1.0, ahead[2]) * up
    return math.atan2(ahead[1], ahead[0])


def _wrapped(angle: float) -> float:
    """An angle in (-3 pi, pi], wrapped to (-pi, pi]."""
    return angle if angle > -math.pi else angle + 2.0 * math.pi


def _lay(source: Path, place: Path, mode: BagsMode) -> None:
    try:
        if mode == "link":
            place.symlink_to(source.resolve())
        elif source.is_dir():
            shutil.copytree(source, place)
        else:
            shutil.copyfile(source, place)
    except shutil.Error as error:
        raise InputError(source, f"cannot be copied: {error.args[0][0][2]}", "--bags link or --bags none") from error


def _sample_files(place: SamplePlace) -> tuple[str, ...]:
    """Every name that belongs to a sample: also those of runs that an older sample has and the new one has not."""
    maps = [name for run in RUN_NAMES for name in run_files(run)]
    return (*maps, *merged_files(), *(target.name for target in bag_targets(place).values()))


def _check_run_name(run: str) -> None:
    if run not in RUN_NAMES:
        raise ValueError(f"run must be one of {', '.join(RUN_NAMES)}, got {run!r}")


def _existing(folder: Path, names: Sequence[str]) -> tuple[Path, ...]:
    return tuple(folder / name for name in names if (folder / name).exists())
