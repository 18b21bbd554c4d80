"""What a pose sees of a packet of sixteen elements: the inner functions of the association on a CPU.

Lanes are loops over vectors that Warp must not unroll (see `modules`). Structs stay out of these loops:
Warp copies them at each use.
"""

from __future__ import annotations

import warp as wp

from maomaps_warp.kernels.association_culling import PoseLists, cull_poses
from maomaps_warp.kernels.association_rules import (
    PosePairs,
    View,
    direction_of,
    is_camera_inside,
    is_in_view,
    is_near,
)
from maomaps_warp.kernels.association_trail import Trail, any_of, are_in_field, blocked_again, cells_of
from maomaps_warp.kernels.distance_field import DistanceField, ray_origin
from maomaps_warp.kernels.voxel_rays import cast_bricked_packet, cast_dense_packet, lanes_f, lanes_i


@wp.struct
class Bricks:
    """Elements in bricks: those of brick b are first[b] to first[b + 1] - 1; metres relative to the grid's origin."""

    first: wp.array(dtype=wp.int32)  # (B + 1,)
    low: wp.array(dtype=wp.vec3)  # (B,) corners of the boxes round them
    high: wp.array(dtype=wp.vec3)  # (B,)
    x: wp.array(dtype=wp.float32)  # (N,)
    y: wp.array(dtype=wp.float32)  # (N,)
    z: wp.array(dtype=wp.float32)  # (N,)
    element: wp.array(dtype=wp.int32)  # (N,) where an element's answer goes


@wp.struct
class Sight:
    """All that decides whether a pose sees an element."""

    poses: PosePairs
    blocks: wp.array2d(dtype=lanes_f)  # the estimated poses for culling, see association_culling.BLOCK_ROWS
    view: View
    est: DistanceField
    gt: DistanceField
    tolerance: wp.float32  # metres


@wp.func(inline=True)
def chosen(mask: lanes_i, a: lanes_f, b: lanes_f) -> lanes_f:
    """`a` where the mask is 1, else `b`."""
    r = lanes_f()
    for k in range(16):
        r[k] = wp.where(mask[k] != 0, a[k], b[k])
    return r


@wp.func(inline=True)
def chosen(mask: lanes_i, a: lanes_i, b: lanes_i) -> lanes_i:
    """`a` where the mask is 1, else `b`."""
    r = lanes_i()
    for k in range(16):
        r[k] = wp.where(mask[k] != 0, a[k], b[k])
    return r


@wp.func(inline=True)
def floats_of(mask: lanes_i) -> lanes_f:
    """The mask as the ray caster takes it."""
    return lanes_f(mask)


@wp.func(inline=True)
def load_packet(bricks: Bricks, places: lanes_i):
    """Coordinates x, y, z (metres) of the elements at some places."""
    x = lanes_f()
    y = lanes_f()
    z = lanes_f()
    for k in range(16):
        x[k] = bricks.x[places[k]]
        y[k] = bricks.y[places[k]]
        z[k] = bricks.z[places[k]]
    return x, y, z


@wp.func(inline=False)
def _rays_to(
    px: lanes_f,
    py: lanes_f,
    pz: lanes_f,
    filled: lanes_i,
    view: View,
    R: wp.mat33,
    position: wp.vec3,
    inv: wp.float32,
):
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
        seen[k] = (shown | is_camera_inside(view, ox[k], oy[k], oz[k], inv)) & filled[k]
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
def rays_to(px: lanes_f, py: lanes_f, pz: lanes_f, filled: lanes_i, sight: Sight, pose: wp.int32):
    """Rays from estimated pose `pose` to the elements of a packet.

    Returns:
        Square distances (square metres), camera-frame directions x, y, z, and which elements the image shows, were
        nothing in the way.
    """
    R = sight.poses.est_rotation[pose]
    position = sight.poses.est_position[pose]
    square, x, y, z, seen = _rays_to(px, py, pz, filled, sight.view, R, position, sight.est.inv_voxel_size)
    return square, x, y, z, seen


