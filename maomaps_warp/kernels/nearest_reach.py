"""Which cells of a grid of points lie within reach of a box.

Idea: all rows of cells in the box widened by the reach; a wide search leaves out the rows, and the ends of rows, in
its corners. Cost: two look-ups for each row, and a root where it is wide. No point within reach is ever left out:
boxes are widened by many times the rounding of float64.
"""

import warp as wp

from maomaps_warp.kernels.point_cells import CellGrid, cell_number, cell_on_axis

#: Slack of a box of cells: in cells, and of the largest coordinate. Many times the rounding of a float64 difference.
_SLACK_CELLS = wp.constant(wp.float64(1e-6))
_SLACK_COORDINATE = wp.constant(wp.float64(1e-12))
#: A search with more reach than this, in cells, leaves out the corners of its box.
_WIDE_CELLS = wp.constant(wp.float64(2.5))


@wp.struct
class Search:
    """What lies within `reach` of a box, metres."""

    lower: wp.vec3d  # the box, widened by slack
    upper: wp.vec3d
    reach: wp.float64
    is_wide: wp.bool  # whether rows are cut to what is within reach: that costs more than it saves in a small box
    first: wp.vec3i  # cells of all that is within reach on its axis, both included
    last: wp.vec3i
    inner_first: wp.vec3i  # cells of the box
    inner_last: wp.vec3i


@wp.func
def larger(a: wp.float64, b: wp.float64) -> wp.float64:
    """Maximum of two numbers that are not NaN."""
    # wp.max carries NaN logic.
    return wp.where(a > b, a, b)


@wp.func
def search_within(grid: CellGrid, lower: wp.vec3d, upper: wp.vec3d, reach: wp.float64) -> Search:
    """The search for what is no farther than `reach`, metres, from a box."""
    search = Search()
    search.reach = reach
    search.is_wide = reach * grid.cells_per_metre > _WIDE_CELLS
    for axis in range(3):
        low = lower[axis]
        high = upper[axis]
        slack = _SLACK_COORDINATE * larger(wp.abs(low), wp.abs(high)) + _SLACK_CELLS / grid.cells_per_metre
        low -= slack
        high += slack
        search.lower[axis] = low
        search.upper[axis] = high
        search.first[axis] = cell_on_axis(grid, axis, low - reach)
        search.last[axis] = cell_on_axis(grid, axis, high + reach)
        search.inner_first[axis] = cell_on_axis(grid, axis, low)
        search.inner_last[axis] = cell_on_axis(grid, axis, high)
    return search


@wp.func
def _gap(grid: CellGrid, search: Search, axis: wp.int32, cell: wp.int32) -> wp.float64:
    """Least distance on one axis between the box and a point in a cell."""
    # Border cells hold what is beyond the grid, but only on the side that is turned away.
    cell_size = wp.float64(1.0) / grid.cells_per_metre
    if cell > search.inner_last[axis]:
        return grid.lower[axis] + wp.float64(cell) * cell_size - search.upper[axis]
    if cell < search.inner_first[axis]:
        return search.lower[axis] - grid.lower[axis] - wp.float64(cell + 1) * cell_size
    return wp.float64(0.0)


@wp.func
def points_of_row(grid: CellGrid, end: wp.array(dtype=wp.int32), search: Search, j: wp.int32, k: wp.int32) -> wp.vec2i:
    """First point, and the one behind the last, of the cells of a row that are within reach."""
    first_x = search.first[0]
    last_x = search.last[0]
    if search.is_wide:
        gap_y = _gap(grid, search, 1, j)
        gap_z = _gap(grid, search, 2, k)
        left = search.reach * search.reach - gap_y * gap_y - gap_z * gap_z
        if left < wp.float64(0.0):
            return wp.vec2i(0, 0)
        along_x = wp.sqrt(left)
        first_x = cell_on_axis(grid, 0, search.lower[0] - along_x)
        last_x = cell_on_axis(grid, 0, search.upper[0] + along_x)
    first = cell_number(grid, first_x, j, k)
    last = cell_number(grid, last_x, j, k)
    start = int(0)
    if first > 0:
        start = end[first - 1]
    return wp.vec2i(start, end[last])
