"""What is in a cell of a distance field, and where the cell is."""

import warp as wp

from maomaps_warp.kernels.distance_field import BLOCK, MAX_CLEARANCE, DistanceField
from maomaps_warp.kernels.modules import OPTIONS
from maomaps_warp.kernels.voxel_keys import find_slot, pack_key

wp.set_module_options(OPTIONS)


# Inlined, for a call would copy the struct, half a kilobyte.
@wp.func(inline=True)
def voxel_at(field: DistanceField, x: wp.int32, y: wp.int32, z: wp.int32) -> wp.int32:
    """Position in the map of the voxel in field cell (x, y, z), or -1 if the cell is free, border or outside."""
    voxel = int(-1)
    if x > 0 and y > 0 and z > 0 and x < field.nx - 1 and y < field.ny - 1 and z < field.nz - 1:
        if field.is_bricked:
            slot = find_slot(field.voxel_keys, pack_key(wp.vec3i(x, y, z) + field.lower))
            if slot >= 0:
                voxel = field.voxel_values[slot]
        else:
            word = (z >> 6) + field.words * y + field.layer * x
            column = field.columns[word]
            bit = wp.uint64(1) << wp.uint64(z & 63)
            if (column & bit) != wp.uint64(0):
                voxel = field.ranks[word] + wp.int32(wp.bit_count(column & (bit - wp.uint64(1))))
    return voxel


@wp.func(inline=True)
def clearance_at(field: DistanceField, x: wp.int32, y: wp.int32, z: wp.int32) -> wp.int32:
    """Cells from field cell (x, y, z) to the nearest occupied or border cell, capped; 0 in those."""
    cells = MAX_CLEARANCE
    element = int(-1)  # of eight cells, not the cell: that of the last bricks has no int32
    if field.is_bricked:
        slot = find_slot(field.brick_keys, pack_key(wp.vec3i(x >> 3, y >> 3, z >> 3)))
        if slot >= 0:
            element = 64 * field.brick_values[slot] + (y & 7) + 8 * (x & 7)
        else:
            # Far from every voxel, very far where the block and all around it are empty; but the border may be near.
            if find_slot(field.block_keys, pack_key(wp.vec3i(x >> 8, y >> 8, z >> 8))) < 0:
                cells = BLOCK
            to_border = wp.min(wp.min(x, field.nx - 1 - x), wp.min(y, field.ny - 1 - y))
            cells = wp.min(wp.min(to_border, wp.min(z, field.nz - 1 - z)), cells)
    else:
        element = (z >> 3) + (field.nz >> 3) * (y + field.ny * x)
    if element >= 0:
        cells = (field.clearance[element] >> ((z & 7) << 2)) & 15
    return cells


@wp.func(inline=True)
def ray_origin(field: DistanceField, point: wp.vec3) -> wp.vec3:
    """`point` (metres, relative to the grid's origin) in field coordinates: cell x spans [x, x + 1)."""
    # In float64, rounded once: the map may lie far from the grid's origin.
    shift = field.origin_shift
    return wp.vec3(
        wp.float32(wp.float64(point[0]) * field.origin_scale + shift[0]),
        wp.float32(wp.float64(point[1]) * field.origin_scale + shift[1]),
        wp.float32(wp.float64(point[2]) * field.origin_scale + shift[2]),
    )


@wp.func(inline=True)
def cell_center(field: DistanceField, x: wp.float32, y: wp.float32, z: wp.float32) -> wp.vec3:
    """Centre (metres, relative to the grid's origin) of field cell (x, y, z); the bits of `Surface.centers`."""
    return wp.vec3(
        (x + wp.float32(field.lower[0]) + field.center_offset) * field.voxel_size,
        (y + wp.float32(field.lower[1]) + field.center_offset) * field.voxel_size,
        (z + wp.float32(field.lower[2]) + field.center_offset) * field.voxel_size,
    )
