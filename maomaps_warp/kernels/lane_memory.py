"""Memory of a launch by its bare address: numbers one at a time, or sixteen side by side.

A Warp array asks at each element for the sign of the index and for its stride, and a struct of arrays is copied where
it is used. The packets' inner loops keep their state in blocks of four-byte numbers, and say where: `address` is that
of a block, `place` counts numbers from there. Whoever calls sees to it that the block is large enough, and lives.
"""

from __future__ import annotations

import warp as wp

from maomaps_warp.kernels.ray_leap import lanes_f, lanes_i

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
def put(address: wp.uint64, place: wp.int32, value: wp.float32):
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.float32)
    numbers[place & _MANY] = value


@wp.func(inline=True)
def put(address: wp.uint64, place: wp.int32, value: wp.int32):
    numbers = wp.array(ptr=address, shape=(_MANY,), dtype=wp.int32)
    numbers[place & _MANY] = value


@wp.func(inline=True)
def floats_at(address: wp.uint64, place: wp.int32) -> lanes_f:
    """Sixteen from `place` on."""
    numbers = wp.array(ptr=address + wp.uint64(4 * place), shape=(1,), dtype=lanes_f)
    return numbers[0]


@wp.func(inline=True)
def ints_at(address: wp.uint64, place: wp.int32) -> lanes_i:
    """Sixteen from `place` on."""
    numbers = wp.array(ptr=address + wp.uint64(4 * place), shape=(1,), dtype=lanes_i)
    return numbers[0]


@wp.func(inline=True)
def put(address: wp.uint64, place: wp.int32, value: lanes_f):
    """Sixteen from `place` on."""
    numbers = wp.array(ptr=address + wp.uint64(4 * place), shape=(1,), dtype=lanes_f)
    numbers[0] = value


@wp.func(inline=True)
def put(address: wp.uint64, place: wp.int32, value: lanes_i):
    """Sixteen from `place` on."""
    numbers = wp.array(ptr=address + wp.uint64(4 * place), shape=(1,), dtype=lanes_i)
    numbers[0] = value


@wp.func(inline=True)
def any_of(mask: lanes_i) -> wp.bool:
    """Whether a lane is 1."""
    return wp.dot(mask, mask) != 0
