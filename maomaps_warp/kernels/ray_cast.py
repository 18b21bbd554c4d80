"""First occupied voxel on a ray, by leaps through a distance field.

A cell with clearance r is the middle of a cube of 2 r - 1 cells that holds no voxel. A ray in it leaps to where it
leaves that cube: about ten leaps for a ray of fifty cells. Each leap waits for memory and for a chain of dependent
operations, so a CPU casts sixteen rays side by side (`ray_packets`); a GPU takes one ray a thread. Both call the same
`leap`, operation for operation: the same bits.

A ray's state is the cell it is in. Axes along which it runs backwards are mirrored, so that every ray runs upwards. The
axis on which it leaves the cube lands exactly on the next cell; the others are rounded down, never behind the cell they
are in and never outside the cube they may not leave. So no ray jumps over a voxel or out of the field, however floats
round: rounding can only move where it passes between two cells, by a few 1e-7 of the way it has come and of the width
of the field (at 2000 cells, 100 m at 0.05 m, up to 2e-5 m). Every leap out of a cell of clearance above 0 moves on by
at least one cell along one axis and back along none, and the border of the field has clearance 0: a ray ends after at
most nx + ny + nz leaps. A cell of clearance 0 is a fixed point; rays that have ended wait there for the others.
"""

import warp as wp

from maomaps_warp.kernels.distance_field import DistanceField
from maomaps_warp.kernels.field_cells import clearance_at
from maomaps_warp.kernels.ray_leap import larger, leap
from maomaps_warp.kernels.ray_start import enter, first_cell, is_direction, is_within, mirrored, unmirrored


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
