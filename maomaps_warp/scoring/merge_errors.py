"""How far a merged map is from the ground truth, inside and outside the overlap of the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.cloud_map import check_extent, lattice_of, voxelise
from maomaps_warp.model.merge_results import DoubledWalls, MergedMapScore
from maomaps_warp.model.results import NoValue
from maomaps_warp.model.statistics import Statistics
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap, pack_keys
from maomaps_warp.scoring.doubled_walls import find_doubled_walls
from maomaps_warp.scoring.nearest import nearest_distances, nearest_neighbours

Points = NDArray[np.float64]

#: Reason of what needs an overlap where there is none.
NO_OVERLAP = "the ground-truth maps of the runs do not overlap"


@dataclass(frozen=True, eq=False)
class MergedGroundTruth:
    """The merged ground truth, and who has seen what of it.

    Attributes:
        points: (M, 3) float64, metres: its elements as they are.
        voxels: its occupied cells.
        runs_of_points: (M,) int64: how many of the runs' maps hold the cell of each element.
        runs_of_voxels: (V,) int64: the same of each cell.
    """

    points: Points
    voxels: VoxelMap
    runs_of_points: NDArray[np.int64]
    runs_of_voxels: NDArray[np.int64]

    @property
    def has_overlap(self) -> bool:
        """Whether any element was seen by at least two runs."""
        return bool((self.runs_of_points >= 2).any())


def merged_ground_truth(points: Points, runs: Sequence[Points], voxel_size: float, source: str) -> MergedGroundTruth:
    """The merged ground truth on the lattice of multiples of `voxel_size`.

    Args:
        points: (M, 3) float64, metres, world, M >= 1.
        runs: (N, 3) float64, metres, world: the map of each run.
        voxel_size: metres.
        source: where they are from, for messages.

    Raises:
        InputError: a point beyond the reach of the lattice.
    """
    grid = VoxelGrid.around(points, voxel_size)
    for cloud in (points, *runs):
        check_extent(cloud, grid, source)
    voxels = voxelise(points, grid)
    keys = pack_keys(voxels.ijk)
    seen = np.zeros(len(keys), dtype=np.int64)
    for cloud in runs:
        seen += np.isin(keys, pack_keys(voxelise(cloud, grid).ijk), assume_unique=True)
    place = np.searchsorted(keys, pack_keys(grid.ijk_of(points)))
    return MergedGroundTruth(points, voxels, seen[place], seen)


def lattice_note(points: Points, voxel_size: float) -> str | None:
    """What is odd about a map whose voxels should be centred on multiples of `voxel_size` metres; None if nothing."""
    off, stride = lattice_of(points, voxel_size)
    if off:
        return (
            f"{off} of {len(points)} elements of the merged ground truth do not lie on multiples of {voxel_size:g} m: "
            "overlap and doubled walls take their cells, see --voxel-size"
        )
    if stride > 1:
        return (
            f"the merged ground truth lies on multiples of {stride * voxel_size:g} m: overlap and doubled walls want "
            f"--voxel-size {stride * voxel_size:g}"
        )
    return None


def map_error(est: Points, gt: Points, device: str = "cpu") -> Statistics | NoValue:
    """Distances from every point of `est` to the nearest of `gt`, (N, 3) float64 metres."""
    if not len(est) or not len(gt):
        return NoValue("a map has no points", asked=True)
    return _statistics(nearest_distances(est, gt, device))


def merged_map_score(
    points: Points, gt: MergedGroundTruth, *, wall_distance: float, device: str = "cpu"
) -> MergedMapScore:
    """AME of a merged map, inside and outside the overlap, and its doubled walls.

    Args:
        points: (N, 3) float64, metres, the ground truth's world, N >= 1.
        gt: the merged ground truth.
        wall_distance: how far behind or before a surface a second one is looked for, metres.
        device: Warp device.

    Raises:
        InputError: a point beyond the reach of the lattice.
    """
    nearest, distance = nearest_neighbours(points, gt.points, device)
    completeness = nearest_distances(gt.points, points, device)
    is_inside = gt.runs_of_points[nearest] >= 2
    counts = {
        "est_points": len(points),
        "gt_points": len(gt.points),
        "inside_overlap": int(is_inside.sum()),
        "outside_overlap": int((~is_inside).sum()),
        "gt_overlap": int((gt.runs_of_points >= 2).sum()),
        "gt_one_run": int((gt.runs_of_points == 1).sum()),
        "gt_no_run": int((gt.runs_of_points == 0).sum()),
    }
    inside: Statistics | NoValue = NoValue(NO_OVERLAP, asked=False)
    doubled: DoubledWalls | NoValue = NoValue(NO_OVERLAP, asked=False)
    if gt.has_overlap:
        inside = _part(distance[is_inside], "no point of the merged map lies in the overlap")
        check_extent(points, gt.voxels.grid, "the merged map")
        predicted = voxelise(points, gt.voxels.grid)
        doubled = find_doubled_walls(predicted, gt.voxels, gt.runs_of_voxels >= 2, wall_distance, device=device)
    outside = _part(distance[~is_inside], "every point of the merged map lies in the overlap")
    return MergedMapScore(_statistics(distance), _statistics(completeness), inside, outside, doubled, counts)


def _part(distances: NDArray[np.float64], reason: str) -> Statistics | NoValue:
    return Statistics.of(distances) or NoValue(reason, asked=False)


def _statistics(distances: NDArray[np.float64]) -> Statistics:
    found = Statistics.of(distances)
    if found is None:
        raise ValueError("a map has no points")
    return found
