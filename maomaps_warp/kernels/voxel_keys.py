"""Packed keys of voxels, and where a table of them holds one.

A key packs the three voxel indices, 21 bits each with a bias, so that keys sort as (i, j, k) do. In a table collisions
probe linearly.
"""

import warp as wp

EMPTY_KEY = wp.constant(wp.int64(-1))
KEY_BITS = wp.constant(wp.int64(21))
KEY_BIAS = wp.constant(1 << 20)


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
def first_slot(key: wp.int64, capacity: wp.int32) -> wp.int32:
    # The finaliser of MurmurHash3 (A. Appleby, public domain): every bit of the key moves every bit of the slot.
    h = wp.uint64(key)
    h = (h ^ (h >> wp.uint64(33))) * wp.uint64(0xFF51AFD7ED558CCD)
    h = (h ^ (h >> wp.uint64(33))) * wp.uint64(0xC4CEB9FE1A85EC53)
    h = h ^ (h >> wp.uint64(33))
    return wp.int32(h & wp.uint64(capacity - 1))


@wp.func
def find_slot(keys: wp.array(dtype=wp.int64), key: wp.int64) -> wp.int32:
    """Slot of `key`, or -1 if the table does not hold it, as it never holds EMPTY_KEY."""
    capacity = keys.shape[0]
    slot = first_slot(key, capacity)
    result = int(-1)
    for _probe in range(capacity):
        found = keys[slot]
        if found == EMPTY_KEY:
            break
        if found == key:
            result = slot
            break
        slot = (slot + 1) & (capacity - 1)
    return result
