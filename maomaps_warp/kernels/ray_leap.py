"""The leap of a ray to the edge of the empty cube around its cell: one ray, or sixteen side by side."""

from typing import Any

import warp as wp

from maomaps_warp.kernels.lanes import LANES, lanes_f, lanes_i
from maomaps_warp.kernels.modules import OPTIONS

wp.set_module_options(OPTIONS)


# What `leap` is made of, for one ray and for sixteen. Comparisons and not wp.min: that one asks for NaN.
@wp.func
def times(a: wp.float32, b: wp.float32) -> wp.float32:
    return a * b


@wp.func
def times(a: lanes_f, b: lanes_f) -> lanes_f:
    return wp.cw_mul(a, b)


@wp.func
def smaller(a: wp.float32, b: wp.float32) -> wp.float32:
    return wp.where(a < b, a, b)


@wp.func
def smaller(a: lanes_f, b: lanes_f) -> lanes_f:
    c = lanes_f()
    for lane in range(LANES):
        c[lane] = wp.where(a[lane] < b[lane], a[lane], b[lane])
    return c


@wp.func
def larger(a: wp.float32, b: wp.float32) -> wp.float32:
    return wp.where(a > b, a, b)


@wp.func
def larger(a: lanes_f, b: lanes_f) -> lanes_f:
    c = lanes_f()
    for lane in range(LANES):
        c[lane] = wp.where(a[lane] > b[lane], a[lane], b[lane])
    return c


@wp.func
def where_not_above(a: wp.float32, b: wp.float32, then: wp.float32, other: wp.float32) -> wp.float32:
    return wp.where(a <= b, then, other)


@wp.func
def where_not_above(a: lanes_f, b: lanes_f, then: lanes_f, other: lanes_f) -> lanes_f:
    c = lanes_f()
    for lane in range(LANES):
        c[lane] = wp.where(a[lane] <= b[lane], then[lane], other[lane])
    return c


@wp.func
def whole(a: wp.float32) -> wp.float32:
    return wp.float32(wp.int32(a))


@wp.func
def whole(a: lanes_f) -> lanes_f:
    return lanes_f(lanes_i(a))


@wp.func
def ones(a: wp.float32) -> wp.float32:
    return wp.float32(1.0)


@wp.func
def ones(a: lanes_f) -> lanes_f:
    return lanes_f(1.0)


@wp.func(inline=True)
def leap(
    x: Any,
    y: Any,
    z: Any,
    r: Any,
    ox: Any,
    oy: Any,
    oz: Any,
    dx: Any,
    dy: Any,
    dz: Any,
    ix: Any,
    iy: Any,
    iz: Any,
):
    """The cell in which a ray leaves the empty cube around its cell: the one step of every caster.

    Args:
        x, y, z: the ray's cell, whole numbers; float32 or lanes_f, like all others.
        r: its clearance; where it is 0 the cell stays.
        ox, oy, oz: the ray's origin.
        dx, dy, dz: its direction, above 0 on every axis.
        ix, iy, iz: 1 / direction.
    """
    exit_x = x + r
    exit_y = y + r
    exit_z = z + r
    tx = times(exit_x - ox, ix)
    ty = times(exit_y - oy, iy)
    tz = times(exit_z - oz, iz)
    t = smaller(tx, smaller(ty, tz))
    one = ones(x)
    in_x = whole(larger(x, smaller(ox + times(dx, t), exit_x - one)))
    in_y = whole(larger(y, smaller(oy + times(dy, t), exit_y - one)))
    in_z = whole(larger(z, smaller(oz + times(dz, t), exit_z - one)))
    return (
        where_not_above(tx, t, exit_x, in_x),
        where_not_above(ty, t, exit_y, in_y),
        where_not_above(tz, t, exit_z, in_z),
    )
