"""One map of several."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.model.voxels import KEY_BIAS, VoxelGrid, VoxelMap, pack_keys, unpack_keys
from maomaps_warp.protocol import ColorMean


def merge_maps(maps: Sequence[VoxelMap], *, color_mean: ColorMean = "rounded") -> VoxelMap:
    """The union of maps of one world.

    A cell of the union is a cell of any of them. Its count is the sum of theirs; its colour is the mean of theirs,
    weighted by the counts and rounded half up, or truncated. The union has colours only if every map has: a mean over
    some of the maps would pass for one over all. The order of the maps makes no difference.

    Args:
        maps: at least one, of one voxel size and one `center_offset`; their origins may differ.
        color_mean: "rounded" or "truncated".

    Returns:
        The union, sorted by key, on a grid whose origin lies in the middle of its extent.

    Raises:
        InputError: the maps lie farther apart than the indices of a grid reach.
        ValueError: no map, or maps of different lattices.
    """
    lattices = {(voxels.grid.voxel_size, voxels.grid.center_offset) for voxels in maps}
    if len(lattices) != 1:
        raise ValueError(f"maps must be of one lattice, got (voxel_size, center_offset) = {sorted(lattices)}")
    ((voxel_size, center_offset),) = lattices
    cells = np.concatenate([voxels.ijk.astype(np.int64) + voxels.grid.origin_ijk for voxels in maps])
    grid = VoxelGrid(voxel_size, _middle(cells, voxel_size), center_offset)
    keys, inverse = np.unique(pack_keys(cells - grid.origin_ijk), return_inverse=True)
    weights = np.concatenate([voxels.counts for voxels in maps])
    # Sums of whole numbers below 2^53 are exact in float64, whatever their order.
    counts = np.bincount(inverse, weights, len(keys)).astype(np.int64)
    colors = None
    if all(voxels.colors is not None for voxels in maps):
        samples = np.concatenate([voxels.colors for voxels in maps if voxels.colors is not None])
        sums = np.stack([np.bincount(inverse, weights * samples[:, c], len(keys)) for c in range(3)], axis=1)
        half = counts[:, None] if color_mean == "rounded" else 0
        colors = ((2 * sums.astype(np.int64) + half) // (2 * counts[:, None])).astype(np.uint8)
    return VoxelMap(grid, unpack_keys(keys), counts, colors)


def _middle(cells: NDArray[np.int64], voxel_size: float) -> NDArray[np.int64]:
    """The even index nearest to the middle of the extent of `cells`, (N, 3) int64; refused if it is too wide."""
    if not len(cells):
        return np.zeros(3, np.int64)
    low, high = cells.min(axis=0), cells.max(axis=0)
    if (high - low).max() > 2 * KEY_BIAS - 4:
        raise InputError(
            "merged map",
            f"the maps span {float((high - low).max()) * voxel_size:g} m",
            f"voxels of {voxel_size} m reach {(2 * KEY_BIAS - 4) * voxel_size:g} m: are the maps in one world?",
        )
    return np.asarray((low + high) // 4 * 2, dtype=np.int64)
