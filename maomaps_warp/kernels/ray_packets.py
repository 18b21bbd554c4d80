"""Rays through a distance field on a CPU: sixteen side by side in vectors, and two such packets in turn.

What `ray_cast` says of leaps holds here. A leap is a chain of some twenty operations that wait for one another, and
for a look into memory; a packet alone leaves the processor idle for more than half of it. So two packets take turns,
and one's waiting is the other's work. Limits: the two go on until all of their rays have ended, so rays in unlike
directions wait for the slowest; rays through a bricked field go one by one. Warp must not unroll the loops over lanes:
kernels that call this want `max_unroll` 1 (see `modules`).
"""

import warp as wp

from maomaps_warp.kernels.distance_field import DistanceField
from maomaps_warp.kernels.lanes import LANES, lanes_f, lanes_i
from maomaps_warp.kernels.ray_cast import cast_ray
from maomaps_warp.kernels.ray_leap import larger, leap
from maomaps_warp.kernels.ray_start import enter, first_cell, is_direction, is_within, mirrored, unmirrored

#: Longer than any field, and all bits of an index but its sign.
_ALL_BUT_SIGN = wp.constant(0x7FFFFFFF)


@wp.struct
class Packet:
    """Sixteen rays."""

    ox: lanes_f  # origins, field coordinates, see `ray_origin`
    oy: lanes_f
    oz: lanes_f
    dx: lanes_f  # directions, map frame, of any length from 1e-18 to 1e18
    dy: lanes_f
    dz: lanes_f
    active: lanes_f  # 0 where no ray is to be cast: the answer is a border cell


@wp.func(inline=True)
def _begin(n: wp.vec3i, rays: Packet):
    """Rays mirrored: origins, directions and their inverses, first cells; where a cell (x, y, z) of a ray lies in
    memory, base + x * along_x + y * along_y + z * along_z, the first byte for idle lanes; and which lanes cast."""
    dx = rays.dx
    dy = rays.dy
    dz = rays.dz
    active = rays.active
    largest = larger(wp.abs(dx), larger(wp.abs(dy), wp.abs(dz)))
    px, ex, ix = mirrored(rays.ox, dx, largest, n[0])
    py, ey, iy = mirrored(rays.oy, dy, largest, n[1])
    pz, ez, iz = mirrored(rays.oz, dz, largest, n[2])
    casts = lanes_f()
    outside = lanes_f()
    # Whole numbers are summed up: with floats, whose order counts, the loop would not become vector operations.
    strays = wp.int32(0)
    for lane in range(LANES):
        casts[lane] = wp.where(active[lane] != 0.0, is_direction(dx[lane], dy[lane], dz[lane], largest[lane]), 0.0)
        within = is_within(px[lane], n[0]) * is_within(py[lane], n[1]) * is_within(pz[lane], n[2])
        outside[lane] = casts[lane] * (1.0 - within)
        strays = strays | wp.int32(outside[lane])
    if strays != 0:
        for lane in range(LANES):
            if outside[lane] != 0.0:
                entered = enter(n, wp.vec3(px[lane], py[lane], pz[lane]), wp.vec3(ex[lane], ey[lane], ez[lane]))
                px[lane] = entered[0]
                py[lane] = entered[1]
                pz[lane] = entered[2]
                casts[lane] = wp.where(entered[0] != 0.0, 1.0, 0.0)
    x = lanes_f()
    y = lanes_f()
    z = lanes_f()
    base = lanes_i()
    along_x = lanes_i()
    along_y = lanes_i()
    along_z = lanes_i()
    for lane in range(LANES):
        x[lane] = first_cell(px[lane], n[0])
        y[lane] = first_cell(py[lane], n[1])
        z[lane] = first_cell(pz[lane], n[2])
        used = wp.int32(casts[lane])
        along_x[lane] = wp.where(dx[lane] < 0.0, -used, used) * n[2] * n[1]
        along_y[lane] = wp.where(dy[lane] < 0.0, -used, used) * n[2]
        along_z[lane] = wp.where(dz[lane] < 0.0, -used, used)
        corner = unmirrored(0, dx[lane], n[0]) * n[1] + unmirrored(0, dy[lane], n[1])
        base[lane] = used * (corner * n[2] + unmirrored(0, dz[lane], n[2]))
    return px, py, pz, ex, ey, ez, ix, iy, iz, x, y, z, base, along_x, along_y, along_z, casts


