"""Whether points lie on one cubic lattice, and in which of its cells."""

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import SCORE
from maomaps_warp.kernels.ranges import launch_ranges

#: Points of one task.
_BLOCK = wp.constant(4096)
#: Cells lie within this many of the lattice's zero.
MAX_CELL = wp.constant(wp.float64(1 << 20))
#: Added and taken away again, it rounds a far smaller float64 to an integer; wp.rint is a call on a CPU.
_ROUNDING = wp.constant(wp.float64(1.5 * 2**52))


@wp.func
def _misfit(offset: wp.float64, nearest: wp.float64, step: wp.float64) -> wp.float64:
    """How far a coordinate is from its lattice point; infinite, or NaN, beyond MAX_CELL."""
    return wp.where(wp.abs(nearest) <= MAX_CELL, wp.abs(offset - nearest * step), wp.float64(wp.inf))


@wp.kernel(module=SCORE)
def _lattice_kernel(
    # In:
    start: wp.int32,
    points: wp.array(dtype=wp.vec3d),
    zero: wp.vec3d,
    step: wp.float64,
    tolerance: wp.float64,
    # Out:
    out_cells: wp.array(dtype=wp.vec3i),
    out_lower: wp.array(dtype=wp.vec3i),
    out_upper: wp.array(dtype=wp.vec3i),
    out_off: wp.array(dtype=wp.int32),
):
    block = start + wp.tid()
    lower = wp.vec3i(2147483647)
    upper = wp.vec3i(-2147483647)
    off = int(0)
    steps_per_metre = wp.float64(1.0) / step
    first = block * _BLOCK
    for i in range(first, wp.min(first + _BLOCK, points.shape[0])):
        p = points[i]
        dx = p[0] - zero[0]
        dy = p[1] - zero[1]
        dz = p[2] - zero[2]
        x = (dx * steps_per_metre + _ROUNDING) - _ROUNDING
        y = (dy * steps_per_metre + _ROUNDING) - _ROUNDING
        z = (dz * steps_per_metre + _ROUNDING) - _ROUNDING
        fits = _misfit(dx, x, step) <= tolerance
        fits = fits and _misfit(dy, y, step) <= tolerance
        fits = fits and _misfit(dz, z, step) <= tolerance
        # Said so that a NaN counts as off the lattice.
        if not fits:
            off += 1
        else:
            cell = wp.vec3i(wp.int32(x), wp.int32(y), wp.int32(z))
            lower = wp.min(lower, cell)
            upper = wp.max(upper, cell)
            out_cells[i] = cell
    out_lower[block] = lower
    out_upper[block] = upper
    out_off[block] = off


def cells_on_lattice(
    points: wp.array, zero: wp.vec3d, step: float, tolerance: float, *, threads: int = 1
) -> tuple[wp.array, wp.array, wp.array, wp.array]:
    """Cells of points on a lattice.

    Args:
        points: (N,) vec3d, metres, N >= 1.
        zero: the point of cell (0, 0, 0).
        step: between neighbours, metres.
        tolerance: how far from its lattice point a coordinate may be, metres.
        threads: how many a CPU uses.

    Returns:
        Cells, (N,) vec3i, not set for points off the lattice; then for each block of points the lowest and the highest
        cell, vec3i, and how many points are off the lattice, int32.
    """
    device = points.device
    check_array("points", points, wp.vec3d, (None,), device)
    blocks = -(-len(points) // int(_BLOCK))
    cells = wp.empty(len(points), dtype=wp.vec3i, device=device)
    lower, upper = (wp.empty(blocks, dtype=wp.vec3i, device=device) for _ in range(2))
    off = wp.empty(blocks, dtype=wp.int32, device=device)
    launch_ranges(
        _lattice_kernel,
        blocks,
        inputs=[points, zero, wp.float64(step), wp.float64(tolerance)],
        outputs=[cells, lower, upper, off],
        device=device,
        threads=threads,
        grain=16,
    )
    return cells, lower, upper, off
