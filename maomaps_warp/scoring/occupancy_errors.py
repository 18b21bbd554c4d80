"""Errors of an estimated map of the ground: 2D AME, and what it shares with the ground truth's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.model.occupancy import Cell, OccupancyGrid
from maomaps_warp.model.occupancy_results import OccupancyScore
from maomaps_warp.model.results import NoValue
from maomaps_warp.model.statistics import Statistics

#: Distances are taken to this many decimals of a metre, so that grids on one lattice agree exactly.
_DECIMALS = 9
#: Points this near to a cell's lower edge, in cells, lie in it: origins are rounded decimals.
_EDGE_CELLS = 1e-6
#: More cells of the ground truth's size than this under the estimate come from origins or sizes that are wrong.
MAX_CELLS = 1 << 28
#: Cells that are looked up at a time.
_BLOCK_CELLS = 1 << 20


@dataclass(frozen=True, eq=False)
class _Window:
    """A part of the ground truth's lattice.

    Attributes:
        cells: (H, W) uint8, a Cell each.
        row, column: of the ground truth's grid, where the window starts; may be negative.
    """

    cells: NDArray[np.uint8]
    row: int
    column: int


def occupancy_errors(est: OccupancyGrid, gt: OccupancyGrid) -> OccupancyScore:
    """Compare two maps of the ground of one world; their cells may differ in size, place and direction.

    The 2D AME is taken between centres of occupied cells. For the shares the estimate is put on the ground truth's
    lattice, continued beyond its edges. If its cells are at least as large, a cell takes what holds its centre. If
    they are smaller, it takes the strongest of those whose centres it holds, occupied before free before unknown, or
    what holds its own centre if it holds none.

    Args:
        est: the estimate.
        gt: the ground truth.

    Raises:
        InputError: the estimate covers more cells than any map could.
    """
    found, wanted = est.centers(est.cells == Cell.OCCUPIED), gt.centers(gt.cells == Cell.OCCUPIED)
    window = _on_lattice(est, gt)
    beneath = _cells_at(gt, found)
    counts = {
        f"{side}_{cell.name.lower()}": int(np.count_nonzero(grid.cells == cell))
        for side, grid in (("est", est), ("gt", gt))
        for cell in (Cell.OCCUPIED, Cell.FREE, Cell.UNKNOWN)
    }
    counts["est_occupied_on_gt_unknown"] = int(np.count_nonzero(beneath == Cell.UNKNOWN))
    counts["est_occupied_outside_gt"] = int(np.count_nonzero(beneath < 0))
    shares = {
        "known": _common_and_any(window, gt, lambda cells: cells != Cell.UNKNOWN),
        "occupied": _common_and_any(window, gt, lambda cells: cells == Cell.OCCUPIED),
    }
    for name, (common, either) in shares.items():
        counts |= {f"{name}_common": common, f"{name}_any": either}
    return OccupancyScore(
        ame=_ame(est, gt, found, wanted, counts),
        known_iou=_share(*shares["known"]),
        occupied_iou=_share(*shares["occupied"]),
        counts=counts,
    )


def _ame(
    est: OccupancyGrid,
    gt: OccupancyGrid,
    found: NDArray[np.float64],
    wanted: NDArray[np.float64],
    counts: dict[str, int],
) -> Statistics | NoValue:
    from scipy.spatial import cKDTree

    for side, grid, points in (("ground truth", gt, wanted), ("estimate", est, found)):
        if not len(points):
            return NoValue(f"{grid.source}: the {side} has no occupied cell", asked=True, counts=counts)
    distances = np.round(cKDTree(wanted).query(found)[0], _DECIMALS)
    statistics = Statistics.of(distances)
    assert statistics is not None, "there are distances, so there are statistics"
    return statistics


def _share(common: int, either: int) -> float | None:
    return common / either if either else None


def _common_and_any(
    window: _Window, gt: OccupancyGrid, chosen: Callable[[NDArray[np.uint8]], NDArray[np.bool_]]
) -> tuple[int, int]:
    """Cells of the lattice that both maps have chosen, and that at least one has."""
    rows = slice(max(window.row, 0), max(window.row + window.cells.shape[0], 0))
    columns = slice(max(window.column, 0), max(window.column + window.cells.shape[1], 0))
    of_gt = chosen(gt.cells[rows, columns])
    # The same cells, seen from the window's corner.
    top, left = rows.start - window.row, columns.start - window.column
    of_est = chosen(window.cells[top : top + of_gt.shape[0], left : left + of_gt.shape[1]])
    common = int(np.count_nonzero(of_gt & of_est))
    return common, int(np.count_nonzero(chosen(gt.cells)) + np.count_nonzero(chosen(window.cells))) - common


def _on_lattice(est: OccupancyGrid, gt: OccupancyGrid) -> _Window:
    """The estimate on the ground truth's lattice, as far as it reaches."""
    height, width = est.cells.shape
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) * est.resolution
    reach = _to_lattice(gt, _to_world(est, corners))
    low = np.floor(reach.min(axis=0) + _EDGE_CELLS)
    size = np.maximum(np.ceil(reach.max(axis=0) - _EDGE_CELLS) - low, 1.0)
    if size[0] * size[1] > MAX_CELLS:
        found = f"covers {size[0]:.0f} x {size[1]:.0f} cells of the ground truth's {gt.resolution:g} m"
        raise InputError(est.source, found, "check the resolution and the origin of both maps")
    window = _Window(np.empty((int(size[1]), int(size[0])), dtype=np.uint8), int(low[1]), int(low[0]))
    rows_at_once = max(1, _BLOCK_CELLS // window.cells.shape[1])
    for start in range(0, window.cells.shape[0], rows_at_once):
        block = window.cells[start : start + rows_at_once]
        row, column = np.indices(block.shape)
        centers = np.stack([column + window.column, row + window.row + start], axis=-1).reshape(-1, 2) + 0.5
        held = _cells_at(est, _to_world(gt, np.asarray(centers * gt.resolution, dtype=np.float64)))
        block[:] = np.where(held < 0, Cell.UNKNOWN, held).reshape(block.shape)
    if est.resolution < gt.resolution * (1.0 - _EDGE_CELLS):
        _put_strongest(est, gt, window)
    return window


def _put_strongest(est: OccupancyGrid, gt: OccupancyGrid, window: _Window) -> None:
    """Give each cell of the window the strongest of the estimate's smaller cells whose centres it holds."""
    strongest = np.full(window.cells.shape, -1, dtype=np.int8)
    for kind in (Cell.UNKNOWN, Cell.FREE, Cell.OCCUPIED):
        cell = np.floor(_to_lattice(gt, est.centers(est.cells == kind)) + _EDGE_CELLS).astype(np.int64)
        strongest[cell[:, 1] - window.row, cell[:, 0] - window.column] = kind
    held = strongest >= 0
    window.cells[held] = strongest[held].astype(np.uint8)


def _cells_at(grid: OccupancyGrid, points: NDArray[np.float64]) -> NDArray[np.int8]:
    """What the grid says at world points, (N, 2) float64 metres: (N,) int8, a Cell each, or -1 outside of it."""
    cell = np.floor(_to_lattice(grid, points) + _EDGE_CELLS)
    height, width = grid.cells.shape
    inside = (cell >= 0).all(axis=1) & (cell[:, 0] < width) & (cell[:, 1] < height)
    found = np.full(len(points), -1, dtype=np.int8)
    column, row = cell[inside].astype(np.int64).T
    found[inside] = grid.cells[row, column]
    return found


def _to_lattice(grid: OccupancyGrid, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """World points, (N, 2) metres, in the grid's own frame, in cells."""
    x, y, yaw = grid.origin
    return np.asarray((points - np.array([x, y])) @ _rotation(yaw) / grid.resolution)


def _to_world(grid: OccupancyGrid, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points of the grid's own frame, (N, 2) metres, in the world."""
    x, y, yaw = grid.origin
    return np.asarray(points @ _rotation(yaw).T + np.array([x, y]))


def _rotation(yaw: float) -> NDArray[np.float64]:
    """R_world_grid, (2, 2)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s], [s, c]])
