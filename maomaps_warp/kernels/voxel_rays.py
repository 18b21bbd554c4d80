"""First occupied voxel on a ray, by leaps through a distance field: sixteen rays at a time, or one.

A cell with clearance r is the middle of a cube of 2 r - 1 cells that holds no voxel. A ray in it leaps to where it
leaves that cube: about ten leaps for a ray of fifty cells. Each leap waits for memory and for a chain of dependent
operations, so a CPU casts sixteen rays side by side in vectors (`lanes_f`, `lanes_i`) and two such packets in turn
(`ray_packets`), until all have met something; a GPU takes one ray a thread. Both call the same `leap`, operation for
operation: the same bits.

A ray's state is the cell it is in. Axes along which it runs backwards are mirrored, so that every ray runs upwards. The
axis on which it leaves the cube lands exactly on the next cell; the others are rounded down, never behind the cell they
are in and never outside the cube they may not leave. So no ray jumps over a voxel or out of the field, however floats
round: rounding can only move where it passes between two cells, by a few 1e-7 of the way it has come and of the width
of the field (at 2000 cells, 100 m at 0.05 m, up to 2e-5 m). Every leap out of a cell of clearance above 0 moves on by
at least one cell along one axis and back along none, and the border of the field has clearance 0: a ray ends after at
most nx + ny + nz leaps. A cell of clearance 0 is a fixed point; rays that have ended wait there for the others.

Limits: a packet of rays in unlike directions waits for the slowest; rays through a bricked field go one by one.
"""

from __future__ import annotations

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.distance_field import DistanceField, check_field, clearance_at, ray_origin, voxel_at
from maomaps_warp.kernels.modules import OPTIONS
from maomaps_warp.kernels.ranges import launch_ranges
from maomaps_warp.kernels.ray_leap import LANES, lanes_f, lanes_i, larger, leap
from maomaps_warp.kernels.ray_packets import cast_dense_packet, cast_dense_packets
from maomaps_warp.kernels.ray_start import enter, first_cell, is_direction, is_within, mirrored, unmirrored

# Loops over lanes are left to LLVM, see `modules`.
wp.set_module_options(OPTIONS)
wp.set_module_options({"max_unroll": 1})

#: Rays of two packets, which take turns (see `ray_packets`).
TWO_PACKETS = wp.constant(32)


@wp.func
def cast_ray(field: DistanceField, origin: wp.vec3, direction: wp.vec3) -> wp.vec3i:
    """Field cell of the first voxel on a ray; a border cell if it meets none (`voxel_at` of it is -1).

    Args:
        field: the map.
        origin: field coordinates, see `ray_origin`. In an occupied cell: that cell is the hit.
        direction: map frame, of any length from 1e-18 to 1e18.
    """
    largest = larger(wp.abs(direction[0]), larger(wp.abs(direction[1]), wp.abs(direction[2])))
    ox, dx, ix = mirrored(origin[0], direction[0], largest, field.nx)
    oy, dy, iy = mirrored(origin[1], direction[1], largest, field.ny)
    oz, dz, iz = mirrored(origin[2], direction[2], largest, field.nz)
    casts = is_direction(direction[0], direction[1], direction[2], largest)
    if casts != 0.0 and is_within(ox, field.nx) * is_within(oy, field.ny) * is_within(oz, field.nz) == 0.0:
        n = wp.vec3i(field.nx, field.ny, field.nz)
        entered = enter(n, wp.vec3(ox, oy, oz), wp.vec3(dx, dy, dz))
        ox = entered[0]
        oy = entered[1]
        oz = entered[2]
        casts = ox
    cell = wp.vec3i(0, 0, 0)
    if casts != 0.0:
        x = first_cell(ox, field.nx)
        y = first_cell(oy, field.ny)
        z = first_cell(oz, field.nz)
        r = wp.float32(1.0)
        while r > 0.0:
            cell = wp.vec3i(
                unmirrored(wp.int32(x), direction[0], field.nx),
                unmirrored(wp.int32(y), direction[1], field.ny),
                unmirrored(wp.int32(z), direction[2], field.nz),
            )
            r = wp.float32(clearance_at(field, cell[0], cell[1], cell[2]))
            x, y, z = leap(x, y, z, r, ox, oy, oz, dx, dy, dz, ix, iy, iz)
    return cell


@wp.func(inline=False)
def cast_bricked_packet(
    field: DistanceField,
    ox: lanes_f,
    oy: lanes_f,
    oz: lanes_f,
    dx: lanes_f,
    dy: lanes_f,
    dz: lanes_f,
    active: lanes_f,
):
    """`cast_packet` of a bricked field, ray by ray."""
    x, y, z = lanes_i(), lanes_i(), lanes_i()
    for lane in range(LANES):
        if active[lane] != 0.0:
            origin = wp.vec3(ox[lane], oy[lane], oz[lane])
            cell = cast_ray(field, origin, wp.vec3(dx[lane], dy[lane], dz[lane]))
            x[lane] = cell[0]
            y[lane] = cell[1]
            z[lane] = cell[2]
    return x, y, z


@wp.func(inline=True)
def cast_packet(
    field: DistanceField,
    ox: lanes_f,
    oy: lanes_f,
    oz: lanes_f,
    dx: lanes_f,
    dy: lanes_f,
    dz: lanes_f,
    active: lanes_f,
):
    """Field cells of the first voxels on 16 rays, lane by lane what `cast_ray` gives: lanes_i x, y, z.

    Args:
        field: the map.
        ox, oy, oz: origins, field coordinates, see `ray_origin`.
        dx, dy, dz: directions, map frame, of any length from 1e-18 to 1e18.
        active: 0 where no ray is to be cast: the answer is a border cell.
    """
    x, y, z = lanes_i(), lanes_i(), lanes_i()
    if field.is_bricked:
        x, y, z = cast_bricked_packet(field, ox, oy, oz, dx, dy, dz, active)
    else:
        n = wp.vec3i(field.nx, field.ny, field.nz)
        x, y, z = cast_dense_packet(field.clearance_address, n, ox, oy, oz, dx, dy, dz, active)
    return x, y, z


