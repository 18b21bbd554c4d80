"""What the stages find, as the results that reports show."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.correspondences import Correspondences
from maomaps_warp.model.paired_poses import PairedPoses
from maomaps_warp.model.results import NearestScore, NoValue, PoseErrors, RayScore, TrajectoryScore
from maomaps_warp.model.statistics import Statistics
from maomaps_warp.model.voxels import VoxelMap
from maomaps_warp.protocol import Protocol
from maomaps_warp.scoring.trajectory_errors import (
    DeltaUnit,
    absolute_trajectory_error,
    relative_pose_error,
)
from maomaps_warp.threads import side_by_side


def absolute_score(pairs: PairedPoses) -> TrajectoryScore:
    """ATE of paired poses."""
    result = absolute_trajectory_error(pairs.T_world_camera_gt, pairs.T_world_camera_est)
    return TrajectoryScore({"absolute": PoseErrors(result.translation, result.rotation)}, pairs.counts)


def relative_score(pairs: PairedPoses, protocol: Protocol) -> TrajectoryScore | NoValue:
    """RPE of paired poses over the protocol's steps; no value if there is not one step over frames."""
    steps: dict[DeltaUnit, float] = {"frames": protocol.rpe_frames, "metres": protocol.rpe_metres}
    if pairs.stamps_ns is not None:
        steps["seconds"] = protocol.rpe_seconds
    errors: dict[str, PoseErrors] = {}
    counts = pairs.counts
    for unit, delta in steps.items():
        result = relative_pose_error(
            pairs.T_world_camera_gt, pairs.T_world_camera_est, pairs.stamps_ns, delta=delta, unit=unit
        )
        counts[f"pairs_{unit}"] = 0 if result is None else result.pairs
        if result is not None:
            errors[unit] = PoseErrors(result.translation, result.rotation)
    if "frames" not in errors:
        reason = (
            f"only {len(pairs)} of the estimate's {pairs.est_poses} poses are paired, too few for a relative error "
            f"over {protocol.rpe_frames} frame(s): see --max-stamp-gap and --t-offset"
        )
        return NoValue(reason, asked=True, counts=counts)
    return TrajectoryScore(errors, counts)


def nearest_score(
    est: NDArray[np.float64],
    gt: NDArray[np.float64],
    est_voxels: VoxelMap,
    gt_voxels: VoxelMap,
    protocol: Protocol,
    device: str,
) -> NearestScore | NoValue:
    """AME by nearest neighbour between two clouds, (N, 3) float64 metres, and the overlap of their voxels."""
    from maomaps_warp.scoring.map_errors import distances_both_ways, threshold_scores, voxel_overlap

    if not len(est) or not len(gt):
        return NoValue("a map has no points", asked=True)
    est_to_gt, gt_to_est = distances_both_ways(est, gt, device)
    accuracy, completeness, thresholds, overlap = side_by_side(
        lambda: Statistics.of(est_to_gt),
        lambda: Statistics.of(gt_to_est),
        lambda: threshold_scores(est_to_gt, gt_to_est, protocol.thresholds),
        lambda: voxel_overlap(est_voxels, gt_voxels),
    )
    counts = {"est_points": len(est), "gt_points": len(gt)}
    return NearestScore(accuracy, completeness, thresholds, overlap, counts)


def ray_score(correspondences: Correspondences, pairs: PairedPoses, device: str) -> RayScore | NoValue:
    """AME by association; no value if nothing was associated, with the counts that say why."""
    from maomaps_warp.scoring.pair_errors import pair_errors

    counts = correspondences.counts | {"correspondences": len(correspondences), "poses": len(pairs)}
    errors = pair_errors(correspondences, pairs.T_world_camera_est, pairs.T_world_camera_gt, device)
    absolute, relative = side_by_side(*(partial(Statistics.of, error) for error in errors))
    if absolute is None or relative is None:
        classes = ("out_of_view", "occluded", "no_ground_truth", "total")
        spread = ", ".join(f"{counts[name]} {name.replace('_', ' ')}" for name in classes)
        reason = (
            f"no predicted element could be associated ({spread}): is the estimate aligned (--align), the camera right?"
        )
        return NoValue(reason, asked=True, counts=counts)
    return RayScore(absolute, relative, counts)
