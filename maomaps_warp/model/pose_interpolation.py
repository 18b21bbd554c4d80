"""Poses between poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def interpolate_poses(
    T_from: NDArray[np.float64], T_to: NDArray[np.float64], alpha: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Poses between `T_from` and `T_to`, (N, 4, 4) float64, at `alpha`, (N,) in [0, 1]: lerp and slerp."""
    from scipy.spatial.transform import Rotation

    R_from = Rotation.from_matrix(T_from[:, :3, :3])
    turn = (R_from.inv() * Rotation.from_matrix(T_to[:, :3, :3])).as_rotvec()
    T = T_from.copy()
    T[:, :3, :3] = (R_from * Rotation.from_rotvec(alpha[:, None] * turn)).as_matrix()
    T[:, :3, 3] += alpha[:, None] * (T_to[:, :3, 3] - T_from[:, :3, 3])
    return T
