"""Voxel hash: an open-addressing table from packed voxel keys to integer accumulators.

A key packs the three voxel indices, 21 bits each with a bias, so that keys sort as (i, j, k) do. Collisions
probe linearly. All sums are integers: the order in which threads arrive changes slots, never totals, and an
export sorted by key is the same on every device.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from maomaps_warp.kernels.checks import check_array

wp.set_module_options({"enable_backward": False})

EMPTY_KEY = wp.constant(wp.int64(-1))
KEY_BITS = wp.constant(wp.int64(21))
KEY_BIAS = wp.constant(wp.int32(1 << 20))
# 2^64 / golden ratio: Fibonacci hashing (Knuth, TAOCP 3, 6.4) spreads neighbouring keys over the table.
_GOLDEN = wp.constant(wp.uint64(0x9E3779B97F4A7C15))
_HASH_SHIFT = wp.constant(wp.uint64(32))


@wp.struct
class VoxelHash:
    """The table. Its capacity is a power of two; `EMPTY_KEY` marks a free slot."""

    keys: wp.array(dtype=wp.int64)  # (capacity,)
    counts: wp.array(dtype=wp.int64)  # (capacity,) samples
    color_sums: wp.array2d(dtype=wp.int64)  # (capacity, 3) sums of 8-bit RGB
    size: wp.array(dtype=wp.int32)  # (1,) slots in use
    rejected: wp.array(dtype=wp.int64)  # (2,) samples lost: [no free slot, voxel outside the key range]


@wp.func
def pack_key(ijk: wp.vec3i) -> wp.int64:
    """Packed key of a voxel index; EMPTY_KEY if an index does not fit into 21 bits."""
    i = ijk[0] + KEY_BIAS
    j = ijk[1] + KEY_BIAS
    k = ijk[2] + KEY_BIAS
    key = EMPTY_KEY
    limit = 2 * KEY_BIAS
    if i >= 0 and i < limit and j >= 0 and j < limit and k >= 0 and k < limit:
        key = (wp.int64(i) << (KEY_BITS + KEY_BITS)) | (wp.int64(j) << KEY_BITS) | wp.int64(k)
    return key


@wp.func
def cell_of(point: wp.vec3, inv_voxel_size: wp.float32, center_offset: wp.float32) -> wp.vec3i:
    """Voxel that holds `point` (metres, relative to the grid's origin); halves round to even."""
    return wp.vec3i(
        wp.int32(wp.rint(point[0] * inv_voxel_size - center_offset)),
        wp.int32(wp.rint(point[1] * inv_voxel_size - center_offset)),
        wp.int32(wp.rint(point[2] * inv_voxel_size - center_offset)),
    )


@wp.func
def _first_slot(key: wp.int64, capacity: wp.int32) -> wp.int32:
    # Fold the product's high half into an index: the low bits of a product of odd numbers are weak.
    mixed = (wp.uint64(key) * _GOLDEN) >> _HASH_SHIFT
    return wp.int32(mixed & wp.uint64(capacity - 1))


@wp.func
def find_slot(keys: wp.array(dtype=wp.int64), key: wp.int64) -> wp.int32:
    """Slot of `key`, or -1 if the table does not hold it."""
    capacity = keys.shape[0]
    slot = _first_slot(key, capacity)
    result = int(-1)
    probes = int(0)
    while probes < capacity:
        found = keys[slot]
        if found == key:
            result = slot
            probes = capacity
        elif found == EMPTY_KEY:
            probes = capacity
        else:
            slot = (slot + 1) & (capacity - 1)
            probes += 1
    return result


@wp.func
def claim_slot(keys: wp.array(dtype=wp.int64), size: wp.array(dtype=wp.int32), key: wp.int64) -> wp.int32:
    """Slot of `key`, taking a free one if it is new; -1 if the table is full."""
    capacity = keys.shape[0]
    slot = _first_slot(key, capacity)
    result = int(-1)
    probes = int(0)
    while probes < capacity:
        found = keys[slot]
        if found == EMPTY_KEY:
            found = wp.atomic_cas(keys, slot, EMPTY_KEY, key)
            if found == EMPTY_KEY:
                wp.atomic_add(size, 0, 1)
                found = key
        if found == key:
            result = slot
            probes = capacity
        else:
            slot = (slot + 1) & (capacity - 1)
            probes += 1
    return result


@wp.func
def add_sample(table: VoxelHash, ijk: wp.vec3i, color: wp.vec3i, weight: wp.int64) -> wp.int32:
    """Add `weight` samples whose colours sum to `color`; returns the slot, or -1 and counts the loss."""
    key = pack_key(ijk)
    slot = int(-1)
    if key == EMPTY_KEY:
        wp.atomic_add(table.rejected, 1, weight)
    else:
        slot = claim_slot(table.keys, table.size, key)
        if slot < 0:
            wp.atomic_add(table.rejected, 0, weight)
        else:
            wp.atomic_add(table.counts, slot, weight)
            wp.atomic_add(table.color_sums, slot, 0, wp.int64(color[0]))
            wp.atomic_add(table.color_sums, slot, 1, wp.int64(color[1]))
            wp.atomic_add(table.color_sums, slot, 2, wp.int64(color[2]))
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
        moved = claim_slot(target.keys, target.size, key)
        target.counts[moved] = source.counts[slot]
        for channel in range(3):
            target.color_sums[moved, channel] = source.color_sums[slot, channel]


@wp.kernel
def _index_kernel(
    # In:
    ijk: wp.array(dtype=wp.vec3i),
    # Out:
    keys: wp.array(dtype=wp.int64),
    values: wp.array(dtype=wp.int32),
    size: wp.array(dtype=wp.int32),
):
    voxel = wp.tid()
    slot = claim_slot(keys, size, pack_key(ijk[voxel]))
    values[slot] = voxel


def create_voxel_hash(capacity: int, device: Any = None) -> VoxelHash:
    """An empty table.

    Args:
        capacity: slots, a power of two, at most 2^30.
        device: Warp device.
    """
    if capacity < 1 or capacity & (capacity - 1) or capacity > 1 << 30:
        raise ValueError(f"capacity: expected a power of two up to 2^30, got {capacity}")
    table = VoxelHash()
    table.keys = wp.full(capacity, wp.int64(-1), dtype=wp.int64, device=device)
    table.counts = wp.zeros(capacity, dtype=wp.int64, device=device)
    table.color_sums = wp.zeros((capacity, 3), dtype=wp.int64, device=device)
    table.size = wp.zeros(1, dtype=wp.int32, device=device)
    table.rejected = wp.zeros(2, dtype=wp.int64, device=device)
    return table


def rehash(source: VoxelHash, target: VoxelHash) -> None:
    """Move every voxel of `source` into the empty, larger `target` on the same device."""
    if target.keys.shape[0] < source.keys.shape[0]:
        raise ValueError(f"target: expected at least {source.keys.shape[0]} slots, got {target.keys.shape[0]}")
    wp.launch(
        _rehash_kernel,
        dim=source.keys.shape[0],
        inputs=[source],
        outputs=[target],
        device=source.keys.device,
    )
    wp.copy(target.rejected, source.rejected)


def build_voxel_index(
    ijk: wp.array, *, out_keys: wp.array | None = None, out_values: wp.array | None = None
) -> tuple[wp.array, wp.array]:
    """A hash from packed key to position in `ijk`, for `find_slot`.

    Args:
        ijk: occupied voxels, (N,) vec3i, unique, every index within 2^20 of zero.
        out_keys: (capacity,) int64, filled with EMPTY_KEY; a power of two larger than N. None: allocated.
        out_values: (capacity,) int32. None: allocated.

    Returns:
        keys (capacity,) int64 and values (capacity,) int32.
    """
    device = ijk.device
    check_array("ijk", ijk, wp.vec3i, (None,), device)
    if out_keys is None:
        capacity = 1 << max(4, (2 * len(ijk) - 1).bit_length())
        out_keys = wp.full(capacity, wp.int64(-1), dtype=wp.int64, device=device)
    capacity = out_keys.shape[0]
    if capacity & (capacity - 1) or capacity <= len(ijk):
        raise ValueError(f"out_keys: expected a power of two above {len(ijk)}, got {capacity}")
    if out_values is None:
        out_values = wp.full(capacity, -1, dtype=wp.int32, device=device)
    check_array("out_keys", out_keys, wp.int64, (capacity,), device)
    check_array("out_values", out_values, wp.int32, (capacity,), device)
    size = wp.zeros(1, dtype=wp.int32, device=device)
    wp.launch(_index_kernel, dim=len(ijk), inputs=[ijk], outputs=[out_keys, out_values, size], device=device)
    return out_keys, out_values
