"""The elements of one brick while poses look at them: a slot each, in memory of one launch.

A block of memory (see `lane_memory`) of SLOT_ROWS rows; sixteen neighbours in a row are a packet. Elements that are
answered leave, and the others close up, so that packets stay full.
"""

import warp as wp

from maomaps_warp.kernels.association_memory import (
    SLOT_BEST,
    SLOT_ELEMENT,
    SLOT_POSE,
    SLOT_ROWS,
    SLOT_STATUS,
    SLOT_TRAIL,
    SLOT_X,
)
from maomaps_warp.kernels.association_types import NO_POSE, OUT_OF_VIEW
from maomaps_warp.kernels.lane_memory import int_at, put, put_vec3


@wp.func(inline=False)
def fill_slots(
    first: wp.int32,
    count: wp.int32,
    x: wp.array(dtype=wp.float32),
    y: wp.array(dtype=wp.float32),
    z: wp.array(dtype=wp.float32),
    element: wp.array(dtype=wp.int32),
    room: wp.int32,
    slots: wp.uint64,
):
    """Let elements `first`, `first` + 1, ... in, `count` of them; gives the corners of the box round them."""
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    high = -low
    for slot in range(count):
        point = wp.vec3(x[first + slot], y[first + slot], z[first + slot])
        low = wp.min(low, point)
        high = wp.max(high, point)
        put_vec3(slots, SLOT_X * room + slot, room, point)
        put(slots, SLOT_BEST * room + slot, wp.inf)
        put(slots, SLOT_POSE * room + slot, NO_POSE)
        put_vec3(slots, SLOT_TRAIL * room + slot, room, wp.vec3())
        put(slots, SLOT_STATUS * room + slot, OUT_OF_VIEW)
        put(slots, SLOT_ELEMENT * room + slot, element[first + slot])
    want_no_more(count, room, slots)
    return low, high


@wp.func(inline=True)
def move_slot(source: wp.int32, target: wp.int32, room: wp.int32, slots: wp.uint64):
    for row in range(SLOT_ROWS):
        put(slots, row * room + target, int_at(slots, row * room + source))


@wp.func(inline=True)
def want_no_more(count: wp.int32, room: wp.int32, slots: wp.uint64):
    """Make what lies behind the last of `count` slots, up to a full packet, want no pose."""
    for slot in range(count, (count + 15) & -16):
        put(slots, SLOT_BEST * room + slot, float(-1.0))
