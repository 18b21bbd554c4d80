"""Memory of a launch by its bare address: numbers one at a time, or sixteen side by side.

A Warp array asks at each element for the sign of the index and for its stride, and a struct of arrays is copied where
it is used. The packets' inner loops keep their state in blocks of four-byte numbers, and say where: `address` is that
of a block, `place` counts numbers from there; of three numbers each lies `step` behind the one before. Whoever calls
sees to it that the block is large enough, and lives.
"""

from __future__ import annotations

import warp as wp

from maomaps_warp.kernels.modules import OPTIONS
from maomaps_warp.kernels.ray_leap import lanes_f, lanes_i

wp.set_module_options(OPTIONS)

_MANY = wp.constant(0x7FFFFFFF)


@wp.func(inline=True)
def float_at(address: wp.uint64, place: wp.int32) -> wp.float32:
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.float32)
    return numbers[place & _MANY]


@wp.func(inline=True)
def int_at(address: wp.uint64, place: wp.int32) -> wp.int32:
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.int32)
    return numbers[place & _MANY]


@wp.func(inline=True)
def three_floats_at(address: wp.uint64, place: wp.int32, step: wp.int32):
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.float32)
    return numbers[place & _MANY], numbers[(place + step) & _MANY], numbers[(place + 2 * step) & _MANY]


@wp.func(inline=True)
def three_ints_at(address: wp.uint64, place: wp.int32, step: wp.int32):
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.int32)
    return numbers[place & _MANY], numbers[(place + step) & _MANY], numbers[(place + 2 * step) & _MANY]


@wp.func(inline=True)
def put(address: wp.uint64, place: wp.int32, value: wp.float32):
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.float32)
    numbers[place & _MANY] = value


@wp.func(inline=True)
def put(address: wp.uint64, place: wp.int32, value: wp.int32):
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.int32)
    numbers[place & _MANY] = value


@wp.func(inline=True)
def put_three(address: wp.uint64, place: wp.int32, step: wp.int32, x: wp.float32, y: wp.float32, z: wp.float32):
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.float32)
    numbers[place & _MANY] = x
    numbers[(place + step) & _MANY] = y
    numbers[(place + 2 * step) & _MANY] = z


@wp.func(inline=True)
def put_three(address: wp.uint64, place: wp.int32, step: wp.int32, x: wp.int32, y: wp.int32, z: wp.int32):
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.int32)
    numbers[place & _MANY] = x
    numbers[(place + step) & _MANY] = y
    numbers[(place + 2 * step) & _MANY] = z


# Sixteen from `place` on, wherever that is: arrays of one vector, where it lies.
@wp.func(inline=True)
def floats_at(address: wp.uint64, place: wp.int32) -> lanes_f:
    numbers = wp.array(ptr=address + wp.uint64(4 * place), shape=(1,), dtype=lanes_f)
    return numbers[0]


@wp.func(inline=True)
def ints_at(address: wp.uint64, place: wp.int32) -> lanes_i:
    numbers = wp.array(ptr=address + wp.uint64(4 * place), shape=(1,), dtype=lanes_i)
    return numbers[0]


@wp.func(inline=True)
def three_lanes_at(address: wp.uint64, place: wp.int32, step: wp.int32):
    return floats_at(address, place), floats_at(address, place + step), floats_at(address, place + 2 * step)


@wp.func(inline=True)
def put_lanes(address: wp.uint64, place: wp.int32, value: lanes_f):
    numbers = wp.array(ptr=address + wp.uint64(4 * place), shape=(1,), dtype=lanes_f)
    numbers[0] = value


@wp.func(inline=True)
def put_lanes(address: wp.uint64, place: wp.int32, value: lanes_i):
    numbers = wp.array(ptr=address + wp.uint64(4 * place), shape=(1,), dtype=lanes_i)
    numbers[0] = value


@wp.func(inline=True)
def put_three_lanes(address: wp.uint64, place: wp.int32, step: wp.int32, x: lanes_f, y: lanes_f, z: lanes_f):
    put_lanes(address, place, x)
    put_lanes(address, place + step, y)
    put_lanes(address, place + 2 * step, z)


@wp.func(inline=True)
def put_three_lanes(address: wp.uint64, place: wp.int32, step: wp.int32, x: lanes_i, y: lanes_i, z: lanes_i):
    put_lanes(address, place, x)
    put_lanes(address, place + step, y)
    put_lanes(address, place + 2 * step, z)


@wp.func(inline=True)
def any_of(mask: lanes_i) -> wp.bool:
    """Whether a lane is 1."""
    return wp.dot(mask, mask) != 0
