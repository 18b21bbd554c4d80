"""How far a merge puts its maps from where they lie."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.merge_results import SuccessRule, TransformError
from maomaps_warp.model.occupancy import OccupancyGrid
from maomaps_warp.model.pose_convention import inverse_poses
from maomaps_warp.model.results import NoValue
from maomaps_warp.scoring.moves import start_pose_move

Pose = NDArray[np.float64]
Points = NDArray[np.float64]


def start_placement(start_pose: tuple[float, float, float, float], yaw_correction: float) -> Pose:
    """T_world_source, (4, 4) float64, metres, of a map that begins at a start pose of the data set."""
    return start_pose_move(start_pose, yaw_correction).T_gt_est


def moved(T: Pose, points: Points) -> Points:
    """Points, (N, 3) float64, metres, through a rigid transform; the identity leaves every bit."""
    if np.array_equal(T, np.eye(4)):
        return points
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def moved_grid(T: Pose, grid: OccupancyGrid) -> OccupancyGrid:
    """An occupancy grid through the x, y and yaw of a rigid transform."""
    x, y, yaw = grid.origin
    flat = _in_plane(T)
    corner = flat[:2, :2] @ np.array([x, y]) + flat[:2, 3]
    turn = math.remainder(yaw + math.atan2(flat[1, 0], flat[0, 0]), math.tau)
    return replace(grid, origin=(float(corner[0]), float(corner[1]), turn))


def reference_of(T_merged_source: Sequence[Pose | None]) -> int | None:
    """The source that the others are compared with: the first that was merged."""
    return next((i for i, T in enumerate(T_merged_source) if T is not None), None)


def transform_errors(
    T_gt_source: Sequence[Pose], T_merged_source: Sequence[Pose | None], *, is_planar: bool
) -> tuple[TransformError | NoValue, ...]:
    """Error of each source's transform relative to the reference source r, the first that was merged.

    E = (T_gt_r^-1 T_gt_i)^-1 (T_merged_r^-1 T_merged_i), its translation's length and its rotation's angle: the form
    of the relative pose error (J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012,
    eq. 2). Where a merge knows the plane alone, both relative transforms are first reduced to x, y and yaw.

    Args:
        T_gt_source: (4, 4) float64 of each source, metres: where it truly lies.
        T_merged_source: (4, 4) float64 of each source, metres: where the merge puts it; None if it does not.
        is_planar: the merge's transforms are two-dimensional.
    """
    reference = reference_of(T_merged_source)
    found: list[TransformError | NoValue] = []
    for i, (T_gt, T_merged) in enumerate(zip(T_gt_source, T_merged_source, strict=True)):
        if T_merged is None:
            found.append(NoValue("not merged", asked=True))
        elif reference is None or i == reference:
            found.append(NoValue("the others are compared with it", asked=False))
        else:
            T_merged_reference = T_merged_source[reference]
            assert T_merged_reference is not None
            true = _inverse(T_gt_source[reference]) @ T_gt
            merged = _inverse(T_merged_reference) @ T_merged
            if is_planar:
                true, merged = _in_plane(true), _in_plane(merged)
            E = _inverse(true) @ merged
            found.append(TransformError(float(np.linalg.norm(E[:3, 3])), rotation_angle(E), is_planar))
    return tuple(found)


def rotation_angle(T: Pose) -> float:
    """Angle of the rotation of T, (4, 4) float64: radians in [0, pi], exact near 0 and pi too."""
    R = T[:3, :3]
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return math.atan2(float(np.linalg.norm(axis)), float(np.trace(R)) - 1.0)


def is_placed_well(error: TransformError | NoValue, rule: SuccessRule) -> bool:
    """Whether a source that is not the reference lies within the rule's limits."""
    return isinstance(error, TransformError) and error.translation <= rule.max_m and error.rotation <= rule.max_rad


def with_true_heights(
    T_gt_source: Sequence[Pose], T_merged_source: Sequence[Pose | None], T_gt_base: Pose
) -> tuple[Pose | None, ...]:
    """Transforms of the plane with the heights that the sources truly have.

    Args:
        T_gt_source: (4, 4) float64 of each source, metres: where it truly lies.
        T_merged_source: (4, 4) float64 of each source, metres, z left at zero; None if it was not merged.
        T_gt_base: (4, 4) float64: what heights in the merged map are measured from, in the ground truth's world: the
            reference source, or the world itself.
    """
    lifted: list[Pose | None] = []
    for T_gt, T_merged in zip(T_gt_source, T_merged_source, strict=True):
        T = None if T_merged is None else T_merged.copy()
        if T is not None:
            T[2, 3] = (_inverse(T_gt_base) @ T_gt)[2, 3]
        lifted.append(T)
    return tuple(lifted)


def first_placement(T_gt_source: Sequence[Pose], T_merged_source: Sequence[Pose | None] | None) -> Pose:
    """T_gt_merged, (4, 4) float64, metres, that puts the reference source where it truly lies.

    Without transforms (None, or not one source merged) the merged map's frame is taken for the first source's.
    """
    reference = None if T_merged_source is None else reference_of(T_merged_source)
    if T_merged_source is None or reference is None:
        return T_gt_source[0]
    T_merged_reference = T_merged_source[reference]
    assert T_merged_reference is not None
    return np.asarray(T_gt_source[reference] @ _inverse(T_merged_reference))


def judge(
    runs: Sequence[str],
    errors: Sequence[TransformError | NoValue] | None,
    rule: SuccessRule,
    ame: float | None,
) -> tuple[bool | None, str]:
    """Whether a merge succeeded, and why.

    Args:
        runs: name of each source.
        errors: of `transform_errors`; None if the merge gave no transforms.
        rule: the limits.
        ame: mean AME of the merged map, metres; None if there is none.

    Returns:
        None if it cannot be told: there are no transforms, and the rule has no limit of the AME.
    """
    if errors is None and rule.max_ame is None:
        return None, "cannot be told without transforms; --success-ame judges by the AME"
    reasons = []
    for run, error in zip(runs, errors or [], strict=errors is not None):
        if isinstance(error, NoValue) and error.asked:
            reasons.append(f"{run} was {error.reason}")
        elif isinstance(error, TransformError) and not is_placed_well(error, rule):
            reasons.append(f"{run} is {error.translation:.3g} m and {math.degrees(error.rotation):.3g} deg off")
    if rule.max_ame is not None and not (ame is not None and ame <= rule.max_ame):
        reasons.append("there is no AME" if ame is None else f"its AME is {ame:.3g} m")
    limits = [] if errors is None else [f"{rule.max_m:g} m and {math.degrees(rule.max_rad):g} deg of each source"]
    limits += [] if rule.max_ame is None else [f"an AME of {rule.max_ame:g} m"]
    allowed = ", ".join(limits)
    return not reasons, f"{'; '.join(reasons)} (allowed: {allowed})" if reasons else f"within {allowed}"


def _inverse(T: Pose) -> Pose:
    return np.asarray(inverse_poses(T[None])[0])


def _in_plane(T: Pose) -> Pose:
    """T reduced to x, y and yaw."""
    yaw = math.atan2(T[1, 0], T[0, 0])
    flat = np.eye(4)
    flat[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    flat[:2, 3] = T[:2, 3]
    return flat