@wp.func(inline=True)
def cast_packets(
    field: DistanceField,
    ox: lanes_f,
    oy: lanes_f,
    oz: lanes_f,
    dx: lanes_f,
    dy: lanes_f,
    dz: lanes_f,
    active: lanes_f,
    ox2: lanes_f,
    oy2: lanes_f,
    oz2: lanes_f,
    dx2: lanes_f,
    dy2: lanes_f,
    dz2: lanes_f,
    active2: lanes_f,
):
    """Two packets at once, which takes a third less time than one after the other: lanes_i x, y, z, x2, y2, z2."""
    x, y, z, x2, y2, z2 = lanes_i(), lanes_i(), lanes_i(), lanes_i(), lanes_i(), lanes_i()
    if field.is_bricked:
        x, y, z = cast_bricked_packet(field, ox, oy, oz, dx, dy, dz, active)
        x2, y2, z2 = cast_bricked_packet(field, ox2, oy2, oz2, dx2, dy2, dz2, active2)
    else:
        n = wp.vec3i(field.nx, field.ny, field.nz)
        x, y, z, x2, y2, z2 = cast_dense_packets(
            field.clearance_address, n, ox, oy, oz, dx, dy, dz, active, ox2, oy2, oz2, dx2, dy2, dz2, active2
        )
    return x, y, z, x2, y2, z2


@wp.func(inline=True)
def _load_rays(field: DistanceField, origins: wp.array(dtype=wp.vec3), directions: wp.array(dtype=wp.vec3), first: int):
    """Sixteen rays from `first` on, as `cast_packet` takes them; beyond the last there are none."""
    last = origins.shape[0] - 1
    ox = lanes_f()
    oy = lanes_f()
    oz = lanes_f()
    dx = lanes_f()
    dy = lanes_f()
    dz = lanes_f()
    active = lanes_f()
    for lane in range(LANES):
        ray = wp.min(first + lane, last)
        origin = ray_origin(field, origins[ray])
        ox[lane] = origin[0]
        oy[lane] = origin[1]
        oz[lane] = origin[2]
        direction = directions[ray]
        dx[lane] = direction[0]
        dy[lane] = direction[1]
        dz[lane] = direction[2]
        active[lane] = wp.where(first + lane <= last, 1.0, 0.0)
    return ox, oy, oz, dx, dy, dz, active


@wp.kernel
def _cast_packets_kernel(
    # In:
    start: wp.int32,
    field: DistanceField,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    # Out:
    out_voxel: wp.array(dtype=wp.int32),
):
    first = TWO_PACKETS * (start + wp.tid())
    second = first + LANES
    ox, oy, oz, dx, dy, dz, active = _load_rays(field, origins, directions, first)
    ox2, oy2, oz2, dx2, dy2, dz2, active2 = _load_rays(field, origins, directions, second)
    x, y, z, x2, y2, z2 = cast_packets(field, ox, oy, oz, dx, dy, dz, active, ox2, oy2, oz2, dx2, dy2, dz2, active2)
    for lane in range(wp.min(wp.int32(LANES), origins.shape[0] - first)):
        out_voxel[first + lane] = voxel_at(field, x[lane], y[lane], z[lane])
    for lane in range(wp.min(wp.int32(LANES), origins.shape[0] - second)):
        out_voxel[second + lane] = voxel_at(field, x2[lane], y2[lane], z2[lane])


@wp.kernel
def _cast_rays_kernel(
    # In:
    start: wp.int32,
    field: DistanceField,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    # Out:
    out_voxel: wp.array(dtype=wp.int32),
):
    ray = start + wp.tid()
    cell = cast_ray(field, ray_origin(field, origins[ray]), directions[ray])
    out_voxel[ray] = voxel_at(field, cell[0], cell[1], cell[2])


def cast_voxel_rays(
    field: DistanceField,
    origins: wp.array,
    directions: wp.array,
    *,
    out_voxel: wp.array | None = None,
    packets: bool = True,
    threads: int = 1,
) -> wp.array:
    """First occupied voxel on each ray.

    Args:
        field: the map.
        origins: (R,) vec3, metres relative to the grid's origin.
        directions: (R,) vec3, of any length from 1e-18 to 1e18.
        out_voxel: (R,) int32. None: allocated.
        packets: sixteen rays at a time where the device is a CPU; False: one by one, with the same answers.
        threads: on a CPU.

    Returns:
        out_voxel: position of the hit voxel in the map; -1 where the ray meets nothing or has no direction.
    """
    device = origins.device
    check_field("field", field, device)
    check_array("origins", origins, wp.vec3, (None,), device)
    check_array("directions", directions, wp.vec3, (len(origins),), device)
    if out_voxel is None:
        out_voxel = wp.empty(len(origins), dtype=wp.int32, device=device)
    check_array("out_voxel", out_voxel, wp.int32, (len(origins),), device)
    in_packets = packets and device.is_cpu
    launch_ranges(
        _cast_packets_kernel if in_packets else _cast_rays_kernel,
        -(-len(origins) // int(TWO_PACKETS)) if in_packets else len(origins),
        inputs=[field, origins, directions],
        outputs=[out_voxel],
        device=device,
        threads=threads,
        grain=64,
    )
    return out_voxel
