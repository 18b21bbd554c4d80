"""Voxel hash: an open-addressing table from packed voxel keys to integer accumulators.

Keys and slots are those of `voxel_keys`. All sums are integers: the order in which threads arrive changes slots, never
totals, and an export sorted by key is the same on every device.
"""

from typing import Any

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.voxel_keys import EMPTY_KEY, KEY_BIAS, first_slot, pack_key

# No fused multiply-adds: CPU and CUDA must put a point on a face into the same cell.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class VoxelHash:
    """The table. Its capacity is a power of two; `EMPTY_KEY` marks a free slot."""

    keys: wp.array(dtype=wp.int64)  # (capacity,)
    counts: wp.array(dtype=wp.int64)  # (capacity,) samples
    color_sums: wp.array2d(dtype=wp.int64)  # (capacity, 3) sums of 8-bit RGB; (0, 3) if colours are not kept
    size: wp.array(dtype=wp.int32)  # (1,) slots in use
    rejected: wp.array(dtype=wp.int64)  # (2,) samples lost: [no free slot, voxel outside the key range]


@wp.func
def _cell_along_axis(scaled: wp.float32, center_offset: wp.float32) -> wp.int32:
    cell = wp.floor(scaled)
    if center_offset == 0.0:
        cell = wp.rint(scaled)
    # Converting NaN or a huge number to an integer is undefined: these get an index that no key holds.
    index = 2 * KEY_BIAS
    if wp.abs(cell) < wp.float32(2 * KEY_BIAS):
        index = wp.int32(cell)
    return index


@wp.func
def cell_of(point: wp.vec3, inv_voxel_size: wp.float32, center_offset: wp.float32) -> wp.vec3i:
    """Voxel that holds `point` (metres, relative to the grid's origin).

    center_offset 0: cells centred on multiples of the voxel size, halves round to even (as in the world, if the
    grid's origin is an even index); 0.5: cells start there.
    """
    return wp.vec3i(
        _cell_along_axis(point[0] * inv_voxel_size, center_offset),
        _cell_along_axis(point[1] * inv_voxel_size, center_offset),
        _cell_along_axis(point[2] * inv_voxel_size, center_offset),
    )


@wp.func
def claim_slot(keys: wp.array(dtype=wp.int64), key: wp.int64):
    """(slot of `key`, whether it was free until now), taking a free one if the key is new; (-1, False) if full."""
    capacity = keys.shape[0]
    slot = first_slot(key, capacity)
    result = int(-1)
    is_new = bool(False)
    for _probe in range(capacity):
        found = keys[slot]
        if found == EMPTY_KEY:
            found = wp.atomic_cas(keys, slot, EMPTY_KEY, key)
            if found == EMPTY_KEY:
                is_new = True
                found = key
        if found == key:
            result = slot
            break
        slot = (slot + 1) & (capacity - 1)
    return result, is_new


@wp.func
def add_sample(table: VoxelHash, ijk: wp.vec3i, color: wp.vec3i, weight: wp.int64) -> wp.int32:
    """Add `weight` samples whose colours sum to `color`; returns the slot, or -1 and counts the loss."""
    key = pack_key(ijk)
    slot = int(-1)
    if key == EMPTY_KEY:
        wp.atomic_add(table.rejected, 1, weight)
    else:
        slot, is_new = claim_slot(table.keys, key)
        if is_new:
            wp.atomic_add(table.size, 0, 1)
        if slot < 0:
            wp.atomic_add(table.rejected, 0, weight)
        else:
            wp.atomic_add(table.counts, slot, weight)
            if table.color_sums.shape[0] > 0:
                for channel in range(3):
                    wp.atomic_add(table.color_sums, slot, channel, wp.int64(color[channel]))
    return slot


@wp.kernel
def _rehash_kernel(
    # In:
    source: VoxelHash,
    # Out:
    target: VoxelHash,
):
    slot = wp.tid()
    key = source.keys[slot]
    if key != EMPTY_KEY:
        moved, _is_new = claim_slot(target.keys, key)
        target.counts[moved] = source.counts[slot]
        if source.color_sums.shape[0] > 0:
            for channel in range(3):
                target.color_sums[moved, channel] = source.color_sums[slot, channel]


