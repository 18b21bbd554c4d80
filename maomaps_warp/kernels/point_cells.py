"""Points sorted into the cells of a bounded grid, by counting.

Points beyond the grid belong to its border cells. The cell of a coordinate never falls as the coordinate rises, so a
box of cells still holds every point of the box of space; an outlier costs a little time, not memory. Cost: four passes
over the points and one over the cells; the counting is serial, but clouds are counted side by side.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import NEAREST
from maomaps_warp.kernels.ranges import launch_ranges

#: Points of one range of a launch.
_GRAIN = 1 << 15


@wp.struct
class CellGrid:
    """A grid of cubic cells over a part of space, metres."""

    lower: wp.vec3d  # its lowest corner
    cells_per_metre: wp.float64
    shape: wp.vec3i  # cells of each axis


@wp.func
def cell_on_axis(grid: CellGrid, axis: wp.int32, coordinate: wp.float64) -> wp.int32:
    """Cell of a coordinate on one axis; beyond the grid its border cell."""
    scaled = (coordinate - grid.lower[axis]) * grid.cells_per_metre
    last = grid.shape[axis] - 1
    # Compared before it becomes an integer: the cell of a far outlier has no int32.
    inside = wp.where(scaled > wp.float64(0.0), scaled, wp.float64(0.0))
    return wp.where(inside < wp.float64(last), wp.int32(inside), last)


@wp.func
def cell_number(grid: CellGrid, i: wp.int32, j: wp.int32, k: wp.int32) -> wp.int32:
    """Number of a cell; cells that follow one another on the first axis have numbers that follow one another."""
    return (k * grid.shape[1] + j) * grid.shape[0] + i


@wp.kernel(module=NEAREST)
def _number_kernel(
    # In:
    start: wp.int32,
    grid: CellGrid,
    points: wp.array(dtype=wp.vec3d),
    # Out:
    out_cell: wp.array(dtype=wp.int32),
):
    i = start + wp.tid()
    p = points[i]
    out_cell[i] = cell_number(
        grid, cell_on_axis(grid, 0, p[0]), cell_on_axis(grid, 1, p[1]), cell_on_axis(grid, 2, p[2])
    )


@wp.kernel(module=NEAREST)
def _count_kernel(
    # In:
    cell: wp.array(dtype=wp.int32),
    # Out:
    out_first: wp.array(dtype=wp.int32),
):
    # One task, so that the order within a cell is that of the caller's cloud.
    for i in range(cell.shape[0]):
        out_first[cell[i]] += 1
    total = int(0)
    for c in range(out_first.shape[0]):
        here = out_first[c]
        out_first[c] = total
        total += here


@wp.kernel(module=NEAREST)
def _place_kernel(
    # In:
    cell: wp.array(dtype=wp.int32),
    # In and out: the next free place of each cell.
    first: wp.array(dtype=wp.int32),
    # Out:
    out_order: wp.array(dtype=wp.int32),
):
    for i in range(cell.shape[0]):
        place = first[cell[i]]
        first[cell[i]] = place + 1
        out_order[place] = i


@wp.kernel(module=NEAREST)
def _take_kernel(
    # In:
    start: wp.int32,
    points: wp.array(dtype=wp.vec3d),
    order: wp.array(dtype=wp.int32),
    # Out:
    out_points: wp.array(dtype=wp.vec3d),
):
    i = start + wp.tid()
    out_points[i] = points[order[i]]


def order_by_cells(clouds: Sequence[tuple[CellGrid, wp.array]], *, threads: int = 1) -> list[tuple[wp.array, wp.array]]:
    """Orders of clouds by their cells; points of one cell in the order given. On a CPU.

    Args:
        clouds: each a grid and points, (N,) vec3d, metres, finite.
        threads: how many a CPU uses.

    Returns:
        For each cloud the places of its points, (N,) int32, cell by cell, and where each cell ends among them, (cells,)
        int32: cell c starts where cell c - 1 ends.
    """
    numbers = [_cell_numbers(grid, points, threads) for grid, points in clouds]
    cells = [grid.shape[0] * grid.shape[1] * grid.shape[2] for grid, _ in clouds]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(_counted, numbers, cells))


def _cell_numbers(grid: CellGrid, points: wp.array, threads: int) -> wp.array:
    device = points.device
    check_array("points", points, wp.vec3d, (None,), device)
    cell = wp.empty(len(points), dtype=wp.int32, device=device)
    inputs = [grid, points]
    launch_ranges(
        _number_kernel, len(points), inputs=inputs, outputs=[cell], device=device, threads=threads, grain=_GRAIN
    )
    return cell


def _counted(cell: wp.array, cells: int) -> tuple[wp.array, wp.array]:
    end = wp.zeros(cells, dtype=wp.int32, device=cell.device)
    wp.launch(_count_kernel, dim=1, inputs=[cell], outputs=[end], device=cell.device)
    order = wp.empty(len(cell), dtype=wp.int32, device=cell.device)
    # What was the start of each cell is its end afterwards.
    wp.launch(_place_kernel, dim=1, inputs=[cell, end], outputs=[order], device=cell.device)
    return order, end


def points_in_order(points: wp.array, order: wp.array, *, threads: int = 1) -> wp.array:
    """points[order], (N,) vec3d; `order` is (N,) int32. On a CPU."""
    device = points.device
    check_array("points", points, wp.vec3d, (None,), device)
    check_array("order", order, wp.int32, (None,), device)
    taken = wp.empty(len(order), dtype=wp.vec3d, device=device)
    launch_ranges(
        _take_kernel,
        len(order),
        inputs=[points, order],
        outputs=[taken],
        device=device,
        threads=threads,
        grain=_GRAIN,
    )
    return taken
