"""Where the rays of a packet were last stopped, and whether the next ones are stopped there again: one look each."""

import warp as wp

from maomaps_warp.kernels.distance_field import DistanceField
from maomaps_warp.kernels.lane_logic import any_of, flag
from maomaps_warp.kernels.lanes import lanes_f, lanes_i
from maomaps_warp.kernels.ray_packets import look_up


@wp.func(inline=True)
def are_in_field(n: wp.vec3i, x: lanes_i, y: lanes_i, z: lanes_i) -> lanes_i:
    """1 where a cell of a field of `n` cells lies inside the border."""
    nx = n[0] - 1
    ny = n[1] - 1
    nz = n[2] - 1
    inside = lanes_i()
    for k in range(16):
        inside[k] = (
            flag(x[k] > 0) & flag(y[k] > 0) & flag(z[k] > 0) & flag(x[k] < nx) & flag(y[k] < ny) & flag(z[k] < nz)
        )
    return inside


@wp.func(inline=True)
def cells_of(field: DistanceField) -> wp.vec3i:
    """How many cells a field has along x, y and z."""
    return wp.vec3i(field.nx, field.ny, field.nz)


@wp.func(inline=True)
def blocked_again(
    trail_x: lanes_f,
    trail_y: lanes_f,
    trail_z: lanes_f,
    clearance_address: wp.uint64,
    n: wp.vec3i,
    origin: wp.vec3,
    dx: lanes_f,
    dy: lanes_f,
    dz: lanes_f,
    square: lanes_f,
    gap: wp.float32,
) -> lanes_i:
    """Rays that certainly end well before their elements, by ONE cell each, near where the last ray was stopped.

    A point of the ray in an occupied cell, not too near to its faces, proves that the ray ends there or before.

    Args:
        trail_x, trail_y, trail_z: where to look, field coordinates.
        clearance_address, n: of a dense field.
        origin, dx, dy, dz: the rays, to their elements, field coordinates.
        square: squared lengths of the rays, square metres.
        gap: metres before the element that count as well before.
    """
    reach = wp.max(wp.max(wp.abs(origin[0]), wp.abs(origin[1])), wp.abs(origin[2]))
    reach = wp.max(reach, float(wp.max(n[0], wp.max(n[1], n[2]))))
    margin = 1.0e-3 + 4.0e-6 * reach
    bx = trail_x - lanes_f(origin[0])
    by = trail_y - lanes_f(origin[1])
    bz = trail_z - lanes_f(origin[2])
    along = wp.cw_mul(bx, dx) + wp.cw_mul(by, dy) + wp.cw_mul(bz, dz)
    length = wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy) + wp.cw_mul(dz, dz)
    t = lanes_f()
    for k in range(16):
        share = along[k] / wp.where(length[k] > 0.0, length[k], 1.0)
        share = wp.where(share < 1.0, share, 1.0)
        t[k] = wp.where(share > 0.0, share, 0.0)
    x = lanes_f(origin[0]) + wp.cw_mul(dx, t)
    y = lanes_f(origin[1]) + wp.cw_mul(dy, t)
    z = lanes_f(origin[2]) + wp.cw_mul(dz, t)
    cx = lanes_i(x)
    cy = lanes_i(y)
    cz = lanes_i(z)
    fx = wp.abs(x - lanes_f(cx) - lanes_f(0.5))
    fy = wp.abs(y - lanes_f(cy) - lanes_f(0.5))
    fz = wp.abs(z - lanes_f(cz) - lanes_f(0.5))
    sure = lanes_i()
    for k in range(16):
        rest = 1.0 - t[k]
        middle = flag(fx[k] < 0.5 - margin) & flag(fy[k] < 0.5 - margin) & flag(fz[k] < 0.5 - margin)
        before = flag(rest * rest * square[k] > gap * gap)
        sure[k] = middle & before
    sure = wp.cw_mul(sure, are_in_field(n, cx, cy, cz))
    if any_of(sure):
        # The first cell where nothing is to be looked up.
        r = look_up(clearance_address, wp.cw_mul(sure, cz + (cy + cx * n[1]) * n[2]))
        for k in range(16):
            sure[k] = sure[k] & flag(r[k] == 0)
    return sure
