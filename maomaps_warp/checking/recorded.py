"""Recorded poses: as they stand in the source, and at the stamps of sampled frames."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.checking.sampling import FrameSample
from maomaps_warp.model.pose_convention import PoseConvention, inverse_poses, parse_convention
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.scoring.stamp_search import neighbours
from maomaps_warp.scoring.stamps import poses_at

#: A frame has a pose where two recorded poses at most this far apart stand around its stamp, seconds.
LARGEST_POSE_GAP_S = 0.2


def recorded_poses(trajectory: Trajectory) -> Trajectory:
    """The poses as recorded, whatever they were read as: `trajectory` with its `pose_frame` undone."""
    convention = parse_convention(trajectory.pose_frame)
    T = trajectory.T_world_camera
    if convention.yaw:
        c, s = math.cos(convention.yaw), math.sin(convention.yaw)
        T = T.copy()
        T[:, :3, :3] = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ T[:, :3, :3]
    if convention.axes != "optical":
        T_camera_axes = inverse_poses(replace(convention, is_inverse=False, order="xyzw", yaw=0.0).camera_poses(_EYE))
        T = T @ T_camera_axes
    if convention.is_inverse:
        T = inverse_poses(T)
    # Read "yzwx" the fields turn by one place, so three more such turns bring them back; "xzyw" undoes itself.
    again = PoseConvention("", order=convention.order)
    for _ in range({"xyzw": 0, "yzwx": 3, "xzyw": 1}[convention.order]):
        T = again.camera_poses(T)
    return replace(trajectory, T_world_camera=T, pose_frame="optical")


_EYE = np.eye(4)[None]


def select_posed(sample: FrameSample, recorded: Trajectory) -> tuple[FrameSample, Trajectory]:
    """The frames that have a pose, and of the recorded poses only those that they need.

    By stamp, between poses at most LARGEST_POSE_GAP_S apart; by index if the frames or the poses have no stamps.
    """
    if sample.stamps_ns is None or recorded.stamps_ns is None:
        posed = np.flatnonzero(sample.index < len(recorded))
        chosen = recorded.select(sample.index[posed])
        return sample.select(posed), replace(chosen, stamps_ns=None)
    if not len(recorded) or not len(sample):
        return sample.select(np.zeros(0, np.int64)), recorded
    posed, _ = poses_at(recorded, sample.stamps_ns, method="interpolate", max_gap_s=LARGEST_POSE_GAP_S)
    around = neighbours(recorded.stamps_ns, sample.stamps_ns[posed])
    return sample.select(posed), recorded.select(np.unique(np.concatenate(around)))


def camera_poses(sample: FrameSample, recorded: Trajectory, convention: PoseConvention) -> NDArray[np.float64]:
    """T_world_camera, (N, 4, 4) float64, of the frames and poses of `select_posed` under a convention.

    The camera's positions are interpolated, not the recorded ones: those of world-to-camera poses bend differently.
    """
    T = convention.camera_poses(recorded.T_world_camera)
    if sample.stamps_ns is None or recorded.stamps_ns is None:
        return T
    camera = replace(recorded, T_world_camera=T)
    _, T = poses_at(camera, sample.stamps_ns, method="interpolate", max_gap_s=LARGEST_POSE_GAP_S)
    return T
