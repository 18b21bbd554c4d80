"""Absolute trajectory error and relative pose error of paired poses.

Below, Q is the ground truth and P the estimate, both camera to world, already aligned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError, NoScoreError
from maomaps_warp.model.statistics import Statistics

DeltaUnit = Literal["frames", "metres", "seconds"]

#: Pairs of poses that are looked up (seconds; all pairs in metres) may miss delta by this share of it,
#: inclusive: evo's default for all pairs.
DELTA_TOLERANCE = 0.1


@dataclass(frozen=True, eq=False)
class AteResult:
    """Absolute trajectory error.

    Attributes:
        translation: of |p_est - p_gt|, metres.
        rotation: of the angle between the orientations, radians.
        pairs: M, how many pairs of poses were compared.
        translation_errors, rotation_errors: (M,) float64, metres and radians, one a pair, in order.
    """

    translation: Statistics
    rotation: Statistics
    pairs: int
    translation_errors: NDArray[np.float64]
    rotation_errors: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RpeResult:
    """Relative pose error.

    Attributes:
        translation: of the difference of the motions, metres.
        rotation: of the angle between the motions' rotations, radians.
        pairs: K, how many motions were compared.
        delta, unit, all_pairs: which motions.
        translation_errors, rotation_errors: (K,) float64, metres and radians, one a motion.
        first, second: (K,) int64: the motion goes from pose first to pose second of the arrays given.
    """

    translation: Statistics
    rotation: Statistics
    pairs: int
    delta: float
    unit: DeltaUnit
    all_pairs: bool
    translation_errors: NDArray[np.float64]
    rotation_errors: NDArray[np.float64]
    first: NDArray[np.int64]
    second: NDArray[np.int64]


def absolute_trajectory_error(T_gt: NDArray[np.float64], T_est: NDArray[np.float64]) -> AteResult:
    """ATE of paired poses, (M, 4, 4) float64 each, metres, one world.

    Translation: |p_est - p_gt|; its rmse is the ATE of the MAOMaps paper. Rotation: the angle of
    E = P^-1 Q.

    Raises:
        NoScoreError: no pairs.
    """
    _check_paired(T_gt, T_est)
    translation_errors = np.linalg.norm(T_est[:, :3, 3] - T_gt[:, :3, 3], axis=1)
    rotation_errors = rotation_angles(_transposed(T_est[:, :3, :3]) @ T_gt[:, :3, :3])
    translation, rotation = Statistics.of(translation_errors), Statistics.of(rotation_errors)
    if translation is None or rotation is None:
        raise NoScoreError("absolute trajectory error: no pair of poses to compare")
    return AteResult(translation, rotation, len(T_gt), translation_errors, rotation_errors)


def relative_pose_error(
    T_gt: NDArray[np.float64],
    T_est: NDArray[np.float64],
    stamps_ns: NDArray[np.int64] | None = None,
    *,
    delta: float = 1,
    unit: DeltaUnit = "frames",
    all_pairs: bool = False,
) -> RpeResult | None:
    """RPE of paired poses: how far each motion of the estimate is from that of the ground truth.

    E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) (Sturm et al., IROS 2012, as evo computes it): |trans(E)| and the angle
    of rot(E). The pairs (i, j):

    - frames: j = i + delta; without `all_pairs` the next motion begins where the last one ended.
    - metres, along the ground truth: from i on, steps are summed until they reach delta; there the motion
      ends and the next begins. With `all_pairs`: for every i the later pose whose path from i is nearest to
      delta, if it misses delta by at most a tenth (DELTA_TOLERANCE).
    - seconds: j is the later pose with the stamp nearest to stamp i + delta, with the same tolerance.
      Without `all_pairs` the next motion begins at j, or at i + 1 if there is no such j.

    evo pairs along the estimate unless it is told `--pairs_from_reference`; here it is always the ground
    truth, so that the pairs do not depend on what is judged.

    Args:
        T_gt: (M, 4, 4) float64, metres.
        T_est: (M, 4, 4) float64, metres.
        stamps_ns: (M,) int64, nanoseconds, ascending; needed for seconds only.
        delta: length of a motion, > 0, in `unit`; a whole number for frames.
        unit: "frames", "metres" or "seconds".
        all_pairs: overlapping motions too.

    Returns:
        The result, or None if no motion is that long.

    Raises:
        InputError: a delta that is no length, or seconds without stamps.
    """
    _check_paired(T_gt, T_est)
    _check_delta(delta, unit)
    if unit == "frames":
        first, second = _pairs_by_frames(len(T_gt), int(delta), all_pairs)
    elif unit == "metres":
        first, second = _pairs_by_path(T_gt[:, :3, 3], delta, all_pairs)
    elif stamps_ns is None:
        raise InputError("RPE", "a delta in seconds needs stamps, and the poses have none", "use frames or metres")
    else:
        first, second = _pairs_by_time(stamps_ns, delta, all_pairs)
    E = _relative_errors(T_gt, T_est, first, second)
    translation_errors = np.linalg.norm(E[:, :3, 3], axis=1)
    rotation_errors = rotation_angles(E[:, :3, :3])
    translation, rotation = Statistics.of(translation_errors), Statistics.of(rotation_errors)
    if translation is None or rotation is None:
        return None
    return RpeResult(
        translation,
        rotation,
        len(E),
        delta,
        unit,
        all_pairs,
        translation_errors,
        rotation_errors,
        first,
        second,
    )


def paper_rpe(T_gt: NDArray[np.float64], T_est: NDArray[np.float64]) -> Statistics | None:
    """RPE as printed in the MAOMaps paper: consecutive poses, translation only, metres; None below two poses.

    |R_gt_t^T (p_gt_t+1 - p_gt_t) - R_est_t^T (p_est_t+1 - p_est_t)|, with the full rotations (the
    original program turned by the yaw alone). The vectors are the translations of Q_t^-1 Q_t+1 and
    P_t^-1 P_t+1; E of `relative_pose_error` turns their difference by the inverse of the ground truth's
    relative rotation, which keeps its length: this equals its translation with delta = 1 frame.
    """
    _check_paired(T_gt, T_est)
    difference = _local_steps(T_gt) - _local_steps(T_est)
    return Statistics.of(np.linalg.norm(difference, axis=1))


def rotation_angles(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles of rotation matrices, (N, 3, 3) float64: (N,) float64 radians in [0, pi].

    atan2 of sine and cosine is exact to rounding everywhere; acos of the trace loses half of the digits near
    0 and pi.
    """
    axis = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    trace = np.trace(R, axis1=1, axis2=2)
    return np.asarray(np.arctan2(np.linalg.norm(axis, axis=1), trace - 1.0))