@wp.func(inline=True)
def look_up(address: wp.uint64, at: lanes_i) -> lanes_i:
    """Clearances of a dense field at some cells, each given by its place in memory."""
    # Of the bare address, as in `lane_memory`.
    clearance = wp.array(ptr=address, shape=(_ALL_BUT_SIGN,), dtype=wp.int32)
    element = (at >> lanes_i(3)) & lanes_i(_ALL_BUT_SIGN)
    eight = lanes_i()
    for lane in range(LANES):
        eight[lane] = clearance[element[lane]]
    return (eight >> ((at & lanes_i(7)) << lanes_i(2))) & lanes_i(15)


@wp.func(inline=True)
def _place(x: lanes_f, y: lanes_f, z: lanes_f, base: lanes_i, ax: lanes_i, ay: lanes_i, az: lanes_i) -> lanes_i:
    return base + wp.cw_mul(lanes_i(x), ax) + wp.cw_mul(lanes_i(y), ay) + wp.cw_mul(lanes_i(z), az)


@wp.func(inline=True)
def _end(n: wp.vec3i, x: lanes_f, y: lanes_f, z: lanes_f, rays: Packet, casts: lanes_f):
    """Field cells of mirrored rays; (0, 0, 0) for those that were not cast."""
    dx = rays.dx
    dy = rays.dy
    dz = rays.dz
    cell_x = lanes_i()
    cell_y = lanes_i()
    cell_z = lanes_i()
    for lane in range(LANES):
        used = wp.int32(casts[lane])
        cell_x[lane] = used * unmirrored(wp.int32(x[lane]), dx[lane], n[0])
        cell_y[lane] = used * unmirrored(wp.int32(y[lane]), dy[lane], n[1])
        cell_z[lane] = used * unmirrored(wp.int32(z[lane]), dz[lane], n[2])
    return cell_x, cell_y, cell_z


@wp.func(inline=False)
def cast_dense_packets(clearance_address: wp.uint64, n: wp.vec3i, rays: Packet, rays2: Packet):
    """`cast_packets` of a dense field of `n` cells."""
    px, py, pz, ex, ey, ez, ix, iy, iz, x, y, z, base, ax, ay, az, casts = _begin(n, rays)
    px2, py2, pz2, ex2, ey2, ez2, ix2, iy2, iz2, x2, y2, z2, base2, ax2, ay2, az2, casts2 = _begin(n, rays2)
    longest = wp.int32(1)
    while longest != 0:
        r = look_up(clearance_address, _place(x, y, z, base, ax, ay, az))
        r2 = look_up(clearance_address, _place(x2, y2, z2, base2, ax2, ay2, az2))
        x, y, z = leap(x, y, z, lanes_f(r), px, py, pz, ex, ey, ez, ix, iy, iz)
        x2, y2, z2 = leap(x2, y2, z2, lanes_f(r2), px2, py2, pz2, ex2, ey2, ez2, ix2, iy2, iz2)
        longest = wp.int32(0)
        for lane in range(LANES):
            longest = longest | r[lane] | r2[lane]
    cell_x, cell_y, cell_z = _end(n, x, y, z, rays, casts)
    cell_x2, cell_y2, cell_z2 = _end(n, x2, y2, z2, rays2, casts2)
    return cell_x, cell_y, cell_z, cell_x2, cell_y2, cell_z2


@wp.func(inline=False)
def cast_bricked_packet(field: DistanceField, rays: Packet):
    """A packet of a bricked field, ray by ray."""
    x, y, z = lanes_i(), lanes_i(), lanes_i()
    for lane in range(LANES):
        if rays.active[lane] != 0.0:
            origin = wp.vec3(rays.ox[lane], rays.oy[lane], rays.oz[lane])
            cell = cast_ray(field, origin, wp.vec3(rays.dx[lane], rays.dy[lane], rays.dz[lane]))
            x[lane] = cell[0]
            y[lane] = cell[1]
            z[lane] = cell[2]
    return x, y, z


@wp.func(inline=True)
def cast_packets(field: DistanceField, rays: Packet, rays2: Packet):
    """Field cells of the first voxels on two packets, lanes_i x, y, z, x2, y2, z2: lane by lane those of `cast_ray`."""
    x, y, z, x2, y2, z2 = lanes_i(), lanes_i(), lanes_i(), lanes_i(), lanes_i(), lanes_i()
    if field.is_bricked:
        x, y, z = cast_bricked_packet(field, rays)
        x2, y2, z2 = cast_bricked_packet(field, rays2)
    else:
        n = wp.vec3i(field.nx, field.ny, field.nz)
        x, y, z, x2, y2, z2 = cast_dense_packets(field.clearance_address, n, rays, rays2)
    return x, y, z, x2, y2, z2
