"""The original way to make a map: NumPy for the points of a frame, then Python's loop over points, and dicts.

The loop does what the original's does for a point and no more: a tuple of NumPy integers, one dict of colours, one of
counts. (Averaging colours, which ours does, would make it slower still.)
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.camera import Camera

Counts = dict[tuple[int, int, int], int]


def map_of_frames(
    frames: Iterable[tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float64]]],
    camera: Camera,
    voxel_size: float,
    min_range: float,
    max_range: float,
) -> Counts:
    """Points in each voxel, by its index in the world; frames are (depth, colors, T_world_camera)."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1).reshape(
        -1, 3
    )
    color_of: dict[tuple[int, int, int], NDArray[np.uint8]] = {}
    count_of: Counts = {}
    for depth, colors, T_world_camera in frames:
        points = rays * depth.reshape(-1, 1).astype(np.float64)
        distance = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + points[:, 2] ** 2)
        kept = (distance > min_range) & (distance < max_range)
        world = points[kept] @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        cells = np.round(world / voxel_size).astype(np.int16)
        for row, color in zip(cells, colors.reshape(-1, 3)[kept], strict=True):
            cell = tuple(row)
            color_of[cell] = color
            count_of[cell] = count_of.get(cell, 0) + 1
    return count_of
