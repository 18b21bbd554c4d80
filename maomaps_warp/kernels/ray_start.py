"""Where a ray through a distance field begins: mirrored so that it runs upwards, and moved into the field."""

import warp as wp

from maomaps_warp.kernels.lanes import lanes_f
from maomaps_warp.kernels.modules import OPTIONS
from maomaps_warp.kernels.ray_leap import larger, smaller, whole

wp.set_module_options(OPTIONS)

#: Of a direction's largest component: anything smaller counts as this much, so that its inverse is finite.
_LEAST_SLOPE = wp.constant(wp.float32(1.0e-12))
#: Directions with a largest component outside these are none; NaN is not either.
_LEAST_DIRECTION = wp.constant(wp.float32(1.0e-18))
_MOST_DIRECTION = wp.constant(wp.float32(1.0e18))


@wp.func(inline=True)
def mirrored(o: wp.float32, d: wp.float32, largest: wp.float32, n: wp.int32):
    """Origin, direction and its inverse along an axis of `n` cells, mirrored where the ray runs down."""
    up_o = wp.where(d < 0.0, wp.float32(n) - o, o)
    up_d = larger(wp.abs(d), largest * _LEAST_SLOPE)
    return up_o, up_d, 1.0 / up_d


@wp.func(inline=True)
def mirrored(o: lanes_f, d: lanes_f, largest: lanes_f, n: wp.int32):
    up_d = larger(wp.abs(d), largest * _LEAST_SLOPE)
    up_o = lanes_f()
    for lane in range(16):
        up_o[lane] = wp.where(d[lane] < 0.0, wp.float32(n) - o[lane], o[lane])
    return up_o, up_d, wp.cw_div(lanes_f(1.0), up_d)


@wp.func
def unmirrored(x: wp.int32, d: wp.float32, n: wp.int32) -> wp.int32:
    """The field cell that a ray with direction `d` calls `x`."""
    return wp.where(d < 0.0, n - 1 - x, x)


@wp.func
def is_direction(dx: wp.float32, dy: wp.float32, dz: wp.float32, largest: wp.float32) -> wp.float32:
    """1 for a direction; 0 for none: zero, NaN, infinite."""
    sum = dx + dy + dz
    is_sized = wp.where(largest > _LEAST_DIRECTION, wp.where(largest < _MOST_DIRECTION, 1.0, 0.0), 0.0)
    return wp.where(sum - sum == 0.0, is_sized, 0.0)


@wp.func
def is_within(o: wp.float32, n: wp.int32) -> wp.float32:
    """1 where a mirrored origin lies within the border of an axis, else 0."""
    return wp.where(o >= 1.0, wp.where(o < wp.float32(n - 1), 1.0, 0.0), 0.0)


@wp.func
def first_cell(o: wp.float32, n: wp.int32) -> wp.float32:
    return smaller(larger(whole(o), 1.0), wp.float32(n - 2))


@wp.func
def enter(n: wp.vec3i, o: wp.vec3, d: wp.vec3) -> wp.vec3:
    """Where a mirrored ray enters, from outside, a field of `n` cells within the border; (0, 0, 0) if nowhere."""
    # In float64: from far away float32 would miss the point by cells.
    near = wp.float64(0.0)
    far = wp.float64(1.0e30)
    for axis in range(3):
        inverse = wp.float64(1.0) / wp.float64(d[axis])
        near = wp.max(near, (wp.float64(1.0) - wp.float64(o[axis])) * inverse)
        far = wp.min(far, (wp.float64(n[axis] - 1) - wp.float64(o[axis])) * inverse)
    entered = wp.vec3(0.0, 0.0, 0.0)
    sum = o[0] + o[1] + o[2]
    if near < far and sum - sum == 0.0:  # not so for NaN and infinity
        for axis in range(3):
            entered[axis] = wp.float32(wp.float64(o[axis]) + wp.float64(d[axis]) * near)
    return entered
