"""What rays found, and what follows from it: a hit of the estimate's map is transferred, a transferred one is kept."""

import warp as wp

from maomaps_warp.kernels.association_memory import (
    LINE_CELL,
    LINE_DIRECTION,
    LINE_FULL,
    LINE_ORIGIN,
    LINE_OWNER,
    LINE_ROOM,
    OWNER_POSE,
    OWNER_SLOT,
    OWNER_SQUARE,
    OWNER_WAY,
    SLOT_BEST,
    SLOT_CELL,
    SLOT_ELEMENT,
    SLOT_POSE,
    SLOT_STATUS,
    SLOT_TRAIL,
    SLOT_WAY,
    SLOT_X,
)
from maomaps_warp.kernels.association_rules import is_near
from maomaps_warp.kernels.association_trail import are_in_field, cells_of
from maomaps_warp.kernels.association_types import EVERY, NEAREST, VISIBLE, Pairs, Sight
from maomaps_warp.kernels.field_cells import voxel_at
from maomaps_warp.kernels.lane_memory import float_at, int_at, ints_at, put, put_vec3, three_ints_at, vec3_at, vec3i_at
from maomaps_warp.kernels.lanes import lanes_f, lanes_i
from maomaps_warp.kernels.ray_line import cast_line

# What the answer to a transferred ray is for, in a line of `ray_line`.
_OWNER_ELEMENT = LINE_OWNER
_OWNER_POSE = wp.constant(LINE_OWNER + LINE_ROOM)
_OWNER_CELL = wp.constant(LINE_OWNER + 2 * LINE_ROOM)  # x, y, z: field cell of the first predicted voxel


@wp.func(inline=False)
def keep_transferred(
    line: wp.uint64, used: wp.int32, sight: Sight, out_count: wp.array(dtype=wp.int32), out_pairs: Pairs
):
    """Cast all of the at most 32 transferred rays in line, and keep the correspondences."""
    cast_line(line, used, sight.gt)
    pair = out_pairs.used[0]
    for ray in range(used):
        cell = vec3i_at(line, LINE_CELL + ray, LINE_ROOM)
        gt_voxel = voxel_at(sight.gt, cell[0], cell[1], cell[2])
        if gt_voxel >= 0:
            element = int_at(line, _OWNER_ELEMENT + ray)
            out_count[element] = out_count[element] + 1
            out_pairs.element[pair] = element
            out_pairs.pose[pair] = int_at(line, _OWNER_POSE + ray)
            est_cell = vec3i_at(line, _OWNER_CELL + ray, LINE_ROOM)
            out_pairs.est_voxel[pair] = voxel_at(sight.est, est_cell[0], est_cell[1], est_cell[2])
            out_pairs.gt_voxel[pair] = gt_voxel
            pair += 1
    out_pairs.used[0] = pair


@wp.func(inline=True)
def transfer(
    # In:
    element: wp.int32,
    pose: wp.int32,
    cell: wp.vec3i,
    way: wp.vec3,
    used: wp.int32,
    sight: Sight,
    # In and out:
    line: wp.uint64,
    # Out:
    out_count: wp.array(dtype=wp.int32),
    out_pairs: Pairs,
) -> wp.int32:
    """Put the ray of an element, as its ground-truth pose casts it, in line; gives how many are in line.

    Args:
        element: where its answer goes.
        pose: which pair of poses.
        cell: field cell of the first predicted voxel.
        way: direction, map frame.
        used, line: transferred rays in line.
    """
    put_vec3(line, LINE_ORIGIN + used, LINE_ROOM, sight.gt_origin[pose])
    put_vec3(line, LINE_DIRECTION + used, LINE_ROOM, way)
    put(line, _OWNER_ELEMENT + used, element)
    put(line, _OWNER_POSE + used, pose)
    put_vec3(line, _OWNER_CELL + used, LINE_ROOM, cell)
    used += 1
    if used == LINE_FULL:
        keep_transferred(line, used, sight, out_count, out_pairs)
        used = 0
    return used


@wp.func(inline=True)
def _near(line: wp.uint64, first: wp.int32, sight: Sight, room: wp.int32, slots: wp.uint64) -> lanes_i:
    """Which of sixteen rays met a voxel near enough to their element: the pose sees it."""
    x, y, z = three_ints_at(line, LINE_CELL + first, LINE_ROOM)
    slot = ints_at(line, OWNER_SLOT + first)
    px = lanes_f()
    py = lanes_f()
    pz = lanes_f()
    for k in range(16):
        px[k] = float_at(slots, SLOT_X * room + slot[k])
        py[k] = float_at(slots, (SLOT_X + 1) * room + slot[k])
        pz[k] = float_at(slots, (SLOT_X + 2) * room + slot[k])
    tolerance = sight.tolerance
    size = sight.est.voxel_size
    offset = lanes_f(sight.est.center_offset)
    gx = (lanes_f(x) + lanes_f(float(sight.est.lower[0])) + offset) * size - px  # cell_center, lane by lane
    gy = (lanes_f(y) + lanes_f(float(sight.est.lower[1])) + offset) * size - py
    gz = (lanes_f(z) + lanes_f(float(sight.est.lower[2])) + offset) * size - pz
    inside = are_in_field(cells_of(sight.est), x, y, z)
    near = lanes_i()
    for k in range(16):
        near[k] = is_near(tolerance, gx[k], gy[k], gz[k]) & inside[k]
    return near


@wp.func(inline=False)
def settle(
    # In:
    used: wp.int32,
    gt_used: wp.int32,
    sight: Sight,
    choice: wp.int32,
    room: wp.int32,
    # In and out:
    slots: wp.uint64,
    line: wp.uint64,
    gt_line: wp.uint64,
    # Out:
    out_count: wp.array(dtype=wp.int32),
    out_pairs: Pairs,
) -> wp.int32:
    """Cast the first 32 of `used` rays in line (or all, if they are fewer), and let their slots know what they met.

    Returns:
        How many transferred rays are in line; before it were `gt_used`.
    """
    cast_line(line, used, sight.est)
    for half in range(2):
        first = 16 * half
        near = _near(line, first, sight, room, slots)
        for k in range(wp.min(used - first, 16)):
            ray = first + k
            slot = int_at(line, OWNER_SLOT + ray)
            cell = vec3i_at(line, LINE_CELL + ray, LINE_ROOM)
            put_vec3(slots, SLOT_TRAIL * room + slot, room, wp.vec3(cell) + wp.vec3(0.5, 0.5, 0.5))
            if near[k] != 0:
                pose = int_at(line, OWNER_POSE + ray)
                square = float_at(line, OWNER_SQUARE + ray)
                way = vec3_at(line, OWNER_WAY + ray, LINE_ROOM)
                best = float_at(slots, SLOT_BEST * room + slot)
                if choice == EVERY:
                    put(slots, SLOT_STATUS * room + slot, VISIBLE)
                    element = int_at(slots, SLOT_ELEMENT * room + slot)
                    gt_used = transfer(element, pose, cell, way, gt_used, sight, gt_line, out_count, out_pairs)
                elif square < best or (square == best and pose < int_at(slots, SLOT_POSE * room + slot)):
                    if choice != NEAREST:
                        square = -1.0  # the first that sees it: no other is wanted
                    put(slots, SLOT_BEST * room + slot, square)
                    put(slots, SLOT_POSE * room + slot, pose)
                    put_vec3(slots, SLOT_CELL * room + slot, room, cell)
                    put_vec3(slots, SLOT_WAY * room + slot, room, way)
    return gt_used
