"""Rays that stand in line until two packets are full.

Looks leave few rays each: of sixteen elements some are out of view, some hidden for certain, some answered. A packet of
what one look leaves would be half empty, and have nobody to take turns with (see `ray_packets`). So rays of any looks
stand in one line, each with what its answer is for, and the first thirty-two of it are cast at once.

A line is a block of memory (see `lane_memory`), LINE_SIZE numbers, in rows of LINE_ROOM.
"""

import warp as wp

from maomaps_warp.kernels.association_memory import LINE_CELL, LINE_DIRECTION, LINE_FULL, LINE_ORIGIN, LINE_ROOM
from maomaps_warp.kernels.distance_field import DistanceField
from maomaps_warp.kernels.lane_memory import ints_at, put_lanes, put_three_lanes, three_floats_at
from maomaps_warp.kernels.lanes import lanes_f
from maomaps_warp.kernels.ray_packets import Packet, cast_packets

_ROWS_THAT_MOVE = wp.constant(12)


@wp.func(inline=True)
def _packet_at(line: wp.uint64, first: wp.int32, used: wp.int32) -> Packet:
    ox, oy, oz = three_floats_at(line, LINE_ORIGIN + first, LINE_ROOM)
    dx, dy, dz = three_floats_at(line, LINE_DIRECTION + first, LINE_ROOM)
    active = lanes_f()
    for k in range(16):
        active[k] = wp.where(first + k < used, 1.0, 0.0)
    return Packet(ox, oy, oz, dx, dy, dz, active)


@wp.func(inline=False)
def cast_line(line: wp.uint64, used: wp.int32, field: DistanceField):
    """Cast the first 32 of `used` rays (or all, if they are fewer) and write down their cells."""
    x, y, z, x2, y2, z2 = cast_packets(field, _packet_at(line, 0, used), _packet_at(line, 16, used))
    put_three_lanes(line, LINE_CELL, LINE_ROOM, x, y, z)
    put_three_lanes(line, LINE_CELL + 16, LINE_ROOM, x2, y2, z2)


@wp.func(inline=True)
def move_up(line: wp.uint64, used: wp.int32) -> wp.int32:
    """Let the rays behind the first 32 take their place; gives how many they are."""
    for row in range(_ROWS_THAT_MOVE):
        put_lanes(line, row * LINE_ROOM, ints_at(line, row * LINE_ROOM + LINE_FULL))
    return wp.max(used - LINE_FULL, 0)
