"""Taking the ceiling off a map, so that one can look into it from above."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.voxels import VoxelMap

#: Layers. A height that is a whole number of layers but for rounding counts as that number.
_ROUNDING = 1e-9


def remove_ceiling(voxels: VoxelMap, *, height: float | None = None, margin: float = 1.0) -> tuple[VoxelMap, int, str]:
    """Drop what lies too high.

    With `height`: every voxel whose centre lies above it. Without, by the rule of the original map creator: of the
    occupied z layers, in their order, the upper half begins at number count // 2 (from 0); its fullest layer (of
    equally full ones the lowest) is the ceiling, and every voxel more than ceiling - margin high is dropped. Whole
    layers are compared, not heights: 0.15 m is the third layer of 0.05 m, whatever floating point makes of it.

    Args:
        voxels: the map.
        height: metres, world z.
        margin: metres below the ceiling.

    Returns:
        The map, how many voxels were dropped, and a sentence on what was done.
    """
    size, layers = voxels.grid.voxel_size, _layers(voxels)
    if not len(layers):
        return voxels, 0, "the map is empty: no ceiling to remove"
    if height is not None:
        highest = math.floor(height / size - voxels.grid.center_offset + _ROUNDING)
        reason = f"ceiling: what lies above {height:g} m"
    else:
        ceiling = find_ceiling_layer(layers)
        highest = ceiling - math.ceil(margin / size - _ROUNDING)
        z = (ceiling + voxels.grid.center_offset) * size
        reason = f"ceiling at z = {z:.6g} m: what lies above {z - margin:.6g} m"
    kept = layers <= highest
    colors = None if voxels.colors is None else voxels.colors[kept]
    dropped = int(np.count_nonzero(~kept))
    lower = VoxelMap(voxels.grid, voxels.ijk[kept], voxels.counts[kept], colors)
    return lower, dropped, f"{reason} was removed, {dropped} of {len(voxels)} voxels"


def find_ceiling_layer(layers: NDArray[np.int64]) -> int:
    """The fullest layer of the upper half of the occupied ones; see `remove_ceiling`.

    Args:
        layers: (N,) int64, N >= 1, the layer of each voxel.
    """
    occupied, voxels_in = np.unique(layers, return_counts=True)
    upper = len(occupied) // 2
    return int(occupied[upper + int(voxels_in[upper:].argmax())])


def _layers(voxels: VoxelMap) -> NDArray[np.int64]:
    """World index of each voxel's z layer, (N,) int64."""
    return np.asarray(voxels.ijk[:, 2] + voxels.grid.origin_ijk[2], dtype=np.int64)
