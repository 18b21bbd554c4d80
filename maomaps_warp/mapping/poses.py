"""Poses as maps need them: on the device, without pitch and roll, and without jumps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.pose_convention import T_BODY_CAMERA
from maomaps_warp.model.trajectory import Trajectory

#: A step of at least this many metres is a jump if it is also faster than this many m/s, which nobody carries a camera
#: indoors, and than this many times the median speed, which a vehicle keeps.
JUMP_METRES, JUMP_SPEED, JUMP_OVER_MEDIAN = 0.5, 5.0, 5.0


@dataclass(frozen=True)
class Jump:
    """The longest jump of a trajectory, from one pose to the next.

    Attributes:
        index: of the pose before it.
        metres, seconds: its length.
        jumps: how many there are in all.
    """

    index: int
    metres: float
    seconds: float
    jumps: int


def find_jump(trajectory: Trajectory) -> Jump | None:
    """The longest jump; None if there is none, or no stamps to tell."""
    if trajectory.stamps_ns is None or len(trajectory) < 2:
        return None
    metres = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1)
    seconds = np.maximum(np.diff(trajectory.stamps_ns), 1) * 1e-9
    speed = metres / seconds
    fastest_usual = max(JUMP_SPEED, JUMP_OVER_MEDIAN * float(np.median(speed)))
    jumps = np.flatnonzero((metres >= JUMP_METRES) & (speed > fastest_usual))
    if not len(jumps):
        return None
    longest = int(jumps[metres[jumps].argmax()])
    return Jump(longest, float(metres[longest]), float(seconds[longest]), len(jumps))


def heading_only(T_world_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """A pose, (4, 4) float64, of whose rotation only the heading is left: atan2(R10, R00) of the BODY's rotation R."""
    T_world_body = T_world_camera @ T_BODY_CAMERA.T  # a rotation: its transpose is its inverse
    yaw = math.atan2(T_world_body[1, 0], T_world_body[0, 0])
    level = np.eye(4)
    level[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    level[:3, 3] = T_world_camera[:3, 3]
    return np.asarray(level @ T_BODY_CAMERA)


def transforms_relative_to(origin: NDArray[np.float64], T_world_camera: NDArray[np.float64]) -> NDArray[np.float32]:
    """Poses as Warp stores them, relative to a map origin.

    The subtraction happens in float64: float32 would lose millimetres far from the world's zero.

    Args:
        origin: (3,) float64, metres, world.
        T_world_camera: (N, 4, 4) float64.

    Returns:
        (N, 7) float32: x y z, then the quaternion xyzw.
    """
    from scipy.spatial.transform import Rotation

    if not len(T_world_camera):
        return np.empty((0, 7), dtype=np.float32)
    xyzw = Rotation.from_matrix(T_world_camera[:, :3, :3]).as_quat()
    return np.concatenate([T_world_camera[:, :3, 3] - origin, xyzw], axis=1).astype(np.float32)
