"""Pairing in time: which ground-truth pose belongs to which estimated pose.

All comparisons are made in integer nanoseconds. `nearest` follows the rule of evo 1.38, so that its numbers
can be compared; `interpolate` makes the ground-truth pose at the estimate's very stamp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError, NoScoreError
from maomaps_warp.model.pose_interpolation import interpolate_poses
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.protocol import MatchMethod
from maomaps_warp.scoring.stamp_diagnosis import StampDiagnosis, diagnose_shifted_stamps
from maomaps_warp.scoring.stamp_search import inside, nearest, neighbours

__all__ = [
    "StampDiagnosis",
    "StampMatches",
    "diagnose_stamps",
    "match_stamps",
    "poses_at",
    "shifted",
]


@dataclass(frozen=True, eq=False)
class StampMatches:
    """Poses paired in time (or by index).

    Attributes:
        est_index: (M,) int64 into the estimate, ascending; repeats only if `nearest` went through the ground
            truth because that has fewer poses.
        T_world_camera_gt: (M, 4, 4) float64, metres: the ground truth for each of these estimated poses.
        gt_index: (M,) int64 into the ground truth; None if it was interpolated.
        gaps_ns: (M,) int64, nanoseconds. `nearest`: |difference of the stamps|. `interpolate`: distance
            between the two ground-truth neighbours, 0 where the stamps are equal. `index`: 0.
        unmatched: how many estimated poses have no partner.
        method: "interpolate", "nearest", or "index" where a trajectory has no stamps.
    """

    est_index: NDArray[np.int64]
    T_world_camera_gt: NDArray[np.float64]
    gt_index: NDArray[np.int64] | None
    gaps_ns: NDArray[np.int64]
    unmatched: int
    method: Literal["interpolate", "nearest", "index"]

    def __len__(self) -> int:
        return len(self.est_index)


def match_stamps(
    gt: Trajectory, est: Trajectory, *, method: MatchMethod, max_gap_s: float, t_offset_s: float = 0.0
) -> StampMatches:
    """Pair the estimate's poses with the ground truth.

    `interpolate`: position by lerp and rotation by slerp between the two ground-truth neighbours of each
    estimated stamp, which must be at most `max_gap_s` apart. A ground-truth pose with exactly the estimate's
    stamp is returned bit for bit and needs no neighbours. Nothing is extrapolated.

    `nearest`: for each pose of the trajectory with fewer poses (the estimate if equal) the nearest stamp of
    the other, the earlier of two equally near ones, kept if |difference| <= max_gap_s. Several may share a
    partner.

    If either trajectory has no stamps, pose i belongs to pose i and the counts must be equal.

    Args:
        gt: ground truth.
        est: estimate.
        method: "interpolate" or "nearest".
        max_gap_s: seconds, inclusive; may be infinite.
        t_offset_s: seconds, added to the estimate's stamps.

    Raises:
        NoScoreError: nothing matched; the message holds what `diagnose_stamps` finds.
        InputError: by index, with unequal counts or an offset; a gap or an offset that is no usable number.
    """
    if method not in ("interpolate", "nearest"):
        raise ValueError(f"method must be 'interpolate' or 'nearest', got {method!r}")
    for trajectory in (gt, est):
        if not len(trajectory):
            raise NoScoreError(f"{trajectory.source}: the trajectory has no poses")
    if gt.stamps_ns is None or est.stamps_ns is None:
        return _match_by_index(gt, est, t_offset_s)
    stamps = shifted(est.stamps_ns, t_offset_s)
    match = _interpolate if method == "interpolate" else _nearest
    matches = match(gt.T_world_camera, gt.stamps_ns, stamps, _max_gap_ns(max_gap_s))
    if not len(matches):
        diagnosis = diagnose_stamps(gt, est, method=method, max_gap_s=max_gap_s, t_offset_s=t_offset_s)
        raise NoScoreError(f"{est.source}: no pose matches {gt.source} in time: {diagnosis}")
    return matches


def diagnose_stamps(
    gt: Trajectory, est: Trajectory, *, method: MatchMethod, max_gap_s: float, t_offset_s: float = 0.0
) -> StampDiagnosis:
    """How the stamps of two trajectories lie to each other, and which options would match more of them.

    A constant offset between two clocks cannot be read with certainty from stamps alone (regular ones fit at
    many offsets), so the best offset is a hint for a person and is never applied.

    Raises:
        ValueError: a trajectory without poses or without stamps.
        InputError: a gap or an offset that is no usable number.
    """
    if gt.stamps_ns is None or est.stamps_ns is None or not len(gt) or not len(est):
        raise ValueError("diagnose_stamps needs two trajectories with poses and stamps")
    return diagnose_shifted_stamps(
        gt.stamps_ns,
        shifted(est.stamps_ns, t_offset_s),
        method=method,
        max_gap_ns=_max_gap_ns(max_gap_s),
        offset_ns=_to_ns(t_offset_s),
    )


def poses_at(
    trajectory: Trajectory, stamps_ns: NDArray[np.int64], *, method: MatchMethod, max_gap_s: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Poses of a trajectory at given stamps, by the rules of `match_stamps`; `nearest` looks at every stamp.

    Args:
        trajectory: with stamps and poses.
        stamps_ns: (N,) int64, nanoseconds, ascending.
        method: "interpolate" or "nearest".
        max_gap_s: seconds, inclusive.

    Returns:
        (M,) int64, which of the stamps have a pose; (M, 4, 4) float64, these poses.
    """
    if trajectory.stamps_ns is None or not len(trajectory):
        raise ValueError("poses_at needs a trajectory with poses and stamps")
    T, among, max_gap_ns = trajectory.T_world_camera, trajectory.stamps_ns, _max_gap_ns(max_gap_s)
    if method == "nearest":
        index, gaps = nearest(among, stamps_ns)
        found = np.flatnonzero(gaps <= max_gap_ns)
        return found, T[index[found]]
    matches = _interpolate(T, among, stamps_ns, max_gap_ns)
    return matches.est_index, matches.T_world_camera_gt


