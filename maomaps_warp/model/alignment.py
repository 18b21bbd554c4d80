"""The one transform that moves an estimate, trajectory and map alike, into the ground truth's world."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.protocol import AlignMethod


@dataclass(frozen=True, eq=False)
class Alignment:
    """A similarity from the estimate's world to the ground truth's: p_gt = scale * R @ p_est + t.

    Attributes:
        method: how it was found; "none" leaves everything as it is, bit for bit.
        T_gt_est: (4, 4) float64: R and t (metres); holds no scale.
        scale: metres of the ground truth per unit of the estimate; 1 except for "sim3".
        pairs: how many pose pairs it was found from.
    """

    method: AlignMethod = "none"
    T_gt_est: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    scale: float = 1.0
    pairs: int = 0

    def apply_points(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the estimate, (N, 3) float64: the same in the ground truth's world, metres."""
        if self.method == "none":
            return points
        R, t = self.T_gt_est[:3, :3], self.T_gt_est[:3, 3]
        return np.asarray(self.scale * (points @ R.T) + t)

    def apply_poses(self, T_world_camera: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses of the estimate, (N, 4, 4) float64: positions scale * R p + t, rotations R R_p (no scale)."""
        if self.method == "none":
            return T_world_camera
        moved = T_world_camera.copy()
        moved[:, :3, :3] = self.T_gt_est[:3, :3] @ T_world_camera[:, :3, :3]
        moved[:, :3, 3] = self.apply_points(T_world_camera[:, :3, 3])
        return moved

    def apply_trajectory(self, trajectory: Trajectory) -> Trajectory:
        """The estimate's trajectory in the ground truth's world; stamps and notes stay."""
        if self.method == "none":
            return trajectory
        return replace(trajectory, T_world_camera=self.apply_poses(trajectory.T_world_camera))
