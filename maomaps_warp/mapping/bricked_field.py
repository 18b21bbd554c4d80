"""Distance fields in bricks: for maps whose box is too large for a dense one, outliers or whole towns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import CapacityError
from maomaps_warp.model.voxels import pack_keys, unpack_keys

#: 256 bytes each: 4 GB. Elements of `clearance` have int32 numbers, enough for twice as many.
MOST_BRICKS = 1 << 24
#: Bricks this far from an occupied one have cells within reach of its voxels.
_NEAR = 2


def fill_with_bricks(field: Any, ijk: NDArray[np.int32], device: str, threads: int = 1) -> None:
    """Fill a field that is laid out with bricks where voxels are near.

    Memory grows with the occupied volume alone: 256 bytes for each brick of 8 x 8 x 8 cells within two of a voxel's.

    Args:
        field: kernels.distance_field.DistanceField of a box around `ijk`.
        ijk: (N, 3) int32, the map's voxels.
        device: Warp device.
        threads: on a CPU.

    Raises:
        CapacityError: more than MOST_BRICKS.
    """
    import warp as wp

    from maomaps_warp.kernels.brick_clearance import brick_clearance
    from maomaps_warp.kernels.distance_field import BLOCK
    from maomaps_warp.kernels.voxel_hash import build_voxel_index

    cells = ijk - np.array([*field.lower], dtype=np.int32)
    occupied, place = np.unique(pack_keys(cells >> 3), return_inverse=True)
    words = np.zeros((len(occupied), 8), dtype=np.uint64)
    bit = np.left_shift(np.uint64(1), (8 * (cells[:, 1] & 7) + (cells[:, 2] & 7)).astype(np.uint64))
    np.bitwise_or.at(words, (place, cells[:, 0] & 7), bit)
    bricks = unpack_keys(_around(occupied, _NEAR))
    if len(bricks) > MOST_BRICKS:
        raise CapacityError(
            f"a map of {len(ijk)} voxels, each far from the next, needs {256 * len(bricks) / 1e9:.1f} GB for its rays: "
            "crop it, remove outliers, or raise --voxel-size"
        )
    on_device = wp.array(bricks, dtype=wp.vec3i, device=device)
    keys, places = build_voxel_index(wp.array(unpack_keys(occupied), dtype=wp.vec3i, device=device))
    clearance = brick_clearance(
        on_device,
        keys,
        places,
        wp.array(words, dtype=wp.uint64, device=device),
        (field.nx, field.ny, field.nz),
        threads=threads,
    )
    field.is_bricked = True
    field.clearance = clearance.flatten()
    field.clearance_address = field.clearance.ptr
    field.brick_keys, field.brick_values = build_voxel_index(on_device)
    blocks = _around(np.unique(pack_keys(cells // int(BLOCK))), 1)
    field.block_keys, _ = build_voxel_index(wp.array(unpack_keys(blocks), dtype=wp.vec3i, device=device))
    field.voxel_keys, field.voxel_values = build_voxel_index(wp.array(ijk, dtype=wp.vec3i, device=device))


def _around(keys: NDArray[np.int64], reach: int) -> NDArray[np.int64]:
    """Keys of the bricks or blocks at most `reach` from any of `keys` along every axis."""
    for axis in range(3):
        step = pack_keys(np.eye(3, dtype=np.int64)[axis : axis + 1]) - pack_keys(np.zeros((1, 3), dtype=np.int64))
        keys = np.unique(np.concatenate([keys + n * step for n in range(-reach, reach + 1)]))
    return keys
