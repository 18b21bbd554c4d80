"""Analytic worlds with answers known by construction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

F64 = NDArray[np.float64]
VOXEL = 0.05


def camera_pose(position: tuple[float, float, float], yaw: float, pitch: float = 0.0) -> F64:
    """T_world_camera of an optical frame that looks along `yaw` (about z up, from x) and up by `pitch`, radians."""
    body = Rotation.from_euler("ZYX", [yaw, -pitch, 0.0]).as_matrix()
    T = np.eye(4)
    T[:3, :3] = body @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    T[:3, 3] = position
    return T


def wall(x: float, y: tuple[float, float], z: tuple[float, float]) -> F64:
    """Voxel centres of a wall one voxel thick across the x axis, on multiples of the voxel size."""
    k, j, i = np.meshgrid(
        np.arange(round(z[0] / VOXEL), round(z[1] / VOXEL) + 1),
        np.arange(round(y[0] / VOXEL), round(y[1] / VOXEL) + 1),
        [round(x / VOXEL)],
        indexing="ij",
    )
    return np.stack([i.ravel(), j.ravel(), k.ravel()], axis=1) * VOXEL


def cluttered_room(seed: int, boxes: int = 6) -> F64:
    """Voxel centres of a 3 x 2.5 x 1.5 m room of one-voxel walls with random boxes in it."""
    rng = np.random.default_rng(seed)
    n = np.array([60, 50, 30])
    filled = np.zeros(n + 1, dtype=bool)
    filled[[0, -1]] = filled[:, [0, -1]] = filled[:, :, [0, -1]] = True
    for _ in range(boxes):
        low = rng.integers(3, n - 14)
        size = rng.integers(3, 10, size=3)
        filled[tuple(slice(a, a + s) for a, s in zip(low, size, strict=True))] = True
    return np.argwhere(filled) * VOXEL


def rendered_depth(
    distance: float, camera: tuple[int, int, float, float, float, float], T_world_camera: F64
) -> NDArray[np.float32]:
    """Depth image of the plane x = distance; camera = (width, height, fx, fy, cx, cy); 0 where it is not hit."""
    width, height, fx, fy, cx, cy = camera
    v, u = np.mgrid[0:height, 0:width]
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u, dtype=float)], axis=-1)
    along_x = rays @ T_world_camera[0, :3]
    with np.errstate(divide="ignore"):
        z = (distance - T_world_camera[0, 3]) / along_x
    return np.where(along_x > 0, z, 0.0).astype(np.float32)
