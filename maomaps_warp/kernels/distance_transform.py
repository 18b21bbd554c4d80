"""Exact squared distances between cells of one lattice: a distance transform, along z always, then as queries need.

Idea: the squared distance to the nearest occupied cell is a minimum along z, then along y, then along x of what the
axis before gave (T. Saito, J. Toriwaki, "New algorithms for Euclidean distance transformation of an n-dimensional
digitized picture", Pattern Recognition 27, 1994). Rows along x are int16, 32 cells in one vector. Where most queries
have a point near them, the last two axes are not transformed: each query looks at the columns around its own, the
nearest first, until the next is farther away than what it has found.
Cost: 6 vector operations for 32 cells along z; then pi * distance^2 columns for each query, or 4 * window vector
operations for 32 cells, whatever lies in them. Limit: the reach of a query, or the window. A value above its square
says only that nothing is nearer than that; such cells must be decided in another way.
"""

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import SCORE
from maomaps_warp.kernels.ranges import launch_ranges

#: Cells of one vector: rows along x have a multiple of it.
ROW_CELLS = 32
#: Largest window: its square stays below that of _NOTHING, and the sum of both within int16.
MAX_WINDOW = 119
_row = wp.types.vector(length=32, dtype=wp.int16)
#: Distance along z that stands for "nothing here", cells; its square exceeds the largest window's.
_NOTHING = wp.constant(wp.int16(120))
_GRAIN = 64


@wp.kernel(module=SCORE)
def _mark_kernel(
    # In:
    cells: wp.array(dtype=wp.vec3i),
    lower: wp.vec3i,
    shape: wp.vec3i,
    # Out:
    out_squares: wp.array(dtype=wp.int16),
):
    cell = cells[wp.tid()] - lower
    out_squares[(cell[2] * shape[1] + cell[1]) * shape[0] + cell[0]] = wp.int16(0)


@wp.kernel(module=SCORE)
def _along_z_kernel(
    # In:
    start: wp.int32,
    columns: wp.int32,  # vectors of one layer
    layers: wp.int32,
    # In and out: 0 in occupied cells, _NOTHING elsewhere; then squares.
    squares: wp.array(dtype=_row),
):
    column = start + wp.tid()
    one = _row(wp.int16(1))
    distance = _row(_NOTHING)
    for z in range(layers):
        distance = wp.min(distance + one, squares[z * columns + column])
        squares[z * columns + column] = distance
    distance = _row(_NOTHING)
    for back in range(layers):
        z = layers - 1 - back
        distance = wp.min(distance + one, squares[z * columns + column])
        squares[z * columns + column] = wp.cw_mul(distance, distance)


@wp.kernel(module=SCORE)
def _around_kernel(
    # In:
    start: wp.int32,
    cells: wp.array(dtype=wp.vec3i),
    lower: wp.vec3i,
    shape: wp.vec3i,
    columns: wp.array(dtype=wp.vec3i),  # x and y relative to the query, and squared distance; nearest first
    squares: wp.array(dtype=wp.int16),
    # Out:
    out_squares: wp.array(dtype=wp.int32),
):
    i = start + wp.tid()
    cell = cells[i] - lower
    layer = cell[2] * shape[1]
    least = wp.int32(squares[(layer + cell[1]) * shape[0] + cell[0]])
    number = int(1)
    beyond = columns.shape[0] - 1
    column = columns[1]
    while number < beyond and column[2] < least:
        x = cell[0] + column[0]
        y = cell[1] + column[1]
        if x >= 0 and x < shape[0] and y >= 0 and y < shape[1]:
            square = column[2] + wp.int32(squares[(layer + y) * shape[0] + x])
            least = wp.where(square < least, square, least)
        number += 1
        column = columns[number]
    # Either the next column is too far away, or it is the first that is not looked at.
    out_squares[i] = wp.where(least <= column[2], least, -1)


