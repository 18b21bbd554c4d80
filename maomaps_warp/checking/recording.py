"""Stamps that are missing, poses that jump, and which way is up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.checking.recorded import LARGEST_POSE_GAP_S
from maomaps_warp.model.check_results import Jump, StampFacts, UpAxis
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.scoring.stamp_search import nearest
from maomaps_warp.scoring.stamps import poses_at

F64 = NDArray[np.float64]

#: A gap above this many median gaps holds missing messages: as many as median gaps fit in it, less one.
GAP_OF_MEDIAN = 1.5
#: A pose jumps if its step is longer than JUMP_STEP_M and faster than JUMP_OF_USUAL times the speed that nine in ten
#: steps stay below, or, if jumps are so many that they raise that, than JUMP_SPEED, metres a second, and
#: JUMP_OF_MEDIAN times the median. A walking pace is no jump, however still the camera is kept else.
JUMP_STEP_M = 0.1
JUMP_OF_USUAL = 10.0
JUMP_SPEED = 10.0
JUMP_OF_MEDIAN = 5.0
WALKING_SPEED = 2.0
#: An axis of the world is its up if the cameras' mean up lies within this of it, radians (30 degrees), and they agree:
#: the mean of their unit vectors is at least so long.
UP_WITHIN_RAD = float(np.pi / 6.0)
UP_AGREEMENT = 0.7


def stamp_facts(what: str, stamps_ns: NDArray[np.int64]) -> StampFacts:
    """Rate and gaps of stamps, (N,) int64, N >= 1, ascending."""
    gaps = np.diff(stamps_ns)
    first, last = int(stamps_ns[0]), int(stamps_ns[-1])
    if not len(gaps):
        return StampFacts(what, 1, first, last, 0.0, 0.0, 0.0, 0, 0)
    median = float(np.median(gaps))
    wide = gaps[gaps > GAP_OF_MEDIAN * median] if median > 0 else gaps[:0]
    largest = int(np.argmax(gaps))
    return StampFacts(
        what=what,
        count=len(stamps_ns),
        first_ns=first,
        last_ns=last,
        median_gap_s=median * 1e-9,
        largest_gap_s=float(gaps[largest]) * 1e-9,
        largest_at_s=float(stamps_ns[largest] - first) * 1e-9,
        gaps=len(wide),
        missing=int((np.rint(wide / median) - 1).sum()) if len(wide) else 0,
    )


def partner_gaps(stamps_ns: NDArray[np.int64], partners_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Distance of each stamp, (N,) int64 ns, to the nearest partner; `partners_ns` ascends and is not empty."""
    return nearest(partners_ns, stamps_ns)[1]


def frames_without_pose(stamps_ns: NDArray[np.int64], poses: Trajectory) -> int:
    """How many frames have no two poses at most LARGEST_POSE_GAP_S apart around their stamp."""
    found, _ = poses_at(poses, stamps_ns, method="interpolate", max_gap_s=LARGEST_POSE_GAP_S)
    return len(stamps_ns) - len(found)


def pose_jumps(poses: Trajectory) -> tuple[Jump, ...]:
    """Steps that are implausibly fast, or without stamps implausibly long."""
    steps = np.linalg.norm(np.diff(poses.positions, axis=0), axis=1)
    if not len(steps):
        return ()
    stamps = poses.stamps_ns
    if stamps is None:
        usual = float(np.percentile(steps, 90.0))
        jumps = np.flatnonzero((steps > JUMP_STEP_M) & (steps > JUMP_OF_USUAL * usual))
        return tuple(Jump(int(k) + 1, None, float(steps[k]), None) for k in jumps)
    seconds = np.maximum(np.diff(stamps), 1) * 1e-9
    speeds = steps / seconds
    fast = max(JUMP_SPEED, JUMP_OF_MEDIAN * float(np.median(speeds)))
    limit = max(WALKING_SPEED, min(fast, JUMP_OF_USUAL * float(np.percentile(speeds, 90.0))))
    jumps = np.flatnonzero((steps > JUMP_STEP_M) & (speeds > limit))
    return tuple(
        Jump(int(k) + 1, float(stamps[k + 1] - stamps[0]) * 1e-9, float(steps[k]), float(speeds[k])) for k in jumps
    )


def up_axis(T_world_camera: F64) -> UpAxis:
    """The world's axis nearest to the cameras' mean up (their -y), from (N, 4, 4) float64 poses, N >= 1."""
    mean = -T_world_camera[:, :3, 1].mean(axis=0)
    length = float(np.linalg.norm(mean))
    k = int(np.argmax(np.abs(mean)))
    away = float(np.arccos(np.clip(abs(mean[k]) / max(length, 1e-12), 0.0, 1.0)))
    is_clear = away <= UP_WITHIN_RAD and length >= UP_AGREEMENT
    return UpAxis(f"{'+' if mean[k] > 0 else '-'}{'xyz'[k]}", away, length, is_clear)
