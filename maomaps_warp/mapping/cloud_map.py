"""Voxel maps from points, and the leaves OctoMap would make of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.mapping.chunks import slices
from maomaps_warp.model.voxels import KEY_BIAS, VoxelGrid, VoxelMap, pack_keys, unpack_keys

#: OctoMap's tree has 16 levels; the root's centre is the world's zero.
OCTREE_LEVELS = 16
#: Voxels. Points farther from the lattice than this are not on it; PCD's float32 moves them by less.
LATTICE_TOLERANCE = 0.05
#: Points of a chunk: so few that what NumPy makes of them on the way to their keys stays in a core's cache.
_CHUNK_POINTS = 1 << 14
#: Fewer points may have a common spacing by chance.
LATTICE_POINTS = 100


def check_extent(points: NDArray[np.float64], grid: VoxelGrid, source: str) -> None:
    """Refuse points too far from the grid's origin for a packed key.

    Raises:
        InputError: naming the farthest point and the limit.
    """
    if not len(points):
        return
    limit = (KEY_BIAS - 2) * grid.voxel_size
    # Of all coordinates at once, and then exactly: NumPy is many times slower along rows of three.
    if max(points.max() - grid.origin.min(), grid.origin.max() - points.min()) <= limit:
        return
    distance = np.abs(points - grid.origin).max(axis=1)
    if distance.max() > limit:
        worst = int(distance.argmax())
        x, y, z = points[worst]
        raise InputError(
            source,
            f"point {worst + 1} at {x:g} {y:g} {z:g} m is {distance[worst]:g} m away from the middle, "
            f"more than the {limit:g} m that voxels of {grid.voxel_size} m reach",
            "remove outliers, align the maps, or raise --voxel-size",
        )


def lattice_of(points: NDArray[np.float64], voxel_size: float) -> tuple[int, int]:
    """How well points are centres of voxels on multiples of the voxel size.

    Args:
        points: (N, 3) float64, metres, N >= 1.
        voxel_size: metres.

    Returns:
        How many lie off the lattice; and the greatest number of voxels that all points are multiples of apart: 1 unless
        they lie on a coarser lattice.
    """
    steps = points / voxel_size
    cells = np.rint(steps).astype(np.int64)
    off = int((np.abs(steps - cells) > LATTICE_TOLERANCE).any(axis=1).sum())
    stride = int(np.gcd.reduce(cells - cells[0], axis=None)) if len(points) >= LATTICE_POINTS else 1
    return off, max(stride, 1)


def voxelise(points: NDArray[np.float64], grid: VoxelGrid, colors: NDArray[np.uint8] | None = None) -> VoxelMap:
    """The voxels that hold `points`.

    Args:
        points: (N, 3) float64, metres, world.
        grid: the lattice.
        colors: (N, 3) uint8, or None; a voxel's colour is the mean of its points', rounded.
    """
    point_keys = np.empty(len(points), dtype=np.int64)
    for rows in slices(len(points), _CHUNK_POINTS):
        point_keys[rows] = pack_keys(grid.ijk_of(points[rows]))
    mean_colors = None
    if colors is None and np.all(point_keys[1:] > point_keys[:-1]):  # voxels in order, as most maps list them
        keys, counts = point_keys, np.ones(len(point_keys), dtype=np.int64)
    elif colors is None:
        keys, counts = np.unique(point_keys, return_counts=True)
    else:
        keys, inverse, counts = np.unique(point_keys, return_inverse=True, return_counts=True)
        sums = np.stack([np.bincount(inverse, weights=colors[:, c], minlength=len(keys)) for c in range(3)], axis=1)
        mean_colors = np.floor(sums / counts[:, None] + 0.5).astype(np.uint8)
    return VoxelMap(grid, unpack_keys(keys), counts.astype(np.int64), mean_colors)


def octomap_leaves(voxels: VoxelMap) -> NDArray[np.float64]:
    """Centres of the leaves that OctoMap keeps of a map of occupied cells.

    Eight occupied siblings are pruned into one coarse leaf, again and again; how often a cell was hit plays no
    role (seen on OctoMap 1.9.7: docs/protocol.md, `slam_comparison`).

    Args:
        voxels: a map on a floored grid (center_offset 0.5): OctoMap's cells.

    Returns:
        (L, 3) float64, metres, world; finest leaves first, each level in key order.
    """
    grid = voxels.grid
    half_extent = 1 << (OCTREE_LEVELS - 1)
    cells = voxels.ijk.astype(np.int64) + grid.origin_ijk + half_extent
    centers: list[NDArray[np.float64]] = []
    for level in range(OCTREE_LEVELS + 1):
        parents, inverse, children = np.unique(cells >> 1, axis=0, return_inverse=True, return_counts=True)
        full = children == 8
        kept = cells[~full[inverse.reshape(-1)]]
        centers.append(((kept + 0.5) * 2.0**level - half_extent) * grid.voxel_size)
        cells = parents[full]
        if not len(cells):
            break
    return np.concatenate(centers)
