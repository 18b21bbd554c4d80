"""The pose of a depth frame, from a trajectory."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.protocol import MatchMethod
from maomaps_warp.scoring.stamps import poses_at


def pose_of_frame(
    trajectory: Trajectory, stream: FrameStream, *, method: MatchMethod, max_gap_s: float
) -> Callable[[Frame], NDArray[np.float64] | None]:
    """A function from a frame to its pose T_world_camera, (4, 4) float64, metres; None where there is none.

    By stamp, with the rule that pairs trajectories; by index if the frames or the trajectory have no stamps.

    Raises:
        InputError: by index, and there are not as many poses as frames.
    """

    def by_index(frame: Frame) -> NDArray[np.float64] | None:
        if frame.index >= len(trajectory):
            raise InputError(
                trajectory.source,
                f"{len(trajectory)} poses for at least {frame.index + 1} frames of {stream.source}",
                "without stamps poses pair with frames by index: give one pose a frame, or stamps",
            )
        return np.asarray(trajectory.T_world_camera[frame.index])

    def by_stamp(frame: Frame) -> NDArray[np.float64] | None:
        if frame.stamp_ns is None:
            return by_index(frame)
        stamps = np.array([frame.stamp_ns], dtype=np.int64)
        found, poses = poses_at(trajectory, stamps, method=method, max_gap_s=max_gap_s)
        return poses[0] if len(found) else None

    if trajectory.stamps_ns is not None:
        return by_stamp
    if stream.count is not None and stream.count != len(trajectory):
        raise InputError(
            trajectory.source,
            f"{len(trajectory)} poses without stamps for {stream.count} frames of {stream.source}",
            "without stamps poses pair with frames by index: give one pose a frame, or stamps",
        )
    return by_index