@wp.kernel(module=SCORE)
def _along_y_kernel(
    # In:
    start: wp.int32,
    rows: wp.int32,  # rows of one layer
    vectors: wp.int32,  # vectors of one row
    window: wp.int32,
    squares: wp.array(dtype=_row),
    # Out: rows with one vector or more of padding before and after each.
    padded_vectors: wp.int32,
    pad_vectors: wp.int32,
    out_squares: wp.array(dtype=_row),
):
    row = start + wp.tid()
    y = row % rows
    layer = row - y
    below = wp.max(y - window, 0)
    above = wp.min(y + window + 1, rows)
    for v in range(vectors):
        least = squares[row * vectors + v]
        for other in range(below, above):
            step = wp.int16((other - y) * (other - y))
            least = wp.min(least, squares[(layer + other) * vectors + v] + _row(step))
        out_squares[row * padded_vectors + pad_vectors + v] = least


@wp.kernel(module=SCORE)
def _along_x_kernel(
    # In:
    start: wp.int32,
    vectors: wp.int32,
    padded_cells: wp.int32,
    pad_cells: wp.int32,
    window: wp.int32,
    squares: wp.array(dtype=_row),  # overlapping view: entry i starts at cell i
    # Out:
    out_squares: wp.array(dtype=_row),
):
    row = start + wp.tid()
    for v in range(vectors):
        middle = row * padded_cells + pad_cells + v * 32
        least = squares[middle]
        for step in range(1, window + 1):
            square = _row(wp.int16(step * step))
            least = wp.min(least, wp.min(squares[middle - step], squares[middle + step]) + square)
        out_squares[row * vectors + v] = least


@wp.kernel(module=SCORE)
def _read_kernel(
    # In:
    start: wp.int32,
    cells: wp.array(dtype=wp.vec3i),
    lower: wp.vec3i,
    shape: wp.vec3i,
    limit: wp.int32,
    squares: wp.array(dtype=wp.int16),
    # Out:
    out_squares: wp.array(dtype=wp.int32),
):
    i = start + wp.tid()
    cell = cells[i] - lower
    square = wp.int32(squares[(cell[2] * shape[1] + cell[1]) * shape[0] + cell[0]])
    out_squares[i] = wp.where(square <= limit, square, -1)


def squares_along_z(
    points: wp.array, *, lower: tuple[int, int, int], shape: tuple[int, int, int], threads: int = 1
) -> wp.array:
    """Squared distance from each cell of a box to the nearest of the points' cells in its column. On a CPU.

    Args:
        points: (N,) vec3i, cells, all within the box.
        lower: lowest cell of the box.
        shape: cells of the box along x, y, z; along x a multiple of ROW_CELLS.
        threads: how many a CPU uses.

    Returns:
        (cells,) int16, cells^2, x fastest and z slowest; no more than 120^2, which stands for whatever is farther.
    """
    check_array("points", points, wp.vec3i, (None,), points.device)
    if shape[0] % ROW_CELLS:
        raise ValueError(f"rows of {shape[0]} cells: not a multiple of {ROW_CELLS}")
    columns, layers = shape[0] * shape[1] // ROW_CELLS, shape[2]
    squares = wp.full(shape[0] * shape[1] * layers, 120, dtype=wp.int16, device=points.device)
    box = [wp.vec3i(*lower), wp.vec3i(*shape)]
    wp.launch(_mark_kernel, dim=len(points), inputs=[points, *box], outputs=[squares], device=points.device)
    inputs = [columns, layers, _as_rows(squares, columns * layers, ROW_CELLS)]
    launch_ranges(_along_z_kernel, columns, inputs=inputs, device=points.device, threads=threads, grain=_GRAIN)
    return squares


