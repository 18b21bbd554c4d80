"""Association of the elements of one brick, on a CPU: the outer functions, over its packets and the poses that see it.

Where one pose is chosen, most elements find theirs within a few looks, but those that no pose sees try them all, and a
packet would go on for few of its lanes. So a packet gives up after some looks; elements that no pose saw so far wait,
and go on together, in full packets, with more patience each time.

These are functions that kernels call and not kernels, and are not inlined: Warp writes a kernel twice, for two ways to
number its tasks, and all that is in it would be compiled twice.
"""

from __future__ import annotations

import warp as wp

from maomaps_warp.kernels.association_culling import PoseLists, list_by_distance, list_by_time
from maomaps_warp.kernels.association_rules import NO_POSE, OUT_OF_VIEW, VISIBLE, flag, to_map
from maomaps_warp.kernels.association_sight import (
    Bricks,
    Rows,
    Sight,
    chosen,
    cull_brick,
    floats_of,
    load_packet,
    look_at_packet,
    rays_to,
)
from maomaps_warp.kernels.association_trail import Trail, any_of, are_in_field, cells_of
from maomaps_warp.kernels.distance_field import ray_origin, voxel_at
from maomaps_warp.kernels.voxel_rays import cast_packet, lanes_f, lanes_i

NEAREST = wp.constant(0)
FIRST = wp.constant(1)
LAST = wp.constant(2)

#: How many poses that have something of a packet in view look at it, before what none of them saw has to wait; and how
#: many times more next time.
PATIENCE = wp.constant(8)
_LONGER = wp.constant(4)


@wp.func(inline=False)
def choose_for_packet(
    # In:
    start: wp.int32,
    last: wp.int32,
    left: wp.int32,
    patience: wp.int32,
    count: wp.int32,
    bricks: Bricks,
    sight: Sight,
    choice: wp.int32,
    # In and out:
    lists: PoseLists,
    out_status: wp.array(dtype=wp.int32),
    # Out:
    out_pose: wp.array(dtype=wp.int32),
    out_est_voxel: wp.array(dtype=wp.int32),
    out_gt_voxel: wp.array(dtype=wp.int32),
) -> wp.int32:
    """The next sixteen of the waiting elements, by as many looks as `patience` allows.

    Returns:
        `left` and how many of them wait on: those that no pose saw so far, if there are more poses to try.
    """
    places = lanes_i()
    filled = lanes_i()
    best = lanes_f()
    status = lanes_i()
    rank = int(count)
    for k in range(16):
        # Lanes beyond the last element repeat it, and are not filled.
        places[k] = lists.place[wp.min(start + k, last)]
        filled[k] = wp.where(start + k <= last, 1, 0)
        # A lane without an element wants no pose: none is nearer than -1.
        best[k] = wp.where(filled[k] != 0, wp.inf, -1.0)
        status[k] = out_status[bricks.element[places[k]]]
        rank = wp.min(rank, lists.rank[wp.min(start + k, last)])
    px, py, pz = load_packet(bricks, places)
    worst = float(wp.inf)
    best_pose = lanes_i(NO_POSE)
    qx = lanes_f()
    qy = lanes_f()
    qz = lanes_f()
    x = lanes_i()
    y = lanes_i()
    z = lanes_i()
    trail = Trail()
    looks = int(0)
    while rank < count and lists.bound[rank] <= worst:
        pose = lists.pose[rank]
        rank += 1
        square, rx, ry, rz, seen = rays_to(px, py, pz, filled, sight, pose)
        for k in range(16):
            tie = flag(square[k] == best[k]) & flag(pose < best_pose[k])
            seen[k] = seen[k] & (flag(square[k] < best[k]) | tie)
        if any_of(seen):
            for k in range(16):
                status[k] = status[k] | seen[k]
            hit, cx, cy, cz, trail = look_at_packet(px, py, pz, rx, ry, rz, square, seen, trail, sight, pose)
            if any_of(hit):
                if choice != NEAREST:
                    square = lanes_f(-1.0)
                best = chosen(hit, square, best)
                best_pose = chosen(hit, lanes_i(pose), best_pose)
                qx = chosen(hit, rx, qx)
                qy = chosen(hit, ry, qy)
                qz = chosen(hit, rz, qz)
                x = chosen(hit, cx, x)
                y = chosen(hit, cy, y)
                z = chosen(hit, cz, z)
            looks += 1
            if looks == patience and rank < count:
                for k in range(16):
                    if best[k] == wp.inf:
                        best[k] = -1.0
                        filled[k] = 0
                        # Never ahead of the packets that are still to be read: `left` has not passed `start`.
                        lists.place[left] = places[k]
                        lists.rank[left] = wp.max(rank, lists.rank[start + k])
                        out_status[bricks.element[places[k]]] = status[k]
                        left += 1
            worst = float(-1.0)
            for k in range(16):
                worst = wp.where(best[k] > worst, best[k], worst)
    # The transferred rays: each lane from the ground-truth pose of its own choice.
    ox = lanes_f()
    oy = lanes_f()
    oz = lanes_f()
    shot = lanes_f()
    for k in range(16):
        if best_pose[k] >= 0:
            shot[k] = 1.0
            origin = ray_origin(sight.gt, sight.poses.gt_position[best_pose[k]])
            ray = to_map(sight.poses.gt_rotation[best_pose[k]], wp.vec3(qx[k], qy[k], qz[k]))
            ox[k] = origin[0]
            oy[k] = origin[1]
            oz[k] = origin[2]
            qx[k] = ray[0]
            qy[k] = ray[1]
            qz[k] = ray[2]
    gt_x, gt_y, gt_z = cast_packet(sight.gt, ox, oy, oz, qx, qy, qz, shot)
    for k in range(16):
        if filled[k] != 0:
            element = bricks.element[places[k]]
            out_status[element] = wp.where(best_pose[k] >= 0, VISIBLE, status[k])
            out_pose[element] = best_pose[k]
            est_voxel = int(-1)
            gt_voxel = int(-1)
            if best_pose[k] >= 0:
                est_voxel = voxel_at(sight.est, x[k], y[k], z[k])
                gt_voxel = voxel_at(sight.gt, gt_x[k], gt_y[k], gt_z[k])
            out_est_voxel[element] = est_voxel
            out_gt_voxel[element] = gt_voxel
    return left


