"""How much of a scene several maps share: intersections over unions of projections and of voxels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.projection import Ground, projected_columns
from maomaps_warp.model.dataset import OverlapFigures
from maomaps_warp.model.occupancy import Cell
from maomaps_warp.model.voxels import VoxelGrid, pack_keys


def map_overlap(maps: Sequence[NDArray[np.float64]], voxel_size: float, ground: Ground) -> OverlapFigures:
    """How much the maps overlap, by three measures; none of them asks whether free and occupied agree.

    Each is the share of what any map holds that at least two maps hold: for two maps the usual IoU.

    Args:
        maps: voxel centres of each map, (N, 3) float64, metres, one world with z up, multiples of `voxel_size`; two
            maps or more, some of which may be empty.
        voxel_size: edge of a voxel, metres.
        ground: that all maps are projected on.
    """
    if len(maps) < 2:
        raise ValueError(f"an overlap takes two maps or more, got {len(maps)}")
    together = np.concatenate(maps)
    grid = VoxelGrid.around(together if len(together) else np.zeros((1, 3)), voxel_size)
    columns = [projected_columns(points, grid, ground) for points in maps]
    seen = {
        "known": [np.concatenate(list(kinds.values())) for kinds in columns],
        "obstacle": [kinds[Cell.OCCUPIED] for kinds in columns],
        "voxel": [np.unique(pack_keys(grid.ijk_of(points))) for points in maps],
    }
    counts: dict[str, int] = {}
    iou: dict[str, float | None] = {}
    for name, keys in seen.items():
        # No map holds a key twice, so how often it comes is how many maps hold it.
        times = np.unique(np.concatenate(keys), return_counts=True)[1]
        common, either = int(np.count_nonzero(times > 1)), len(times)
        counts |= {f"{name}_common": common, f"{name}_any": either}
        iou[name] = common / either if either else None
    return OverlapFigures(iou["known"], iou["obstacle"], iou["voxel"], counts)