def squares_around(
    queries: wp.array,
    columns: wp.array,
    squares: wp.array,
    *,
    lower: tuple[int, int, int],
    shape: tuple[int, int, int],
    threads: int = 1,
) -> wp.array:
    """Squared distance from each query cell to the nearest point, where it is within reach. On a CPU.

    Args:
        queries: (Q,) vec3i, cells, all within the box.
        columns: (C,) vec3i, C >= 2, where a column lies from a query's, along x and y, and its squared distance, at
            most 119^2; nearest first, the query's own in front; the last is not looked at, only its distance, which
            says how far the others reach.
        squares: as `squares_along_z` returns them for the box of `lower` and `shape`.
        threads: how many a CPU uses.

    Returns:
        (Q,) int32, cells^2; -1 where nothing is within reach.
    """
    check_array("queries", queries, wp.vec3i, (None,), squares.device)
    check_array("columns", columns, wp.vec3i, (None,), squares.device)
    check_array("squares", squares, wp.int16, (shape[0] * shape[1] * shape[2],), squares.device)
    out = wp.empty(len(queries), dtype=wp.int32, device=squares.device)
    launch_ranges(
        _around_kernel,
        len(queries),
        inputs=[queries, wp.vec3i(*lower), wp.vec3i(*shape), columns, squares],
        outputs=[out],
        device=squares.device,
        threads=threads,
        grain=1 << 13,
    )
    return out


def squares_within(
    queries: wp.array,
    squares: wp.array,
    *,
    lower: tuple[int, int, int],
    shape: tuple[int, int, int],
    window: int,
    threads: int = 1,
) -> wp.array:
    """Squared distance from each query cell to the nearest point, within a window. On a CPU.

    Args:
        queries: (Q,) vec3i, cells, all within the box.
        squares: as `squares_along_z` returns them for the box of `lower` and `shape`.
        window: cells, 1 to MAX_WINDOW.
        threads: how many a CPU uses.

    Returns:
        (Q,) int32, cells^2; -1 where the nearest is farther than the window.
    """
    device = squares.device
    along_x, along_y, layers = shape
    check_array("queries", queries, wp.vec3i, (None,), device)
    check_array("squares", squares, wp.int16, (along_x * along_y * layers,), device)
    if not 1 <= window <= MAX_WINDOW:
        raise ValueError(f"window {window}: see MAX_WINDOW")
    vectors, rows = along_x // ROW_CELLS, along_y * layers
    pad = -(-window // ROW_CELLS) * ROW_CELLS
    padded = along_x + 2 * pad
    # Whatever the padding adds to stays above every window's square and within int16.
    between = wp.full(rows * padded, 120 * 120, dtype=wp.int16, device=device)
    launch_ranges(
        _along_y_kernel,
        rows,
        inputs=[along_y, vectors, window, _as_rows(squares, rows * vectors, ROW_CELLS), padded // 32, pad // 32],
        outputs=[_as_rows(between, rows * padded // ROW_CELLS, ROW_CELLS)],
        device=device,
        threads=threads,
        grain=_GRAIN,
    )
    least = wp.empty(rows * along_x, dtype=wp.int16, device=device)
    launch_ranges(
        _along_x_kernel,
        rows,
        inputs=[vectors, padded, pad, window, _as_rows(between, rows * padded - ROW_CELLS + 1, 1)],
        outputs=[_as_rows(least, rows * vectors, ROW_CELLS)],
        device=device,
        threads=threads,
        grain=_GRAIN,
    )
    out = wp.empty(len(queries), dtype=wp.int32, device=device)
    launch_ranges(
        _read_kernel,
        len(queries),
        inputs=[queries, wp.vec3i(*lower), wp.vec3i(*shape), window * window, least],
        outputs=[out],
        device=device,
        threads=threads,
        grain=1 << 15,
    )
    return out


def _as_rows(cells: wp.array, count: int, stride_cells: int) -> wp.array:
    """The same memory as vectors of ROW_CELLS cells, one starting every `stride_cells`."""
    view = wp.array(ptr=cells.ptr, dtype=_row, shape=(count,), strides=(2 * stride_cells,), device=cells.device)
    view._cells = cells  # the view owns nothing: it keeps what it shows alive
    return view
