"""Moves that are given, not found: of a start pose, of a transform and a scale, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.alignment import Alignment
from maomaps_warp.scoring.alignment import align


def start_pose_move(start_pose: tuple[float, float, float, float], yaw_correction: float = 0.0) -> Alignment:
    """The rule of MAOMaps: rotate about z by yaw + pi + correction, then add the start position.

    Args:
        start_pose: x, y, z (metres) and yaw (radians), as a `start_pose_*.txt` holds them.
        yaw_correction: radians, added to the yaw.
    """
    nothing = np.empty((0, 4, 4))
    return align("start-pose", nothing, nothing, yaw_correction=yaw_correction, start_pose=start_pose)


def similarity_move(T: NDArray[np.float64], scale: float = 1.0) -> Alignment:
    """p -> scale * R p + t, of a rigid transform, (4, 4) float64, metres."""
    return Alignment("se3" if scale == 1.0 else "sim3", T, scale)


def inverse_move(move: Alignment) -> Alignment:
    """The move that takes everything back: p -> R^T (p - t) / scale."""
    T = np.eye(4)
    T[:3, :3] = move.T_gt_est[:3, :3].T
    T[:3, 3] = -(T[:3, :3] @ move.T_gt_est[:3, 3]) / move.scale
    return Alignment(move.method, T, 1.0 / move.scale, move.pairs)
