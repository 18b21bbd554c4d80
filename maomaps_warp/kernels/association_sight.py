"""What a pose sees of the elements of a brick, sixteen at a time: which rays have to be cast.

Lanes are loops over vectors that Warp must not unroll (see `modules`). Structs stay out of these loops:
Warp copies them at each use.
"""

import warp as wp

from maomaps_warp.kernels.association_memory import (
    LINE_DIRECTION,
    LINE_ORIGIN,
    LINE_ROOM,
    OWNER_POSE,
    OWNER_SLOT,
    OWNER_SQUARE,
    OWNER_WAY,
    SLOT_BEST,
    SLOT_POSE,
    SLOT_STATUS,
    SLOT_TRAIL,
    SLOT_X,
)
from maomaps_warp.kernels.association_rules import direction_of, is_camera_inside, is_in_view
from maomaps_warp.kernels.association_trail import blocked_again
from maomaps_warp.kernels.association_types import View
from maomaps_warp.kernels.lane_logic import any_of, flag
from maomaps_warp.kernels.lane_memory import floats_at, ints_at, put_lanes, put_three_lanes, three_floats_at
from maomaps_warp.kernels.lanes import lanes_f, lanes_i


@wp.func(inline=True)
def _rays_to(
    px: lanes_f, py: lanes_f, pz: lanes_f, view: View, R: wp.mat33, position: wp.vec3, inv_voxel_size: wp.float32
):
    """Square distances (square metres), camera-frame directions x, y, z, and which elements the image shows, were
    nothing in the way."""
    ox = px - lanes_f(position[0])
    oy = py - lanes_f(position[1])
    oz = pz - lanes_f(position[2])
    square = wp.cw_mul(ox, ox) + wp.cw_mul(oy, oy) + wp.cw_mul(oz, oz)
    x = ox * R[0, 0] + oy * R[1, 0] + oz * R[2, 0]
    y = ox * R[0, 1] + oy * R[1, 1] + oz * R[2, 1]
    z = ox * R[0, 2] + oy * R[1, 2] + oz * R[2, 2]
    seen = lanes_i()
    for k in range(16):
        shown = is_in_view(view, x[k], y[k], z[k], square[k])
        seen[k] = shown | is_camera_inside(view, ox[k], oy[k], oz[k], inv_voxel_size)
    qx = lanes_f()
    qy = lanes_f()
    qz = lanes_f()
    for k in range(16):
        q = direction_of(wp.vec3(x[k], y[k], z[k]), square[k])
        qx[k] = q[0]
        qy[k] = q[1]
        qz[k] = q[2]
    return square, qx, qy, qz, seen


@wp.func(inline=True)
def _to_map(R: wp.mat33, x: lanes_f, y: lanes_f, z: lanes_f):
    """`association_rules.to_map`, lane by lane."""
    return (
        x * R[0, 0] + y * R[0, 1] + z * R[0, 2],
        x * R[1, 0] + y * R[1, 1] + z * R[1, 2],
        x * R[2, 0] + y * R[2, 1] + z * R[2, 2],
    )


@wp.func(inline=True)
def _taken(a: lanes_f, order: lanes_i) -> lanes_f:
    """The lanes in another order."""
    r = lanes_f()
    for k in range(16):
        r[k] = a[order[k]]
    return r


@wp.func(inline=False)
def look(
    # In:
    first: wp.int32,
    pose: wp.int32,
    view: View,
    R: wp.mat33,
    position: wp.vec3,
    origin: wp.vec3,
    R_gt: wp.mat33,
    n: wp.vec3i,
    clearance_address: wp.uint64,
    inv_voxel_size: wp.float32,
    gap: wp.float32,
    room: wp.int32,
    used: wp.int32,
    # In and out:
    slots: wp.uint64,
    line: wp.uint64,
) -> wp.int32:
    """Put the rays of one pose to sixteen elements in line, but for those that cannot change an answer.

    Args:
        first: slot of the first of the elements.
        pose, R, position, origin, R_gt: number and rotation of the estimated pose, where it stands (metres; field
            coordinates), and rotation of the ground-truth pose.
        view: what an image shows.
        n, clearance_address, inv_voxel_size: of the estimate's field; address 0: it is bricked.
        gap: see `blocked_again`.
        room: numbers in a row of `slots`.
        used: rays in line before.
        slots: see `association_slots`.
        line: see `ray_line`.

    Returns:
        How many rays are in line.
    """
    px, py, pz = three_floats_at(slots, SLOT_X * room + first, room)
    best = floats_at(slots, SLOT_BEST * room + first)
    best_pose = ints_at(slots, SLOT_POSE * room + first)
    square, qx, qy, qz, seen = _rays_to(px, py, pz, view, R, position, inv_voxel_size)
    for k in range(16):
        tie = flag(square[k] == best[k]) & flag(pose < best_pose[k])
        seen[k] = seen[k] & (flag(square[k] < best[k]) | tie)
    if any_of(seen):
        put_lanes(slots, SLOT_STATUS * room + first, ints_at(slots, SLOT_STATUS * room + first) | seen)
        dx, dy, dz = _to_map(R, qx, qy, qz)
        shot = seen
        if clearance_address != wp.uint64(0):  # a bricked field has no such cheap look: its rays are all cast
            tx, ty, tz = three_floats_at(slots, SLOT_TRAIL * room + first, room)
            inv = inv_voxel_size
            blocked = blocked_again(tx, ty, tz, clearance_address, n, origin, dx * inv, dy * inv, dz * inv, square, gap)
            shot = seen - wp.cw_mul(seen, blocked)
        if any_of(shot):
            gx, gy, gz = _to_map(R_gt, qx, qy, qz)
            # Sixteen are written each time, those to be cast first; the next look writes over the rest.
            order = lanes_i()
            count = int(0)
            for k in range(16):
                order[count] = k
                count += shot[k]
            put_three_lanes(
                line, LINE_ORIGIN + used, LINE_ROOM, lanes_f(origin[0]), lanes_f(origin[1]), lanes_f(origin[2])
            )
            put_three_lanes(
                line, LINE_DIRECTION + used, LINE_ROOM, _taken(dx, order), _taken(dy, order), _taken(dz, order)
            )
            put_lanes(line, OWNER_SLOT + used, order + lanes_i(first))
            put_lanes(line, OWNER_POSE + used, lanes_i(pose))
            put_lanes(line, OWNER_SQUARE + used, _taken(square, order))
            put_three_lanes(line, OWNER_WAY + used, LINE_ROOM, _taken(gx, order), _taken(gy, order), _taken(gz, order))
            used += count
    return used
