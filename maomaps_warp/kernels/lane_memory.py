"""Memory of a launch by its bare address: numbers one at a time, or sixteen side by side.

A Warp array asks at each element for the sign of the index and for its stride, and a struct of arrays is copied where
it is used. The packets' inner loops keep their state in blocks of four-byte numbers, and say where: `address` is that
of a block, `place` counts numbers from there; of three numbers each lies `step` behind the one before. Whoever calls
sees to it that the block is large enough, and lives; and that no function reads floats where it wrote whole numbers, or
the other way round: to a C++ compiler those are different places. Rows that are moved whatever they hold (`move_slot`,
`move_up`) are written and read elsewhere in functions that are not inlined.
"""

from typing import Any

import warp as wp

from maomaps_warp.kernels.lanes import lanes_f, lanes_i

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
def vec3_at(address: wp.uint64, place: wp.int32, step: wp.int32) -> wp.vec3:
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.float32)
    return wp.vec3(numbers[place & _MANY], numbers[(place + step) & _MANY], numbers[(place + 2 * step) & _MANY])


@wp.func(inline=True)
def vec3i_at(address: wp.uint64, place: wp.int32, step: wp.int32) -> wp.vec3i:
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.int32)
    return wp.vec3i(numbers[place & _MANY], numbers[(place + step) & _MANY], numbers[(place + 2 * step) & _MANY])


@wp.func(inline=True)
def put(address: wp.uint64, place: wp.int32, value: wp.float32):
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.float32)
    numbers[place & _MANY] = value


@wp.func(inline=True)
def put(address: wp.uint64, place: wp.int32, value: wp.int32):
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.int32)
    numbers[place & _MANY] = value


@wp.func(inline=True)
def put_vec3(address: wp.uint64, place: wp.int32, step: wp.int32, value: Any):
    put(address, place, value[0])
    put(address, place + step, value[1])
    put(address, place + 2 * step, value[2])


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
def three_floats_at(address: wp.uint64, place: wp.int32, step: wp.int32):
    return floats_at(address, place), floats_at(address, place + step), floats_at(address, place + 2 * step)


@wp.func(inline=True)
def three_ints_at(address: wp.uint64, place: wp.int32, step: wp.int32):
    return ints_at(address, place), ints_at(address, place + step), ints_at(address, place + 2 * step)


@wp.func(inline=True)
def put_lanes(address: wp.uint64, place: wp.int32, value: lanes_f):
    numbers = wp.array(ptr=address + wp.uint64(4 * place), shape=(1,), dtype=lanes_f)
    numbers[0] = value


@wp.func(inline=True)
def put_lanes(address: wp.uint64, place: wp.int32, value: lanes_i):
    numbers = wp.array(ptr=address + wp.uint64(4 * place), shape=(1,), dtype=lanes_i)
    numbers[0] = value


@wp.func(inline=True)
def put_three_lanes(address: wp.uint64, place: wp.int32, step: wp.int32, x: Any, y: Any, z: Any):
    put_lanes(address, place, x)
    put_lanes(address, place + step, y)
    put_lanes(address, place + 2 * step, z)
