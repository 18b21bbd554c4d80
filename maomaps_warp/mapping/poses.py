"""Poses as maps need them: on the device, and without pitch and roll."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.pose_convention import T_BODY_CAMERA


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
