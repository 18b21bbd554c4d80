"""The distance field of a voxel map, for rays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.bricked_field import fill_with_bricks
from maomaps_warp.model.voxels import VoxelMap
from maomaps_warp.threads import side_by_side, thread_count

#: Bytes that a dense field may take while it is built; maps with a larger box get bricks.
DENSE_BYTES = 512 << 20
#: Where eight clearances lie in a number.
_SHIFTS = np.arange(0, 32, 4, dtype=np.uint32)


@dataclass(frozen=True, eq=False)
class VoxelField:
    """Occupied voxels, ready for rays.

    Attributes:
        voxels: the map it was built from; hits are positions in it.
        field: kernels.distance_field.DistanceField, what kernels take.
        device: Warp device.
    """

    voxels: VoxelMap
    field: Any
    device: str


def build_voxel_fields(first: VoxelMap, second: VoxelMap, device: str = "cpu") -> tuple[VoxelField, VoxelField]:
    """The fields of two maps: on a CPU side by side, which shares its cores better than one after the other does."""
    build = partial(build_voxel_field, device=device, threads=max(1, thread_count(device) // 2))
    fields: tuple[VoxelField, VoxelField] = side_by_side(partial(build, first), partial(build, second), device=device)
    return fields


def build_voxel_field(
    voxels: VoxelMap, device: str = "cpu", *, dense_bytes: int = DENSE_BYTES, threads: int | None = None
) -> VoxelField:
    """Build the distance field of a map.

    Args:
        voxels: the map.
        device: Warp device.
        dense_bytes: where a dense field would take more, the field is made of bricks: slower to build and to cast rays
            through, with the same hits.
        threads: on a CPU; None: as many as `thread_count` says.

    Raises:
        ValueError: the map is empty.
        CapacityError: too large even for bricks.
    """
    import warp as wp

    from maomaps_warp.kernels.distance_field_building import build_distance_field, dense_bytes_of, lay_out_field

    if not len(voxels):
        raise ValueError("a distance field needs at least one voxel")
    i, j, k = (voxels.ijk[:, axis] for axis in range(3))
    lower = int(i[0]), int(j.min()), int(k.min())
    upper = int(i[-1]), int(j.max()), int(k.max())
    size, offset = voxels.grid.voxel_size, voxels.grid.center_offset
    threads = thread_count(device) if threads is None else threads
    if dense_bytes_of(lower, upper) <= dense_bytes:
        ijk = wp.array(voxels.ijk, dtype=wp.vec3i, device=device, copy=False)
        field = build_distance_field(ijk, lower, upper, size, offset, threads=threads)
    else:
        field = lay_out_field(lower, upper, size, offset)
        fill_with_bricks(field, voxels.ijk, device, threads)
    return VoxelField(voxels, field, device)


def unpack_clearance(field: Any) -> NDArray[np.uint8]:
    """Clearance of every cell of a dense field, (nx, ny, nz) uint8."""
    packed = field.clearance.numpy().view(np.uint32)
    cells = (packed[:, None] >> _SHIFTS).astype(np.uint8) & 15
    return np.asarray(cells.reshape(field.nx, field.ny, field.nz))
