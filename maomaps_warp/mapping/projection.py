"""Maps projected on the ground plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.mapping.ground import GROUND_RULES, Ground, find_ground, ground_height
from maomaps_warp.model.occupancy import Cell, OccupancyGrid
from maomaps_warp.model.voxels import VoxelGrid, pack_keys

__all__ = ["GROUND_RULES", "Ground", "find_ground", "ground_height", "project", "projected_columns"]

#: Voxels up to this far from the ground, up or down, are ground; metres. As in the original program.
GROUND_TOLERANCE_M = 0.1
#: Voxels from above that up to below this height above the ground are obstacles; metres. As in the original program.
OBSTACLE_HEIGHT_M = 1.5
#: Heights above the ground are taken to this many decimals of a metre: 3 * 0.05 is no more than 0.15 then.
_DECIMALS = 6
#: More cells than this come from outliers or damage, not from a map.
MAX_CELLS = 1 << 28


def project(
    points: NDArray[np.float64], voxel_size: float, ground: Ground, source: str = "projection"
) -> OccupancyGrid:
    """The map seen from above, by the original program's rule, one cell a voxel column.

    A column with a voxel above the ground + 0.1 m and below the ground + 1.5 m is occupied; another one with a voxel
    within 0.1 m of the ground is free; everything else is unknown.

    Args:
        points: (N, 3) float64, metres, world with z up: voxel centres, multiples of `voxel_size`; N >= 1.
        voxel_size: edge of a voxel and of a cell, metres.
        ground: see `find_ground`.
        source: what is projected, for messages.

    Returns:
        The grid around all voxels of the map, also those that are neither ground nor obstacle; yaw 0.

    Raises:
        InputError: the map is too wide for an image.
    """
    if not len(points):
        raise ValueError("points: expected at least one, got none")
    grid = VoxelGrid.around(points, voxel_size)
    ij = grid.ijk_of(points)[:, :2]
    low = ij.min(axis=0)
    width, height = (int(n) for n in ij.max(axis=0) - low + 1)
    if width * height > MAX_CELLS:
        found = f"{width * voxel_size:g} x {height * voxel_size:g} m in cells of {voxel_size:g} m are too many"
        raise InputError(source, found, "remove outliers, or raise --voxel-size")
    cells = np.full((height, width), Cell.UNKNOWN, dtype=np.uint8)
    for kind, mask in _kinds(points, ground):
        column, row = (ij[mask] - low).T
        cells[row, column] = kind
    corner = (low + grid.origin_ijk[:2] - 0.5) * voxel_size
    notes = (ground.note,) if ground.note else ()
    return OccupancyGrid(cells, voxel_size, (float(corner[0]), float(corner[1]), 0.0), source, notes=notes)


def projected_columns(points: NDArray[np.float64], grid: VoxelGrid, ground: Ground) -> dict[Cell, NDArray[np.int64]]:
    """The columns that `project` makes free and occupied, as sorted keys (`pack_keys` of i, j, 0 on `grid`)."""
    ij = grid.ijk_of(points)
    ij[:, 2] = 0
    found = {kind: np.unique(pack_keys(ij[mask])) for kind, mask in _kinds(points, ground)}
    free = np.setdiff1d(found[Cell.FREE], found[Cell.OCCUPIED], assume_unique=True)
    return {Cell.FREE: free, Cell.OCCUPIED: found[Cell.OCCUPIED]}


def _kinds(points: NDArray[np.float64], ground: Ground) -> list[tuple[Cell, NDArray[np.bool_]]]:
    """Which voxels make their column free, and which occupied; the later kind wins."""
    above = np.round(points[:, 2] - ground.z, _DECIMALS)
    is_ground = np.abs(above) <= GROUND_TOLERANCE_M
    is_obstacle = (above > GROUND_TOLERANCE_M) & (above < OBSTACLE_HEIGHT_M)
    return [(Cell.FREE, is_ground), (Cell.OCCUPIED, is_obstacle)]
