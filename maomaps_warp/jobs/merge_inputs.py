"""What a score of a merge is made from, read and checked against one another: a part of its job."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.occupancy_maps import holds_occupancy, read_occupancy
from maomaps_warp.io.sample_directories import read_merged, read_sample, runs_of
from maomaps_warp.io.sources import SourceOptions, source_from_parts
from maomaps_warp.io.transforms import MergeTransforms, read_transforms
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.occupancy import OccupancyGrid
from maomaps_warp.scoring.merge_transforms import start_placement

Pose = NDArray[np.float64]


@dataclass(frozen=True)
class MergeFiles:
    """Files that say what was merged and how.

    Attributes:
        sample: the sample directory.
        sources: the map of each run in its own frame, in the order of the runs; may be empty.
        transforms: the merge's transforms, or None.
        merged: the merged map, a cloud or an occupancy grid, or None.
        gt_transforms: where the sources truly lie, or None: where the runs' start poses put them.
    """

    sample: Path
    sources: tuple[Path, ...] = ()
    transforms: Path | None = None
    merged: Path | None = None
    gt_transforms: Path | None = None


@dataclass(frozen=True, eq=False)
class MergeInputs:
    """The same, read.

    Attributes:
        runs: names of the runs.
        gt_runs: (N, 3) float64 of each run, metres, world: its ground-truth map.
        gt_merged: (M, 3) float64, metres, world: the merged ground truth.
        T_gt_source: (4, 4) float64 of each source, metres: where it truly lies.
        sources: the maps; empty if none were given.
        transforms: of the merge, or None.
        merged: the merged map, or None.
        grid: the merged map as an occupancy grid, or None.
        camera_heights: (R,) float64, metres, world: where the runs' cameras began.
        notes: what was left out in reading.
    """

    runs: tuple[str, ...]
    gt_runs: tuple[NDArray[np.float64], ...]
    gt_merged: NDArray[np.float64]
    T_gt_source: tuple[Pose, ...]
    sources: tuple[PointCloud, ...]
    transforms: MergeTransforms | None
    merged: PointCloud | None
    grid: OccupancyGrid | None
    camera_heights: NDArray[np.float64]
    notes: tuple[str, ...]


def read_merge_inputs(files: MergeFiles, yaw_correction: float | None) -> MergeInputs:
    """Read everything; small files first, so that a mistake in them is told at once.

    Raises:
        InputError: something is absent or damaged, or there are not as many maps or transforms as runs.
    """
    if files.transforms is None and files.merged is None:
        raise InputError(files.sample, "no merge was given", "give --transforms FILE, --merged FILE or both")
    if files.gt_transforms is not None and yaw_correction is not None:
        found = "has no effect beside --gt-transforms"
        raise InputError(
            f"--yaw-correction {yaw_correction:g}", found, "it corrects start poses: leave one of them away"
        )
    runs = _runs(files.sample)
    if files.sources and len(files.sources) != len(runs):
        found = f"{len(files.sources)} given for the {len(runs)} runs of {files.sample}: {', '.join(runs)}"
        raise InputError("--source", found, "give one --source for each run, in their order")
    transforms = _transforms(files.transforms, runs)
    T_gt = None if files.gt_transforms is None else _gt_transforms(files.gt_transforms, runs)
    samples = [read_sample(files.sample, run, part="map") for run in runs]
    starts = [sample.start_pose for sample in samples if sample.start_pose is not None]
    if T_gt is None:
        T_gt = tuple(start_placement(start, yaw_correction or 0.0) for start in starts)
    gt_clouds = [sample.cloud for sample in samples if sample.cloud is not None]
    gt_merged = read_merged(files.sample)
    sources = tuple(_cloud(path, "--source") for path in files.sources)
    merged, grid = (None, None) if files.merged is None else _merged(files.merged)
    others = (*sources, *(cloud for cloud in (merged,) if cloud is not None))
    return MergeInputs(
        runs,
        tuple(cloud.points for cloud in gt_clouds),
        gt_merged.points,
        T_gt,
        sources,
        transforms,
        merged,
        grid,
        np.array([start[2] for start in starts]),
        (*_dropped((*gt_clouds, gt_merged)), *_notes((*others, *(g for g in (grid,) if g is not None)))),
    )


def _runs(sample: Path) -> tuple[str, ...]:
    if not sample.exists():
        raise InputError(sample, "no such folder")
    runs = runs_of(sample)
    if not runs:
        raise InputError(sample, "is no MAOMaps sample directory", "it holds gt_points_first.txt and so on")
    if len(runs) < 2:
        raise InputError(sample, f"holds the run {runs[0]} alone", "a merge takes the maps of two runs or more")
    return runs


def _transforms(path: Path | None, runs: tuple[str, ...]) -> MergeTransforms | None:
    if path is None:
        return None
    found = read_transforms(path)
    if len(found.T_merged_source) != len(runs):
        count = len(found.T_merged_source)
        hint = "one for each run, in their order; a matrix of zeros for a map that was not merged"
        raise InputError(path, f"holds {count} transforms, but the sample has {len(runs)} runs", hint)
    return found


def _gt_transforms(path: Path, runs: tuple[str, ...]) -> tuple[Pose, ...]:
    found = _transforms(path, runs)
    assert found is not None
    known = tuple(T for T in found.T_merged_source if T is not None)
    if len(known) != len(runs):
        raise InputError(path, "holds a matrix of zeros", "every source lies somewhere: give a rigid transform")
    return known


def _cloud(path: Path, option: str) -> PointCloud:
    try:
        source = source_from_parts(path, None, SourceOptions(), "one")
    except InputError as error:
        # The reader's ways out are options that say how to read the only input of a command.
        hint = f"{option} takes a map: PCD, PLY, XYZ text, NPZ, or a bag with one PointCloud2 topic"
        raise InputError(error.where, error.found, hint) from None
    if source.cloud is None:
        hint = f"{option} takes points: make a map of it with `maomaps-warp map`"
        raise InputError(path, f"holds depth images, not a map (it was read as: {source.kind})", hint)
    return source.cloud


def _merged(path: Path) -> tuple[PointCloud | None, OccupancyGrid | None]:
    """The merged map as a cloud, or as an occupancy grid; of a bag with both the grid."""
    if holds_occupancy(path):
        return None, read_occupancy(path)
    return _cloud(path, "--merged"), None


def _dropped(clouds: tuple[PointCloud, ...]) -> list[str]:
    """Notes on lost points of the ground truth; its colours play no part here, so notes on them are left away."""
    lost = [cloud for cloud in clouds if cloud.dropped_nonfinite]
    return [f"{cloud.source}: {cloud.dropped_nonfinite} points are NaN or infinite and were dropped" for cloud in lost]


def _notes(maps: tuple[PointCloud | OccupancyGrid, ...]) -> list[str]:
    return [f"{map.source}: {note}" for map in maps for note in map.notes]
