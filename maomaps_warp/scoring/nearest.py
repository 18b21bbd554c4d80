"""Exact nearest neighbours between two clouds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.chunks import each_in_order, slices

#: Points of a leaf: fewer make the tree deep, more make leaves slow.
_LEAF_POINTS = 8
#: Queries of one launch: long enough to hide its cost.
_CHUNK_QUERIES = 1 << 13


def nearest_neighbours(
    queries: NDArray[np.float64], points: NDArray[np.float64], device: str = "cpu"
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The nearest of `points` for each of `queries`; exact, no cut-off.

    Args:
        queries: (Q, 3) float64, metres.
        points: (N, 3) float64, metres, N >= 1.
        device: Warp device.

    Returns:
        index (Q,) int32 into `points`, and distance (Q,) float64, metres.
    """
    import warp as wp

    from maomaps_warp.kernels.nearest import find_nearest

    if not len(points):
        raise ValueError("points: expected at least one, got none")
    tree = build_point_tree(points, device)
    on_device = wp.array(queries, dtype=wp.vec3d, device=device)
    chunks = slices(len(queries), _CHUNK_QUERIES)
    parts = each_in_order(lambda rows: find_nearest(tree, on_device[rows]).numpy(), chunks, device)
    index = np.concatenate([np.empty(0, dtype=np.int32), *parts])
    return index, np.linalg.norm(queries - points[index], axis=1)


def build_point_tree(points: NDArray[np.float64], device: str = "cpu") -> Any:
    """kernels.nearest.PointTree over `points`, (N, 3) float64, metres, N >= 1."""
    import warp as wp

    from maomaps_warp.kernels.nearest import PointTree

    order = np.argsort(_morton_codes(points), kind="stable")
    in_order = points[order]
    leaves = 1 << max(0, int(np.ceil(np.log2(len(points) / _LEAF_POINTS))))
    start = (np.arange(leaves + 1, dtype=np.int64) * len(points)) // leaves
    lower = np.full((2 * leaves, 3), np.inf)
    upper = np.full((2 * leaves, 3), -np.inf)
    lower[leaves:] = np.minimum.reduceat(in_order, start[:-1], axis=0)
    upper[leaves:] = np.maximum.reduceat(in_order, start[:-1], axis=0)
    level = leaves
    while level > 1:
        parents = slice(level // 2, level)
        lower[parents] = lower[level : 2 * level].reshape(-1, 2, 3).min(axis=1)
        upper[parents] = upper[level : 2 * level].reshape(-1, 2, 3).max(axis=1)
        level //= 2
    tree = PointTree()
    tree.points = wp.array(in_order, dtype=wp.vec3d, device=device)
    tree.original = wp.array(order.astype(np.int32), dtype=wp.int32, device=device)
    tree.lower = wp.array(lower, dtype=wp.vec3d, device=device)
    tree.upper = wp.array(upper, dtype=wp.vec3d, device=device)
    tree.leaf_start = wp.array(start.astype(np.int32), dtype=wp.int32, device=device)
    return tree


def _bounds(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Column by column: reducing (N, 3) over its long axis is many times slower in NumPy.
    columns = [points[:, axis] for axis in range(3)]
    return np.array([c.min() for c in columns]), np.array([c.max() for c in columns])


def _morton_codes(points: NDArray[np.float64]) -> NDArray[np.uint64]:
    """Places on the Z-order curve, 21 bits an axis (Morton 1966): near in the order is near in space."""
    lower, upper = _bounds(points)
    extent = max(float((upper - lower).max()), 1e-9)
    cells = np.minimum((points - lower) * (float(1 << 21) / extent), (1 << 21) - 1).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for axis in range(3):
        spread = cells[:, axis]
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            spread = (spread | (spread << np.uint64(shift))) & np.uint64(mask)
        code |= spread << np.uint64(axis)
    return code
