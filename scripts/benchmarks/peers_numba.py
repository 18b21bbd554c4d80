"""A map by open addressing, compiled by numba: what a good programmer would write instead of the loop in Python.

It does the whole job: back-projection, a hash table with linear probing and integer sums, mean colours. Neighbouring
pixels often share a voxel, so the last slot is remembered. The table is given the size that suits the result.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.camera import Camera
from maomaps_warp.model.voxels import VoxelGrid


def compiled() -> Any:
    """The function `integrate(depth, colors, poses, camera, grid numbers, keys, sums)`, compiled when first called."""
    from numba import njit

    return njit(fastmath=False, nogil=True)(_integrate)


def map_of_frames(
    integrate: Any,
    depth: NDArray[np.float32],
    colors: NDArray[np.uint8],
    T_grid_camera: NDArray[np.float64],
    camera: Camera,
    grid: VoxelGrid,
    ranges: tuple[float, float],
    voxels: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint8]]:
    """Packed keys, ascending, counts and mean colours (truncated) of a map with about `voxels` voxels.

    `T_grid_camera`, (F, 4, 4), takes points into the grid, metres from its origin.
    """
    capacity = 1 << int(np.ceil(np.log2(2 * voxels)))
    keys = np.full(capacity, -1, dtype=np.int64)
    sums = np.zeros((capacity, 4), dtype=np.int32)
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    integrate(depth, colors, T_grid_camera, lens, ranges, 1.0 / grid.voxel_size, keys, sums)
    slots = np.flatnonzero(keys >= 0)
    slots = slots[np.argsort(keys[slots])]
    counts = sums[slots, 3]
    return keys[slots], counts.astype(np.int64), (sums[slots, :3] // counts[:, None]).astype(np.uint8)


def _integrate(depth: Any, colors: Any, poses: Any, lens: Any, ranges: Any, scale: Any, keys: Any, sums: Any) -> None:
    fx, fy, cx, cy = lens
    near, far = ranges[0] * ranges[0], ranges[1] * ranges[1]
    mask = len(keys) - 1
    frames, height, width = depth.shape
    last_key, slot = np.int64(-1), np.int64(0)
    for frame in range(frames):
        T = poses[frame]
        for row in range(height):
            b = (row - cy) / fy
            for column in range(width):
                z = np.float64(depth[frame, row, column])
                x, y = z * ((column - cx) / fx), z * b
                squared = x * x + y * y + z * z
                if not (squared > near and squared < far):
                    continue
                i = np.int64(np.rint((T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) * scale)) + 1048576
                j = np.int64(np.rint((T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) * scale)) + 1048576
                k = np.int64(np.rint((T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]) * scale)) + 1048576
                key = (i << 42) | (j << 21) | k
                if key != last_key:
                    # Teschner et al. 2003, Optimized spatial hashing: three large primes.
                    slot = ((i * 73856093) ^ (j * 19349663) ^ (k * 83492791)) & mask
                    while keys[slot] != key and keys[slot] != -1:
                        slot = (slot + 1) & mask
                    keys[slot] = key
                    last_key = key
                sums[slot, 0] += colors[frame, row, column, 0]
                sums[slot, 1] += colors[frame, row, column, 1]
                sums[slot, 2] += colors[frame, row, column, 2]
                sums[slot, 3] += 1
