"""AME by nearest neighbour, completeness, precision and recall, voxel overlap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.results import ThresholdScore, VoxelOverlap
from maomaps_warp.model.voxels import VoxelMap, pack_keys
from maomaps_warp.scoring.nearest import distances_between

#: Distances are rounded to this many decimals of a metre before they are compared with a threshold, so that a
#: neighbour at exactly one voxel is not decided by the last bit of a product, in georeferenced maps either.
_THRESHOLD_DECIMALS = 6


def distances_both_ways(
    est: NDArray[np.float64], gt: NDArray[np.float64], device: str = "cpu"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distance from each point to the nearest of the other cloud: exact, no cut-off.

    Args:
        est, gt: (N, 3) and (M, 3) float64, metres, aligned world; neither empty.
        device: Warp device.

    Returns:
        (N,) float64: estimate to ground truth (accuracy), metres; (M,) float64: the other way (completeness).
    """
    return distances_between(est, gt, device)


def threshold_scores(
    est_to_gt: NDArray[np.float64], gt_to_est: NDArray[np.float64], thresholds: Sequence[float]
) -> tuple[ThresholdScore, ...]:
    """Precision, recall and F-score at each of some distances, metres.

    A. Knapitsch et al., "Tanks and Temples", ACM TOG 36(4), 2017, eqs. 4 to 7.
    """
    accuracy, completeness = (np.round(distances, _THRESHOLD_DECIMALS) for distances in (est_to_gt, gt_to_est))
    scores = []
    for threshold in thresholds:
        precision, recall = (float(np.mean(distances < threshold)) for distances in (accuracy, completeness))
        both = precision + recall
        scores.append(ThresholdScore(threshold, precision, recall, 2.0 * precision * recall / both if both else 0.0))
    return tuple(scores)


def voxel_overlap(est: VoxelMap, gt: VoxelMap) -> VoxelOverlap:
    """Intersection over union of the occupied cells of two maps on one grid."""
    same_origin = np.array_equal(est.grid.origin_ijk, gt.grid.origin_ijk)
    if not same_origin or est.grid.voxel_size != gt.grid.voxel_size:
        raise ValueError("both maps must lie on one grid")
    # Each map's keys are sorted, and a stable sort merges what is sorted; a key that comes twice is in both.
    keys = np.sort(np.concatenate([pack_keys(est.ijk), pack_keys(gt.ijk)]), kind="stable")
    common = int(np.count_nonzero(keys[1:] == keys[:-1]))
    union = len(est) + len(gt) - common
    return VoxelOverlap(len(est), len(gt), common, common / union if union else 0.0)