@wp.kernel
def _index_kernel(
    # In:
    ijk: wp.array(dtype=wp.vec3i),
    # Out:
    keys: wp.array(dtype=wp.int64),
    values: wp.array(dtype=wp.int32),
):
    voxel = wp.tid()
    slot, _is_new = claim_slot(keys, pack_key(ijk[voxel]))
    values[slot] = voxel


def create_voxel_hash(capacity: int, device: Any = None, *, with_colors: bool = False) -> VoxelHash:
    """An empty table.

    Args:
        capacity: slots, a power of two, at most 2^30.
        device: Warp device.
        with_colors: also sum colours; takes 40 instead of 16 bytes a slot.
    """
    if capacity < 1 or capacity & (capacity - 1) or capacity > 1 << 30:
        raise ValueError(f"capacity: expected a power of two up to 2^30, got {capacity}")
    table = VoxelHash()
    table.keys = wp.full(capacity, wp.int64(-1), dtype=wp.int64, device=device)
    table.counts = wp.zeros(capacity, dtype=wp.int64, device=device)
    table.color_sums = wp.zeros((capacity if with_colors else 0, 3), dtype=wp.int64, device=device)
    table.size = wp.zeros(1, dtype=wp.int32, device=device)
    table.rejected = wp.zeros(2, dtype=wp.int64, device=device)
    return table


def check_table(name: str, table: VoxelHash, device: Any) -> None:
    """Raise unless the arrays of a table fit together and lie on `device`."""
    capacity = table.keys.shape[0]
    check_array(f"{name}.keys", table.keys, wp.int64, (capacity,), device)
    check_array(f"{name}.counts", table.counts, wp.int64, (capacity,), device)
    color_rows = capacity if table.color_sums.shape[0] else 0
    check_array(f"{name}.color_sums", table.color_sums, wp.int64, (color_rows, 3), device)
    check_array(f"{name}.size", table.size, wp.int32, (1,), device)
    check_array(f"{name}.rejected", table.rejected, wp.int64, (2,), device)


def rehash(source: VoxelHash, target: VoxelHash) -> None:
    """Move every voxel of `source` into the empty, larger `target` on the same device."""
    device = source.keys.device
    check_table("source", source, device)
    check_table("target", target, device)
    if target.keys.shape[0] < source.keys.shape[0]:
        raise ValueError(f"target: expected at least {source.keys.shape[0]} slots, got {target.keys.shape[0]}")
    if bool(source.color_sums.shape[0]) != bool(target.color_sums.shape[0]):
        raise ValueError("target: expected colours exactly where source has them")
    wp.launch(_rehash_kernel, dim=source.keys.shape[0], inputs=[source], outputs=[target], device=device)
    wp.copy(target.size, source.size)
    wp.copy(target.rejected, source.rejected)


def build_voxel_index(
    ijk: wp.array, *, out_keys: wp.array | None = None, out_values: wp.array | None = None
) -> tuple[wp.array, wp.array]:
    """A hash from packed key to position in `ijk`, for `find_slot`.

    Args:
        ijk: occupied voxels, (N,) vec3i, unique, every index within 2^20 of zero.
        out_keys: (capacity,) int64; a power of two larger than N. None: allocated.
        out_values: (capacity,) int32. None: allocated.

    Returns:
        keys (capacity,) int64 and values (capacity,) int32.
    """
    device = ijk.device
    check_array("ijk", ijk, wp.vec3i, (None,), device)
    if out_keys is None:
        out_keys = wp.empty(1 << max(4, (2 * len(ijk) - 1).bit_length()), dtype=wp.int64, device=device)
    capacity = out_keys.shape[0]
    if capacity & (capacity - 1) or capacity <= len(ijk):
        raise ValueError(f"out_keys: expected a power of two above {len(ijk)}, got {capacity}")
    if out_values is None:
        out_values = wp.empty(capacity, dtype=wp.int32, device=device)
    check_array("out_keys", out_keys, wp.int64, (capacity,), device)
    check_array("out_values", out_values, wp.int32, (capacity,), device)
    out_keys.fill_(EMPTY_KEY)
    wp.launch(_index_kernel, dim=len(ijk), inputs=[ijk], outputs=[out_keys, out_values], device=device)
    return out_keys, out_values
