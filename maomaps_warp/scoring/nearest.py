"""Exact nearest neighbours between two clouds.

On a CPU clouds of one lattice are decided by a distance transform, free ones by packets over cells; what is too far for
either is left to the tree, which is the reference and the way on CUDA. All give the same bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.chunks import each_in_order, slices
from maomaps_warp.scoring.cell_search import search_cells
from maomaps_warp.scoring.lattice_nearest import LatticeClouds, exchanged, find_lattice, near_squares, step_of
from maomaps_warp.threads import thread_count

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
        index (Q,) int32 into `points`, of equally near ones the lowest, and distance (Q,) float64, metres.
    """
    index, squares = _search(*_clouds(queries, points), with_index=True, device=device)
    return index, np.sqrt(squares)


def nearest_distances(
    queries: NDArray[np.float64],
    points: NDArray[np.float64],
    device: str = "cpu",
    voxel_size: float | None = None,
) -> NDArray[np.float64]:
    """Distance from each of `queries` to the nearest of `points`; exact, no cut-off.

    Where both clouds lie on one lattice, the distance is its step times the root of an integer: free of the rounding of
    the coordinates. Elsewhere it is that of `nearest_neighbours`, to the last bit.

    Args:
        queries: (Q, 3) float64, metres.
        points: (N, 3) float64, metres, N >= 1.
        device: Warp device.
        voxel_size: the step of the lattice, metres, if the clouds may lie on one; None: looked for in the data.

    Returns:
        (Q,) float64, metres.
    """
    queries, points = _clouds(queries, points)
    clouds = find_lattice(queries, points, voxel_size, device, thread_count(device))
    if clouds is None:
        return np.sqrt(_search(queries, points, with_index=False, device=device)[1])
    return _lattice_distances(clouds, device)


def distances_between(
    first: NDArray[np.float64], second: NDArray[np.float64], device: str = "cpu"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`nearest_distances` both ways, which share the look for a lattice.

    Args:
        first, second: (N, 3) and (M, 3) float64, metres, N and M >= 1.
        device: Warp device.

    Returns:
        Of each of `first` to `second`, (N,) float64, and of each of `second` to `first`, (M,) float64; metres.
    """
    first, second = _clouds(first, second)
    _clouds(second, first)
    clouds = find_lattice(first, second, None, device, thread_count(device))
    # The way back looks for its step in the other cloud.
    if clouds is None or clouds.step != step_of(first):
        return nearest_distances(first, second, device), nearest_distances(second, first, device)
    return _lattice_distances(clouds, device), _lattice_distances(exchanged(clouds), device)


def _lattice_distances(clouds: LatticeClouds, device: str) -> NDArray[np.float64]:
    if device == "cpu":
        squares = near_squares(clouds, thread_count(device))
    else:
        squares = np.full(len(clouds.queries), -1, dtype=np.int32)
    distances = np.sqrt(squares, where=squares >= 0, out=np.empty(len(squares)))
    left = np.flatnonzero(squares < 0)
    if len(left):
        # Cells as coordinates: their squares are exact in float64.
        cells = [clouds.queries[left].astype(np.float64), clouds.points.astype(np.float64)]
        distances[left] = np.sqrt(_search(*cells, with_index=False, device=device)[1])
    distances *= clouds.step
    return distances


def _clouds(
    queries: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if not len(points):
        raise ValueError("points: expected at least one, got none")
    return np.ascontiguousarray(queries, dtype=np.float64), np.ascontiguousarray(points, dtype=np.float64)


def _search(
    queries: NDArray[np.float64], points: NDArray[np.float64], *, with_index: bool, device: str
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Index (empty if not asked for on a CPU) and squared distance of the nearest point: packets, then the tree."""
    if device != "cpu":
        return search_tree(queries, points, device)
    index, squares = search_cells(queries, points, with_index=with_index, threads=thread_count(device))
    left = np.flatnonzero(squares < 0)
    if len(left):
        left_index, squares[left] = search_tree(queries[left], points, device)
        if with_index:
            index[left] = left_index
    return index, squares


def search_tree(
    queries: NDArray[np.float64], points: NDArray[np.float64], device: str = "cpu"
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Index and squared distance of the nearest point, by the tree: the reference, and the way on CUDA."""
    import warp as wp

    from maomaps_warp.kernels.nearest import find_nearest

    tree = build_point_tree(points, device)
    on_device = wp.array(queries, dtype=wp.vec3d, device=device)
    chunks = slices(len(queries), _CHUNK_QUERIES)
    parts = each_in_order(lambda rows: find_nearest(tree, on_device[rows]).numpy(), chunks, device)
    index = np.concatenate([np.empty(0, dtype=np.int32), *parts])
    dx, dy, dz = (queries[:, axis] - points[index, axis] for axis in range(3))
    return index, dx * dx + dy * dy + dz * dz


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
