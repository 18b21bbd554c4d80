"""Distance field of a voxel map: how many cells each cell is away from the nearest occupied one."""

from typing import Any

import warp as wp

from maomaps_warp.kernels.checks import check_array

#: Distances are counted up to here: further away says no more than "at least so far".
MAX_CLEARANCE = wp.constant(15)
#: Edge of the blocks in which a bricked field looks for emptiness, cells.
BLOCK = wp.constant(256)


@wp.struct
class DistanceField:
    """A voxel map as rays see it: closed cubes in a box, and how far each cell of the box is from one.

    Field cells are (0, 0, 0) .. (nx - 1, ny - 1, nz - 1); field cell (x, y, z) is cell (x, y, z) + lower of the grid.
    The outermost layer of cells is a border: it holds no voxel, and its clearance is 0, so that every ray ends there.

    A dense field has half a byte for each cell. A bricked one, for a large box, has bricks of 8 x 8 x 8 cells where a
    voxel is near; its clearances are the same, but for longer leaps where no voxel is near by far.
    """

    lower: wp.vec3i  # cell index, relative to the grid's origin, of field cell (0, 0, 0)
    nx: wp.int32  # cells, border included
    ny: wp.int32
    nz: wp.int32  # a multiple of 8
    voxel_size: wp.float32  # metres
    inv_voxel_size: wp.float32  # 1 / metres
    center_offset: wp.float32  # 0: cells centred on multiples of the voxel size; 0.5: starting there
    origin_scale: wp.float64  # field coordinates = metres * origin_scale + origin_shift
    origin_shift: wp.vec3d
    # Cells to the nearest occupied or border cell, capped, four bits each, so that a flat fits into a core's cache:
    # cell c in bits 4 (c & 7) of element c >> 3. Dense: c = z + nz * (y + ny * x); bricked: 512 cells each, z fastest.
    clearance: wp.array(dtype=wp.int32)
    clearance_address: wp.uint64  # of `clearance`
    # Dense: where a voxel is in the map.
    words: wp.int32  # 64-bit words of a column of cells along z
    layer: wp.int32  # words of all columns with one x, and up to seven more
    columns: wp.array(dtype=wp.uint64)  # [w + words * y + layer * x]: bit b says that cell z = 64 w + b is occupied
    ranks: wp.array(dtype=wp.int32)  # as columns: position in the map of the word's first voxel
    # Bricked: hashes of brick indices and of voxels.
    is_bricked: wp.bool
    brick_keys: wp.array(dtype=wp.int64)
    brick_values: wp.array(dtype=wp.int32)  # position of the brick in `clearance`
    block_keys: wp.array(dtype=wp.int64)  # blocks of BLOCK cells that hold a voxel, and those around them
    voxel_keys: wp.array(dtype=wp.int64)
    voxel_values: wp.array(dtype=wp.int32)  # position of the voxel in the map


def check_field(name: str, field: DistanceField, device: Any) -> None:
    """Raise unless the arrays of a field fit together and lie on `device`."""
    if field.clearance_address != field.clearance.ptr:
        raise ValueError(f"{name}.clearance_address: is not that of {name}.clearance")
    if field.is_bricked:
        check_array(f"{name}.clearance", field.clearance, wp.int32, (None,), device)
        for keys, values in (("brick_keys", "brick_values"), ("voxel_keys", "voxel_values")):
            check_array(f"{name}.{keys}", getattr(field, keys), wp.int64, (None,), device)
            check_array(f"{name}.{values}", getattr(field, values), wp.int32, (len(getattr(field, keys)),), device)
        check_array(f"{name}.block_keys", field.block_keys, wp.int64, (None,), device)
    else:
        check_array(f"{name}.clearance", field.clearance, wp.int32, (field.nx * field.ny * field.nz // 8,), device)
        check_array(f"{name}.columns", field.columns, wp.uint64, (field.layer * field.nx,), device)
        check_array(f"{name}.ranks", field.ranks, wp.int32, (field.layer * field.nx,), device)