@wp.func(inline=True)
def look_at_packet(
    px: lanes_f,
    py: lanes_f,
    pz: lanes_f,
    qx: lanes_f,
    qy: lanes_f,
    qz: lanes_f,
    square: lanes_f,
    seen: lanes_i,
    trail: Trail,
    sight: Sight,
    pose: wp.int32,
):
    """Cast the rays whose elements are in view, but for those that are stopped again.

    Returns:
        Which elements the pose sees, the field cells x, y, z of the first predicted voxels, and the trail.
    """
    R = sight.poses.est_rotation[pose]
    dx = qx * R[0, 0] + qy * R[0, 1] + qz * R[0, 2]
    dy = qx * R[1, 0] + qy * R[1, 1] + qz * R[1, 2]
    dz = qx * R[2, 0] + qy * R[2, 1] + qz * R[2, 2]
    origin = ray_origin(sight.est, sight.poses.est_position[pose])
    inv = sight.est.inv_voxel_size
    n = cells_of(sight.est)
    shot = seen
    if not sight.est.is_bricked:  # which has no such cheap look: its rays are all cast
        gap = sight.tolerance + 1.1 * sight.est.voxel_size
        address = sight.est.clearance_address
        blocked = blocked_again(trail, address, n, origin, dx * inv, dy * inv, dz * inv, square, gap)
        shot = seen - wp.cw_mul(seen, blocked)
    hit = lanes_i()
    x = lanes_i()
    y = lanes_i()
    z = lanes_i()
    if any_of(shot):
        active = floats_of(shot)
        # Here and not in cast_packet: the struct is copied for a bricked field alone.
        ox = lanes_f(origin[0])
        oy = lanes_f(origin[1])
        oz = lanes_f(origin[2])
        if sight.est.is_bricked:
            x, y, z = cast_bricked_packet(sight.est, ox, oy, oz, dx, dy, dz, active)
        else:
            x, y, z = cast_dense_packet(sight.est.clearance_address, n, ox, oy, oz, dx, dy, dz, active)
        fx = lanes_f(x)
        fy = lanes_f(y)
        fz = lanes_f(z)
        tolerance = sight.tolerance
        size = sight.est.voxel_size
        offset = lanes_f(sight.est.center_offset)
        gx = (fx + lanes_f(float(sight.est.lower[0])) + offset) * size - px  # cell_center, lane by lane
        gy = (fy + lanes_f(float(sight.est.lower[1])) + offset) * size - py
        gz = (fz + lanes_f(float(sight.est.lower[2])) + offset) * size - pz
        inside = wp.cw_mul(are_in_field(n, x, y, z), shot)
        for k in range(16):
            hit[k] = is_near(tolerance, gx[k], gy[k], gz[k]) & inside[k]
        half = lanes_f(0.5)
        trail.x = chosen(shot, fx + half, trail.x)
        trail.y = chosen(shot, fy + half, trail.y)
        trail.z = chosen(shot, fz + half, trail.z)
    return hit, x, y, z, trail


@wp.func(inline=True)
def cull_brick(bricks: Bricks, sight: Sight, brick: wp.int32, lists: PoseLists) -> wp.int32:
    """List the poses that may see a brick; gives how many."""
    poses = sight.poses.est_position.shape[0]
    inv = sight.est.inv_voxel_size
    return cull_poses(bricks.low[brick], bricks.high[brick], sight.blocks, poses, sight.view, inv, lists)


@wp.struct
class Rows:
    """Memory of one launch for what poses see of packets, a row for each pair of which something is to be kept."""

    used: wp.array(dtype=wp.int32)  # (1,)
    place: wp.array(dtype=wp.int32)  # where the packet begins
    pose: wp.array(dtype=wp.int32)
    est_voxel: wp.array(dtype=lanes_i)
    gt_voxel: wp.array(dtype=lanes_i)  # -1: no correspondence
