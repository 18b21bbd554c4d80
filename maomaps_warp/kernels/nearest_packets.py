"""Exact nearest neighbours of free points, sixteen queries at a time, on a CPU.

Idea: both clouds are sorted into cells, so that sixteen queries which follow one another lie in a small box. All points
in the cells around that box are compared with all sixteen at once, in vector registers, and whoever is not nearer than
the search reached is searched again to the distance found. In float64, as the tree of `nearest.py`, and in its order of
operations: the same squares, to the last bit.
Cost: the points within reach of the packet's box, on surfaces about a hundred and fifty for sixteen queries. Limit: a
packet that finds nothing within `LIMIT_CELLS` cells gives up, and its queries are left to the tree: clouds far apart,
outliers.
"""

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import NEAREST
from maomaps_warp.kernels.nearest_reach import Search, larger, points_of_row, search_within
from maomaps_warp.kernels.point_cells import CellGrid
from maomaps_warp.kernels.ranges import launch_ranges

_LANES = wp.constant(16)
_lanes = wp.types.vector(length=16, dtype=wp.float64)
_lane_places = wp.types.vector(length=16, dtype=wp.int32)
#: Farther than this many cells a packet does not search.
LIMIT_CELLS = wp.constant(24.0)
#: Queries of one task, and tasks of one range of a launch.
_TASK_QUERIES = wp.constant(512)
_GRAIN = 16


@wp.struct
class Packet:
    """Queries of one packet; empty lanes repeat the first."""

    x: _lanes
    y: _lanes
    z: _lanes
    lower: wp.vec3d  # box around the queries
    upper: wp.vec3d
    count: wp.int32


@wp.func
def _largest(v: _lanes) -> wp.float64:
    # As a tree: one after the other each comparison would wait for the last.
    a = larger(larger(v[0], v[1]), larger(v[2], v[3]))
    b = larger(larger(v[4], v[5]), larger(v[6], v[7]))
    c = larger(larger(v[8], v[9]), larger(v[10], v[11]))
    d = larger(larger(v[12], v[13]), larger(v[14], v[15]))
    return larger(larger(a, b), larger(c, d))


@wp.func
def _smaller(a: wp.float64, b: wp.float64) -> wp.float64:
    return wp.where(a < b, a, b)


@wp.func
def _take_packet(
    queries: wp.array(dtype=wp.vec3d),
    order: wp.array(dtype=wp.int32),
    first: wp.int32,
    stop: wp.int32,
    widest: wp.float64,
) -> Packet:
    """Queries from `first` in the order on, as long as their box is no wider than `widest`."""
    packet = Packet()
    head = queries[order[first]]
    packet.x = _lanes(head[0])
    packet.y = _lanes(head[1])
    packet.z = _lanes(head[2])
    lower = head
    upper = head
    taken = int(1)
    fits = bool(True)
    while fits and first + taken < stop:
        query = queries[order[first + taken]]
        new_lower = wp.vec3d(_smaller(lower[0], query[0]), _smaller(lower[1], query[1]), _smaller(lower[2], query[2]))
        new_upper = wp.vec3d(larger(upper[0], query[0]), larger(upper[1], query[1]), larger(upper[2], query[2]))
        width = new_upper - new_lower
        fits = width[0] <= widest and width[1] <= widest and width[2] <= widest
        if fits:
            lower = new_lower
            upper = new_upper
            packet.x[taken] = query[0]
            packet.y[taken] = query[1]
            packet.z[taken] = query[2]
            taken += 1
    packet.lower = lower
    packet.upper = upper
    packet.count = taken
    return packet


@wp.func
def _least_squares_in(
    grid: CellGrid, end: wp.array(dtype=wp.int32), points: wp.array(dtype=wp.vec3d), search: Search, packet: Packet
) -> _lanes:
    best = _lanes(wp.float64(wp.inf))
    for k in range(search.first[2], search.last[2] + 1):
        for j in range(search.first[1], search.last[1] + 1):
            row = points_of_row(grid, end, search, j, k)
            for p in range(row[0], row[1]):
                # Written out: a call for each point would copy the packet each time.
                point = points[p]
                dx = packet.x - _lanes(point[0])
                dy = packet.y - _lanes(point[1])
                dz = packet.z - _lanes(point[2])
                squares = wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy) + wp.cw_mul(dz, dz)
                for lane in range(16):
                    best[lane] = _smaller(squares[lane], best[lane])
    return best