def _check_paired(T_gt: NDArray[np.float64], T_est: NDArray[np.float64]) -> None:
    if T_gt.ndim != 3 or T_gt.shape[1:] != (4, 4) or T_gt.shape != T_est.shape:
        raise ValueError(f"poses must be two arrays (M, 4, 4), got {T_gt.shape} and {T_est.shape}")


def _check_delta(delta: float, unit: str) -> None:
    if unit not in ("frames", "metres", "seconds"):
        raise ValueError(f"unit must be frames, metres or seconds, got {unit!r}")
    if not (np.isfinite(delta) and delta > 0):
        raise InputError("RPE", f"delta {delta} {unit}", "give a length above 0")
    if unit == "frames" and delta != int(delta):
        raise InputError("RPE", f"delta {delta} frames", "give a whole number of frames")


def _pairs_by_frames(count: int, delta: int, all_pairs: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    first = np.arange(0, max(count - delta, 0), 1 if all_pairs else delta, dtype=np.int64)
    return first, first + delta


def _pairs_by_path(
    positions: NDArray[np.float64], delta: float, all_pairs: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    if all_pairs:
        path = np.concatenate([np.zeros(1), np.cumsum(steps)])[: len(positions)]
        return _kept(_nearest_later(path, delta, DELTA_TOLERANCE * delta))
    ends, travelled = [0], 0.0
    for i, step in enumerate(steps.tolist(), start=1):
        travelled += step
        if travelled >= delta:
            ends.append(i)
            travelled = 0.0
    chain = np.array(ends, dtype=np.int64)
    return chain[:-1], chain[1:]


def _pairs_by_time(
    stamps_ns: NDArray[np.int64], delta_s: float, all_pairs: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    later = _nearest_later(stamps_ns, round(delta_s * 1e9), round(DELTA_TOLERANCE * delta_s * 1e9))
    if all_pairs:
        return _kept(later)
    first, i = [], 0
    while i < len(later):
        if later[i] >= 0:
            first.append(i)
        i = max(int(later[i]), i + 1)
    index = np.array(first, dtype=np.int64)
    return index, later[index]


def _nearest_later(values: NDArray[Any], delta: float, tolerance: float) -> NDArray[np.int64]:
    """For each i the j > i with values[j] nearest to values[i] + delta, the earlier of two; -1 if too far.

    `values`, (N,) int64 or float64, ascend; of equal values the first is taken.
    """
    later = np.full(len(values), -1, dtype=np.int64)
    if len(values) < 2:
        return later
    start = np.arange(len(values) - 1)
    target = values[:-1] + delta
    above = np.clip(np.searchsorted(values, target, side="left"), start + 1, len(values) - 1)
    below = np.maximum(np.searchsorted(values, values[above - 1], side="left"), start + 1)
    nearest = np.where(np.abs(target - values[below]) <= np.abs(values[above] - target), below, above)
    later[:-1] = np.where(np.abs(values[nearest] - target) <= tolerance, nearest, -1)
    return later


def _kept(later: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    first = np.flatnonzero(later >= 0)
    return first, later[first]


def _relative_errors(
    T_gt: NDArray[np.float64],
    T_est: NDArray[np.float64],
    first: NDArray[np.int64],
    second: NDArray[np.int64],
) -> NDArray[np.float64]:
    motion_gt = _inverse(T_gt[first]) @ T_gt[second]
    motion_est = _inverse(T_est[first]) @ T_est[second]
    return np.asarray(_inverse(motion_gt) @ motion_est)


def _local_steps(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Steps to the next position, each in the frame of the pose it leaves, (M - 1, 3)."""
    steps = np.diff(T[:, :3, 3], axis=0)
    return np.asarray((_transposed(T[:-1, :3, :3]) @ steps[:, :, None])[:, :, 0])


def _inverse(T: NDArray[np.float64]) -> NDArray[np.float64]:
    inverse = T.copy()
    inverse[:, :3, :3] = _transposed(T[:, :3, :3])
    inverse[:, :3, 3] = -(inverse[:, :3, :3] @ T[:, :3, 3, None])[:, :, 0]
    return inverse


def _transposed(R: NDArray[np.float64]) -> NDArray[np.float64]:
    return R.transpose(0, 2, 1)
