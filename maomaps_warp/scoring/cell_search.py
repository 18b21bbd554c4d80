"""Exact nearest neighbours of free points on a CPU: the grids that the packet kernels search."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.device import prepare_kernels

#: How many points the grids are laid out by.
_SAMPLE = 2048
#: Points that share a cell with a point, about: more make packets compare in vain, fewer make more cells to look into.
_POINTS_OF_CELL = 4.0
#: Cells of a grid at most: 16 MB.
_MAX_CELLS = 1 << 22
#: So many times more pairs of points in one cell than is wished for, and packets would compare clusters by brute force:
#: clouds of very uneven density are left to the tree.
_TOO_CROWDED = 30.0
#: Share of the sample beyond the grid on each side of each axis, before the grid is widened by `_WIDENED`.
_BEYOND = 0.02
_WIDENED = 0.05
#: Edge of the cells that queries are sorted into, and widest packet, in cells of the points.
_QUERY_CELLS = 2.0
_WIDEST_PACKET = 3.0


def search_cells(
    queries: NDArray[np.float64], points: NDArray[np.float64], *, with_index: bool, threads: int = 1
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The nearest of `points` for each query that has one within a few cells.

    Args:
        queries, points: (Q, 3) and (N, 3) float64, metres, C-contiguous, N >= 1.
        with_index: whether the points are named, too.
        threads: how many the CPU uses.

    Returns:
        index (Q,) int32, of equally near ones the lowest (empty if not asked for), and squared distance (Q,) float64,
        metres^2; both -1 where none is near.
    """
    if not len(queries):
        return np.empty(0, dtype=np.int32), np.empty(0)
    lower, upper, cell_size, crowding = lay_out(points)
    if crowding > _TOO_CROWDED:
        return np.full(len(queries) if with_index else 0, -1, dtype=np.int32), np.full(len(queries), -1.0)
    _prepare_once()
    import warp as wp

    from maomaps_warp.kernels.nearest_packets import nearest_in_cells
    from maomaps_warp.kernels.point_cells import order_by_cells, points_in_order

    query_sample = _sample(queries)
    query_lower, query_upper = _bulk(query_sample)
    query_cell = _within_budget(query_upper - query_lower, _QUERY_CELLS * cell_size)
    grids = _grid(lower, upper, cell_size), _grid(query_lower, query_upper, query_cell)
    on_device = [wp.array(cloud, dtype=wp.vec3d, device="cpu", copy=False) for cloud in (points, queries)]
    (order, end), (query_order, _) = order_by_cells(list(zip(grids, on_device, strict=True)), threads=threads)
    in_order = points_in_order(on_device[0], order, threads=threads)
    squares, index = nearest_in_cells(
        grids[0],
        (in_order, order, end),
        (on_device[1], query_order),
        widest=_WIDEST_PACKET * cell_size,
        with_index=with_index,
        threads=threads,
    )
    return index.numpy(), squares.numpy()


@cache
def _prepare_once() -> None:
    """Most scores compare maps of voxels, and need none of these kernels."""
    prepare_kernels("cpu", "nearest")


def lay_out(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], float, float]:
    """A grid around the bulk of `points`, (N, 3) float64 metres.

    Returns:
        Its corners, the edge of its cells, metres, and how many times more pairs of points than wished share a cell.
    """
    sample = _sample(points)
    lower, upper = _bulk(sample)
    extent = upper - lower
    # From here only downwards: surfaces crowd fewer cells than a full volume would.
    size = float(extent.max()) / max(1.0, 0.5 * len(points) ** (1.0 / 3.0))
    if not size > 0.0:
        return lower, upper, 1.0, 0.0
    size = _within_budget(extent, size)
    # Two points of the sample share a cell as often as two of the cloud do.
    crowded = 0.5 * _POINTS_OF_CELL * len(sample) ** 2 / len(points)
    pairs = _pairs_in_cells(sample, lower, size)
    while pairs > crowded and _cells(extent, size / 1.4) <= _MAX_CELLS:
        size /= 1.4
        pairs = _pairs_in_cells(sample, lower, size)
    return lower, upper, size, pairs / crowded


def _sample(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points[:: -(-len(points) // _SAMPLE)]


def _bulk(sample: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of a box that leaves out outliers, however far they are."""
    in_order = np.sort(sample, axis=0)
    beyond = int(_BEYOND * len(sample))
    lower, upper = in_order[beyond], in_order[-1 - beyond]
    margin = _WIDENED * (upper - lower)
    return lower - margin, upper + margin


def _cells(extent: NDArray[np.float64], size: float) -> float:
    return float(np.prod(np.floor(extent / size) + 1.0))


def _within_budget(extent: NDArray[np.float64], size: float) -> float:
    while _cells(extent, size) > _MAX_CELLS:
        size *= 1.4
    return size


def _pairs_in_cells(sample: NDArray[np.float64], lower: NDArray[np.float64], size: float) -> float:
    cells = np.floor((sample - lower) / size)
    widths = cells.max(axis=0) - cells.min(axis=0) + 1.0
    numbers = (cells[:, 2] * widths[1] + cells[:, 1]) * widths[0] + cells[:, 0]
    counts = np.unique(numbers, return_counts=True)[1].astype(np.float64)
    return float((counts * (counts - 1.0)).sum()) / 2.0


def _grid(lower: NDArray[np.float64], upper: NDArray[np.float64], size: float) -> Any:
    import warp as wp

    from maomaps_warp.kernels.point_cells import CellGrid

    grid = CellGrid()
    grid.lower = wp.vec3d(*lower.tolist())
    grid.cells_per_metre = 1.0 / size
    grid.shape = wp.vec3i(*[int(cells) + 1 for cells in np.floor((upper - lower) / size)])
    return grid