def _match_by_index(gt: Trajectory, est: Trajectory, t_offset_s: float) -> StampMatches:
    without = est if est.stamps_ns is None else gt
    if len(gt) != len(est):
        raise InputError(
            without.source,
            f"no stamps, so poses pair by index; {len(gt)} ground-truth and {len(est)} estimated ones do not",
            "give both trajectories stamps, or equally many poses",
        )
    if t_offset_s != 0.0:
        raise InputError("--t-offset", f"{without.source} has no stamps to shift", "leave the option out")
    index = np.arange(len(est), dtype=np.int64)
    return StampMatches(index, gt.T_world_camera, index, np.zeros(len(est), np.int64), 0, "index")


def _interpolate(
    T_gt: NDArray[np.float64], gt_stamps: NDArray[np.int64], stamps: NDArray[np.int64], max_gap_ns: int
) -> StampMatches:
    before, after = neighbours(gt_stamps, stamps)
    gaps = gt_stamps[after] - gt_stamps[before]
    est_index = np.flatnonzero(inside(gt_stamps, stamps) & (gaps <= max_gap_ns))
    before, after, gaps = before[est_index], after[est_index], gaps[est_index]
    T = T_gt[before]  # a copy, and the answer where the stamps are equal
    between = np.flatnonzero(gaps)
    if len(between):
        lo, hi = before[between], after[between]
        alpha = (stamps[est_index[between]] - gt_stamps[lo]) / gaps[between]
        T[between] = interpolate_poses(T_gt[lo], T_gt[hi], alpha)
    return StampMatches(est_index, T, None, gaps, len(stamps) - len(est_index), "interpolate")


def _nearest(
    T_gt: NDArray[np.float64], gt_stamps: NDArray[np.int64], stamps: NDArray[np.int64], max_gap_ns: int
) -> StampMatches:
    if len(stamps) <= len(gt_stamps):
        est_index = np.arange(len(stamps), dtype=np.int64)
        gt_index, gaps = nearest(gt_stamps, stamps)
    else:
        gt_index = np.arange(len(gt_stamps), dtype=np.int64)
        est_index, gaps = nearest(stamps, gt_stamps)  # ascends, because both sets of stamps do
    kept = gaps <= max_gap_ns
    est_index, gt_index = est_index[kept], gt_index[kept]
    unmatched = len(stamps) - len(np.unique(est_index))
    return StampMatches(est_index, T_gt[gt_index], gt_index, gaps[kept], unmatched, "nearest")


def shifted(stamps: NDArray[np.int64], t_offset_s: float) -> NDArray[np.int64]:
    """Stamps, (N,) int64 nanoseconds, N >= 1, with an offset in seconds added.

    Raises:
        InputError: an offset that is no usable number.
    """
    if not math.isfinite(t_offset_s):
        raise InputError("--t-offset", f"{t_offset_s} is not a finite number of seconds")
    offset, limits = _to_ns(t_offset_s), np.iinfo(np.int64)
    if int(stamps[0]) + offset < limits.min or int(stamps[-1]) + offset > limits.max:
        raise InputError("--t-offset", f"{t_offset_s} s moves the stamps beyond what int64 nanoseconds hold")
    return np.asarray(stamps + offset)


def _max_gap_ns(max_gap_s: float) -> int:
    if math.isnan(max_gap_s) or max_gap_s < 0:
        raise InputError("--max-stamp-gap", f"{max_gap_s} is no length of time", "seconds, 0 or more")
    limit = int(np.iinfo(np.int64).max)
    return limit if math.isinf(max_gap_s) else min(_to_ns(max_gap_s), limit)


def _to_ns(seconds: float) -> int:
    """Nanoseconds; what float64 cannot hold becomes more than any stamp."""
    nanoseconds = seconds * 1e9
    return round(nanoseconds) if math.isfinite(nanoseconds) else round(math.copysign(2.0**64, seconds))