@wp.func
def _lowest_places_in(
    grid: CellGrid,
    end: wp.array(dtype=wp.int32),
    points: wp.array(dtype=wp.vec3d),
    original: wp.array(dtype=wp.int32),
    search: Search,
    packet: Packet,
    best: _lanes,
) -> _lane_places:
    """For each lane the lowest place of a point at exactly its least distance."""
    places = _lane_places(2147483647)
    for k in range(search.first[2], search.last[2] + 1):
        for j in range(search.first[1], search.last[1] + 1):
            row = points_of_row(grid, end, search, j, k)
            for p in range(row[0], row[1]):
                point = points[p]
                dx = packet.x - _lanes(point[0])
                dy = packet.y - _lanes(point[1])
                dz = packet.z - _lanes(point[2])
                squares = wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy) + wp.cw_mul(dz, dz)
                place = original[p]
                for lane in range(16):
                    lower = wp.min(place, places[lane])
                    places[lane] = wp.where(squares[lane] == best[lane], lower, places[lane])
    return places


@wp.kernel(module=NEAREST)
def _packet_kernel(
    # In:
    start: wp.int32,
    grid: CellGrid,
    end: wp.array(dtype=wp.int32),
    points: wp.array(dtype=wp.vec3d),
    original: wp.array(dtype=wp.int32),
    queries: wp.array(dtype=wp.vec3d),
    query_order: wp.array(dtype=wp.int32),
    widest: wp.float64,
    # Out:
    out_square: wp.array(dtype=wp.float64),
    out_index: wp.array(dtype=wp.int32),
):
    first = (start + wp.tid()) * _TASK_QUERIES
    stop = wp.min(first + _TASK_QUERIES, queries.shape[0])
    cell_size = wp.float64(1.0) / grid.cells_per_metre
    limit = wp.float64(LIMIT_CELLS) * cell_size
    reach = wp.float64(0.75) * cell_size
    while first < stop:
        packet = _take_packet(queries, query_order, first, wp.min(first + _LANES, stop), widest)
        best = _lanes()
        worst = wp.float64(wp.inf)
        searched = bool(False)
        while not searched:
            best = _least_squares_in(grid, end, points, search_within(grid, packet.lower, packet.upper, reach), packet)
            worst = _largest(best)
            if worst <= reach * reach:
                searched = bool(True)
            elif worst < wp.float64(wp.inf):
                reach = wp.sqrt(worst) * wp.float64(1.000001)
                searched = reach > limit
            else:
                reach = reach * wp.float64(3.0)
                searched = reach > limit
        is_found = worst <= reach * reach and reach <= limit
        places = _lane_places(-1)
        if is_found and out_index.shape[0] > 0:
            # The root is rounded: a little more, lest the point that was found falls out.
            search = search_within(grid, packet.lower, packet.upper, wp.sqrt(worst) * wp.float64(1.000001))
            places = _lowest_places_in(grid, end, points, original, search, packet, best)
        for lane in range(16):
            if lane < packet.count:
                place = query_order[first + lane]
                out_square[place] = wp.where(is_found, best[lane], wp.float64(-1.0))
                if out_index.shape[0] > 0:
                    out_index[place] = places[lane]
        first += packet.count
        # The next packet lies beside this one: it starts with what this one needed.
        found = wp.sqrt(worst) * wp.float64(1.05)
        reach = wp.where(is_found, larger(found, wp.float64(0.5) * cell_size), wp.float64(0.75) * cell_size)


def nearest_in_cells(
    grid: CellGrid,
    points: tuple[wp.array, wp.array, wp.array],
    queries: tuple[wp.array, wp.array],
    *,
    widest: float,
    with_index: bool,
    threads: int = 1,
) -> tuple[wp.array, wp.array]:
    """Nearest point of each query that has one within reach.

    Args:
        grid: the cells that the points are sorted into.
        points: in the order of their cells, (N,) vec3d; their places in the caller's cloud and the ends of the cells,
            as `order_by_cells` returns them.
        queries: (Q,) vec3d, and an order in which neighbours follow one another, (Q,) int32.
        widest: a packet's box is at most this wide, metres.
        with_index: whether the points are named, too.
        threads: how many a CPU uses.

    Returns:
        In the order of the caller's queries: squared distance, (Q,) float64, metres^2; index into the caller's points,
        (Q,) int32, of equally near ones the lowest (empty if not asked for). Both -1 where nothing was in reach.
    """
    in_order, original, end = points
    query_points, query_order = queries
    device = in_order.device
    cells = grid.shape[0] * grid.shape[1] * grid.shape[2]
    check_array("points", in_order, wp.vec3d, (None,), device)
    check_array("points' places", original, wp.int32, (len(in_order),), device)
    check_array("ends of cells", end, wp.int32, (cells,), device)
    check_array("queries", query_points, wp.vec3d, (None,), device)
    check_array("queries' order", query_order, wp.int32, (len(query_points),), device)
    squares = wp.empty(len(query_points), dtype=wp.float64, device=device)
    index = wp.empty(len(query_points) if with_index else 0, dtype=wp.int32, device=device)
    launch_ranges(
        _packet_kernel,
        -(-len(query_points) // int(_TASK_QUERIES)),
        inputs=[grid, end, in_order, original, query_points, query_order, wp.float64(widest)],
        outputs=[squares, index],
        device=device,
        threads=threads,
        grain=_GRAIN,
    )
    return squares, index