@wp.func(inline=False)
def choose_poses(
    # In:
    brick: wp.int32,
    bricks: Bricks,
    sight: Sight,
    choice: wp.int32,
    lists: PoseLists,
    # Out:
    out_status: wp.array(dtype=wp.int32),
    out_pose: wp.array(dtype=wp.int32),
    out_est_voxel: wp.array(dtype=wp.int32),
    out_gt_voxel: wp.array(dtype=wp.int32),
):
    count = cull_brick(bricks, sight, brick, lists)
    if choice == NEAREST:
        list_by_distance(count, 2.0 * sight.est.voxel_size, lists)
    else:
        list_by_time(count, choice == LAST, lists)
    first = bricks.first[brick]
    waiting = bricks.first[brick + 1] - first
    for i in range(waiting):
        lists.place[i] = first + i
        lists.rank[i] = 0
        out_status[bricks.element[first + i]] = OUT_OF_VIEW
    patience = int(PATIENCE)
    while waiting > 0:
        if waiting <= 16:
            patience = count  # no packet would be fuller
        left = int(0)
        start = int(0)
        while start < waiting:
            last = wp.min(start + 16, waiting) - 1
            left = choose_for_packet(
                start,
                last,
                left,
                patience,
                count,
                bricks,
                sight,
                choice,
                lists,
                out_status,
                out_pose,
                out_est_voxel,
                out_gt_voxel,
            )
            start += 16
        waiting = left
        patience *= _LONGER


@wp.func(inline=False)
def look_from_every_pose(
    # In:
    brick: wp.int32,
    bricks: Bricks,
    sight: Sight,
    lists: PoseLists,
    # Out:
    out_status: wp.array(dtype=wp.int32),
    out_count: wp.array(dtype=wp.int32),
    out_rows: Rows,
):
    count = cull_brick(bricks, sight, brick, lists)
    gt = sight.gt
    last = bricks.first[brick + 1] - 1
    first = int(bricks.first[brick])
    used = int(out_rows.used[0])
    while first <= last:
        places = lanes_i()
        filled = lanes_i()
        for k in range(16):
            places[k] = wp.min(first + k, last)
            filled[k] = wp.where(first + k <= last, 1, 0)
        px, py, pz = load_packet(bricks, places)
        status = lanes_i(OUT_OF_VIEW)
        kept = lanes_i()
        trail = Trail()
        for rank in range(count):
            pose = lists.culled_pose[rank]
            square, rx, ry, rz, seen = rays_to(px, py, pz, filled, sight, pose)
            if any_of(seen):
                hit, ex, ey, ez, trail = look_at_packet(px, py, pz, rx, ry, rz, square, seen, trail, sight, pose)
                for k in range(16):
                    status[k] = status[k] | seen[k] | (hit[k] * VISIBLE)
                if any_of(hit):
                    R = sight.poses.gt_rotation[pose]
                    dx = rx * R[0, 0] + ry * R[0, 1] + rz * R[0, 2]
                    dy = rx * R[1, 0] + ry * R[1, 1] + rz * R[1, 2]
                    dz = rx * R[2, 0] + ry * R[2, 1] + rz * R[2, 2]
                    origin = ray_origin(gt, sight.poses.gt_position[pose])
                    x, y, z = cast_packet(gt, origin, dx, dy, dz, floats_of(hit))
                    matched = wp.cw_mul(are_in_field(cells_of(gt), x, y, z), hit)
                    if any_of(matched):
                        kept = kept + matched
                        est_voxel = lanes_i(-1)
                        gt_voxel = lanes_i(-1)
                        for k in range(16):
                            if matched[k] != 0:
                                est_voxel[k] = voxel_at(sight.est, ex[k], ey[k], ez[k])
                                gt_voxel[k] = voxel_at(gt, x[k], y[k], z[k])
                        out_rows.place[used] = first
                        out_rows.pose[used] = pose
                        out_rows.est_voxel[used] = est_voxel
                        out_rows.gt_voxel[used] = gt_voxel
                        used += 1
        for k in range(16):
            if filled[k] != 0:
                element = bricks.element[places[k]]
                out_status[element] = wp.min(status[k], VISIBLE)
                out_count[element] = kept[k]
        first += 16
    out_rows.used[0] = used
