"""Poses without pitch and roll, as the original made maps."""

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
