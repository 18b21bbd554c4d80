"""Association of the elements of one brick, on a CPU: in which order its poses look at them, and when they may stop.

Pose after pose looks at all packets of the brick that still want one. Most elements are answered within a few looks,
but those that no pose sees try them all, and would keep their packets going for a few lanes. So after some looks those
that are answered leave, and the others close up; after three times as many again.

These are functions that kernels call and not kernels, and are not inlined: Warp writes a kernel twice, for two ways to
number its tasks, and all that is in it would be compiled twice.
"""

import warp as wp

from maomaps_warp.kernels.association_answers import keep_transferred, settle, transfer
from maomaps_warp.kernels.association_culling import cull_poses, list_by_distance, list_by_time
from maomaps_warp.kernels.association_memory import (
    LINE_FULL,
    LIST_BOUND,
    LIST_POSE,
    SLOT_BEST,
    SLOT_CELL,
    SLOT_ELEMENT,
    SLOT_POSE,
    SLOT_STATUS,
    SLOT_WAY,
    PoseLists,
    Workspace,
)
from maomaps_warp.kernels.association_sight import look
from maomaps_warp.kernels.association_slots import fill_slots, move_slot, want_no_more
from maomaps_warp.kernels.association_trail import cells_of
from maomaps_warp.kernels.association_types import EVERY, LAST, NEAREST, VISIBLE, Bricks, Pairs, Sight
from maomaps_warp.kernels.lane_memory import float_at, floats_at, int_at, vec3_at, vec3i_at
from maomaps_warp.kernels.ray_line import move_up

#: How many poses look at a brick, before those elements leave that are answered; and how many times more next time.
_PATIENCE = wp.constant(4)
_LONGER = wp.constant(3)


@wp.func(inline=True)
def _list_poses(low: wp.vec3, high: wp.vec3, sight: Sight, choice: wp.int32, lists: PoseLists) -> wp.int32:
    """List the poses that may see into a box, in the order in which they are to be tried; gives how many."""
    poses = sight.poses.est_position.shape[0]
    inv = sight.est.inv_voxel_size
    count = cull_poses(low, high, sight.blocks, poses, sight.view, inv, lists)
    if choice == NEAREST:
        list_by_distance(count, lists)
    else:
        list_by_time(count, choice == LAST, lists)
    return count


@wp.func(inline=True)
def _wants(slots: wp.uint64, first: wp.int32, room: wp.int32, bound: wp.float32) -> wp.bool:
    """Whether a packet has an element that a pose may improve which is no nearer than `bound`, square metres."""
    best = floats_at(slots, SLOT_BEST * room + first)
    wants = int(0)
    for k in range(16):
        wants = wants | wp.where(best[k] >= bound, 1, 0)
    return wants != 0


@wp.func(inline=False)
def look_from_poses(
    # In:
    rank: wp.int32,
    stop: wp.int32,
    waiting: wp.int32,
    gt_used: wp.int32,
    sight: Sight,
    choice: wp.int32,
    # In and out:
    space: Workspace,
    # Out:
    out_count: wp.array(dtype=wp.int32),
    out_pairs: Pairs,
):
    """Let the listed poses `rank` to `stop` - 1 look at the first `waiting` slots, until they want no more.

    Returns:
        The next rank; and how many transferred rays are in line, before it `gt_used`.
    """
    slots = space.slots
    room = space.room
    line = space.line
    view = sight.view
    n = cells_of(sight.est)
    inv = sight.est.inv_voxel_size
    gap = sight.tolerance + 1.1 * sight.est.voxel_size
    address = sight.est.clearance_address
    if sight.est.is_bricked:
        address = wp.uint64(0)
    used = int(0)
    is_wanted = bool(True)
    while rank < stop and is_wanted:
        pose = int_at(space.lists.address, LIST_POSE * space.lists.room + rank)
        bound = float_at(space.lists.address, LIST_BOUND * space.lists.room + rank)
        R = sight.poses.est_rotation[pose]
        R_gt = sight.poses.gt_rotation[pose]
        position = sight.poses.est_position[pose]
        origin = sight.est_origin[pose]
        is_wanted = bool(False)
        first = int(0)
        while first < waiting:
            if _wants(slots, first, room, bound):
                is_wanted = bool(True)
                used = look(first, pose, view, R, position, origin, R_gt, n, address, inv, gap, room, used, slots, line)
                if used >= LINE_FULL:
                    gt_used = settle(
                        used, gt_used, sight, choice, room, slots, line, space.gt_line, out_count, out_pairs
                    )
                    used = move_up(line, used)
            first += 16
        rank += 1
    if used > 0:
        gt_used = settle(used, gt_used, sight, choice, room, slots, line, space.gt_line, out_count, out_pairs)
    if not is_wanted:
        rank = stop
    return rank, gt_used


