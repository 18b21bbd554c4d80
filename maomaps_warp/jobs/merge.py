"""Merging maps by one of the baselines."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.clouds import read_cloud
from maomaps_warp.io.sample_directories import RUN_NAMES, read_start_pose
from maomaps_warp.mapping.cloud_map import check_extent, voxelise
from maomaps_warp.merging.correlation_2d import place_by_correlation
from maomaps_warp.merging.registration_3d import import_library, place_by_registration
from maomaps_warp.merging.start_poses import place_by_start_poses
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.placements import Placement
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.scoring.merge_transforms import moved, start_placement
from maomaps_warp.stopwatch import Stopwatch

MergeMethod = Literal["start-poses", "correlation-2d", "registration-3d"]
_Place = Callable[[NDArray[np.float64], NDArray[np.float64], float], Placement]
_PLACES: dict[str, _Place] = {"correlation-2d": place_by_correlation, "registration-3d": place_by_registration}


@dataclass(frozen=True, eq=False)
class MergedSource:
    """One source and what became of it.

    Attributes:
        cloud: the source, in its own frame.
        placement: where it lies in the merged map.
        seconds: spent on it, all tries together.
    """

    cloud: PointCloud
    placement: Placement
    seconds: float


def read_sources(
    paths: Sequence[Path], method: MergeMethod, sample: Path | None, yaw_correction: float | None
) -> tuple[tuple[PointCloud, ...], tuple[NDArray[np.float64], ...]]:
    """The maps to merge, and where their runs started, (4, 4) each, if the method asks for it.

    Args:
        paths: the maps, in the order of the runs.
        method: what they shall be merged by.
        sample: a folder with `start_pose_first.txt`, `start_pose_second.txt` and so on.
        yaw_correction: radians, added to the start poses' yaw.

    Raises:
        InputError: options that do not go together, a file that cannot be read, or a library that is missing.
    """
    if not 2 <= len(paths) <= len(RUN_NAMES):
        raise InputError("--source", f"{len(paths)} given", f"a merge takes 2 to {len(RUN_NAMES)} maps")
    by_start = method == "start-poses"
    if by_start and sample is None:
        raise InputError("--method start-poses", "no --sample given", "the start poses are read from that folder")
    for name, value in (("--sample", sample), ("--yaw-correction", yaw_correction)):
        if value is not None and not by_start:
            raise InputError(name, f"has no effect on {method}", "leave it away, or use --method start-poses")
    if method == "registration-3d":
        import_library()
    starts: tuple[NDArray[np.float64], ...] = ()
    if sample is not None:
        files = [sample / f"start_pose_{run}.txt" for run in RUN_NAMES[: len(paths)]]
        starts = tuple(start_placement(read_start_pose(file), yaw_correction or 0.0) for file in files)
    return tuple(read_cloud(path) for path in paths), starts


def merge(
    clouds: Sequence[PointCloud],
    method: MergeMethod,
    *,
    voxel_size: float,
    T_world_source: Sequence[NDArray[np.float64]] = (),
    clock: Stopwatch,
) -> tuple[MergedSource, ...]:
    """Merge maps; the first one's frame is the merged map's.

    But for `start-poses`, each further source is placed in the map merged so far, in order, and those that found no
    place are tried again whenever another one has: the third map may join the second to the first.

    Args:
        clouds: at least two maps.
        method: one of the baselines.
        voxel_size: edge of the voxels that maps are compared in, metres.
        T_world_source: for `start-poses`, (4, 4) each: where the runs started.
        clock: collects the time and shows progress.

    Raises:
        InputError: points too far apart for voxels, or a library that is missing.
    """
    with clock.stage("merge") as progress:
        if method == "start-poses":
            began = time.perf_counter()
            placements = list(place_by_start_poses(T_world_source))
            seconds = [time.perf_counter() - began] * len(clouds)
        else:
            placements, seconds = _grow(clouds, _PLACES[method], voxel_size, progress)
    return tuple(MergedSource(*parts) for parts in zip(clouds, placements, seconds, strict=True))


def union(sources: Sequence[MergedSource]) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None, tuple[str, ...]]:
    """All points of the sources that were merged, (N, 3) float64, metres; their colours, or None where one of them has
    none; and notes."""
    merged = [source for source in sources if source.placement.T_merged_source is not None]
    points = np.concatenate([_placed(source.cloud.points, source.placement) for source in merged])
    colored = [source.cloud.colors for source in merged if source.cloud.colors is not None]
    if len(colored) == len(merged):
        return points, np.concatenate(colored), ()
    plain = ", ".join(source.cloud.source for source in merged if source.cloud.colors is None)
    return points, None, ((f"the merged map has no colours, as {plain} has none",) if colored else ())


def _grow(
    clouds: Sequence[PointCloud], place: _Place, voxel_size: float, progress: Callable[[int, int | None], None]
) -> tuple[list[Placement], list[float]]:
    maps = [_centers(cloud.points, voxel_size, cloud.source) for cloud in clouds]
    merged = maps[0]
    placements = [Placement(np.eye(4)), *(Placement(None) for _ in maps[1:])]
    seconds = [0.0] * len(maps)
    waiting = list(range(1, len(maps)))
    while waiting:
        for number in waiting:
            began = time.perf_counter()
            placements[number] = place(merged, maps[number], voxel_size)
            seconds[number] += time.perf_counter() - began
            if placements[number].T_merged_source is not None:
                break
        else:
            break  # none of them has a place in this map
        waiting.remove(number)
        grown = np.concatenate([merged, _placed(maps[number], placements[number])])
        merged = _centers(grown, voxel_size, "the merged map")
        progress(len(maps) - len(waiting), len(maps))
    return placements, seconds


def _centers(points: NDArray[np.float64], voxel_size: float, source: str) -> NDArray[np.float64]:
    grid = VoxelGrid.around(points, voxel_size)
    check_extent(points, grid, source)
    return voxelise(points, grid).points


def _placed(points: NDArray[np.float64], placement: Placement) -> NDArray[np.float64]:
    assert placement.T_merged_source is not None
    return moved(placement.T_merged_source, points)
