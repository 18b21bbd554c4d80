"""Host poses to device poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


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