@wp.func(inline=False)
def leave(
    # In:
    rank: wp.int32,
    count: wp.int32,
    waiting: wp.int32,
    gt_used: wp.int32,
    sight: Sight,
    choice: wp.int32,
    # In and out:
    space: Workspace,
    # Out:
    out_status: wp.array(dtype=wp.int32),
    out_count: wp.array(dtype=wp.int32),
    out_pairs: Pairs,
):
    """Let the elements go that no pose from `rank` on can improve, all if it is the last; the others close up.

    Returns:
        How many slots wait on, of `waiting`; and how many transferred rays are in line, before it `gt_used`.
    """
    slots = space.slots
    room = space.room
    bound = float(wp.inf)
    if rank < count:
        bound = float_at(space.lists.address, LIST_BOUND * space.lists.room + rank)
    left = int(0)
    for slot in range(waiting):
        if rank < count and float_at(slots, SLOT_BEST * room + slot) >= bound:
            if left < slot:
                move_slot(slot, left, room, slots)
            left += 1
        else:
            element = int_at(slots, SLOT_ELEMENT * room + slot)
            pose = int_at(slots, SLOT_POSE * room + slot)
            status = wp.min(int_at(slots, SLOT_STATUS * room + slot), VISIBLE)
            if pose >= 0:
                status = int(VISIBLE)
                cell = vec3i_at(slots, SLOT_CELL * room + slot, room)
                way = vec3_at(slots, SLOT_WAY * room + slot, room)
                gt_used = transfer(element, pose, cell, way, gt_used, sight, space.gt_line, out_count, out_pairs)
            out_status[element] = status
    want_no_more(left, room, slots)
    return left, gt_used


@wp.func(inline=False)
def associate_brick(
    # In:
    brick: wp.int32,
    bricks: Bricks,
    sight: Sight,
    choice: wp.int32,
    # Memory:
    space: Workspace,
    # Out:
    out_status: wp.array(dtype=wp.int32),
    out_count: wp.array(dtype=wp.int32),
    out_pairs: Pairs,
):
    """Associate the elements of a brick: their status, their correspondences, and how many (counted on from 0)."""
    begin = bricks.first[brick]
    waiting = bricks.first[brick + 1] - begin
    low, high = fill_slots(begin, waiting, bricks.x, bricks.y, bricks.z, bricks.element, space.room, space.slots)
    count = _list_poses(low, high, sight, choice, space.lists)
    patience = int(_PATIENCE)
    rank = int(0)
    gt_used = int(0)
    while waiting > 0:
        stop = count
        # Where every pose counts nobody leaves; where less than a packet is left, none would be fuller.
        if choice != EVERY and waiting > 16:
            stop = wp.min(rank + patience, count)
        rank, gt_used = look_from_poses(rank, stop, waiting, gt_used, sight, choice, space, out_count, out_pairs)
        waiting, gt_used = leave(rank, count, waiting, gt_used, sight, choice, space, out_status, out_count, out_pairs)
        patience *= _LONGER
    if gt_used > 0:
        keep_transferred(space.gt_line, gt_used, sight, out_count, out_pairs)
