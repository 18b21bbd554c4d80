"""Clearances of a bricked distance field: brick by brick, from the occupied bricks around it.

Like `distance_field_building`, on a window of 40 x 40 x 40 cells around the brick's 8 x 8 x 8: one 64-bit word for
each (x, y) of the window, its bits along z. Fifteen times the bits are widened by one cell along each axis, and the
cells that are still free are counted. What lies outside the window cannot come closer than those fifteen.

Cost: some 6000 operations on eight words a brick, however many voxels there are, and wherever. Limit: no neighbours
share work, so a map that fits a dense field is built many times as fast as one.
"""

import warp as wp

from maomaps_warp.kernels.bit_fields import spread_bits
from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.distance_field import MAX_CLEARANCE
from maomaps_warp.kernels.modules import OPTIONS
from maomaps_warp.kernels.ranges import launch_ranges
from maomaps_warp.kernels.voxel_keys import find_slot, pack_key

wp.set_module_options(OPTIONS)

words8 = wp.types.vector(length=8, dtype=wp.uint64)

#: Cells of a window along an axis, and words of its rows of y with a margin on both sides.
_WINDOW, _ROW, _MARGIN = wp.constant(40), wp.constant(48), wp.constant(4)
#: Words of the two windows that a task works on, with room behind the last.
_SCRATCH = wp.constant(2 * 40 * 48 + 8)
#: Where the brick lies in its window.
_INNER = wp.constant(16)
#: Bricks are shared out among so many tasks at most, each with windows of its own.
_TASKS = 256


@wp.func
def _load_window(
    brick: wp.vec3i,
    brick_keys: wp.array(dtype=wp.int64),
    brick_places: wp.array(dtype=wp.int32),
    occupied: wp.array2d(dtype=wp.uint64),
    base: wp.int32,
    window: wp.array(dtype=wp.uint64),
):
    """Write the occupied cells of the bricks around `brick` into a window."""
    for word in range(_WINDOW * _ROW):
        window[base + word] = wp.uint64(0)
    for neighbour in range(125):
        i = neighbour // 25
        j = (neighbour // 5) % 5
        k = neighbour % 5
        slot = find_slot(brick_keys, pack_key(brick + wp.vec3i(i - 2, j - 2, k - 2)))
        if slot >= 0:
            for x in range(8):
                layer = occupied[brick_places[slot], x]
                for y in range(8):
                    bits = (layer >> wp.uint64(8 * y)) & wp.uint64(255)
                    at = base + (8 * i + x) * _ROW + _MARGIN + 8 * j + y
                    window[at] = window[at] | (bits << wp.uint64(8 * k))


@wp.func
def _nearer_border(cell: wp.vec3i, shape: wp.vec3i) -> wp.int32:
    """Cells from a field cell to the border, capped; 0 on it and outside."""
    nearest = MAX_CLEARANCE
    for axis in range(3):
        nearest = wp.min(nearest, wp.min(cell[axis], shape[axis] - 1 - cell[axis]))
    return wp.max(nearest, 0)


@wp.kernel
def _brick_clearance_kernel(
    # In:
    start: wp.int32,
    bricks: wp.array(dtype=wp.vec3i),
    bricks_of_task: wp.int32,
    brick_keys: wp.array(dtype=wp.int64),
    brick_places: wp.array(dtype=wp.int32),
    occupied: wp.array2d(dtype=wp.uint64),
    shape: wp.vec3i,
    # Out:
    window: wp.array(dtype=wp.uint64),
    blocks: wp.array(dtype=words8),
    out_clearance: wp.array2d(dtype=wp.int32),
):
    # `blocks` is the memory of `window`: element i holds words i .. i + 7.
    task = start + wp.tid()
    here = task * _SCRATCH
    there = here + _WINDOW * _ROW
    one = words8(wp.uint64(1))
    for place in range(task * bricks_of_task, wp.min((task + 1) * bricks_of_task, bricks.shape[0])):
        brick = bricks[place]
        _load_window(brick, brick_keys, brick_places, occupied, here, window)
        for cells in range(64):
            out_clearance[place, cells] = 0
        for reach in range(wp.int32(MAX_CLEARANCE)):
            # Of the cells that no voxel has reached yet, each gains one. No count passes 15: they do not carry.
            for cells in range(64):
                row = here + (_INNER + cells // 8) * _ROW + _MARGIN + _INNER + cells % 8
                free = ~(window[row] >> wp.uint64(16))
                out_clearance[place, cells] = out_clearance[place, cells] + spread_bits(free)
            # Layers and rows that can still reach the brick.
            for x in range(reach, _WINDOW - reach):
                for block in range(5):
                    at = here + x * _ROW + _MARGIN + 8 * block
                    wide = blocks[at - 1] | blocks[at] | blocks[at + 1]
                    blocks[there + x * _ROW + _MARGIN + 8 * block] = wide | (wide << one) | (wide >> one)
            for x in range(reach + 1, _WINDOW - reach - 1):
                for block in range(5):
                    at = there + x * _ROW + _MARGIN + 8 * block
                    blocks[here + x * _ROW + _MARGIN + 8 * block] = blocks[at - _ROW] | blocks[at] | blocks[at + _ROW]
        first = brick * 8
        if wp.min(_nearer_border(first, shape), _nearer_border(first + wp.vec3i(7, 7, 7), shape)) < MAX_CLEARANCE:
            for cell in range(512):
                corner = first + wp.vec3i(cell // 64, (cell // 8) % 8, cell % 8)
                shift = 4 * (cell % 8)
                eight = out_clearance[place, cell // 8]
                cells = wp.min((eight >> shift) & 15, _nearer_border(corner, shape))
                out_clearance[place, cell // 8] = (eight & ~(15 << shift)) | (cells << shift)


def brick_clearance(
    bricks: wp.array,
    brick_keys: wp.array,
    brick_places: wp.array,
    occupied: wp.array,
    shape: tuple[int, int, int],
    *,
    out_clearance: wp.array | None = None,
    threads: int = 1,
) -> wp.array:
    """Cells from each cell of some bricks to the nearest occupied or border cell, at most 15.

    Args:
        bricks: (B,) vec3i, brick indices: field cells // 8.
        brick_keys, brick_places: hash of the occupied bricks, see `build_voxel_index`.
        occupied: (M, 8) uint64, cells of the occupied bricks: bit 8 y + z of word x.
        shape: of the field, cells with the border.
        out_clearance: (B, 64) int32, eight cells a number, four bits each, z fastest. None: allocated.
        threads: on a CPU.

    Returns:
        out_clearance.
    """
    device, count = bricks.device, len(bricks)
    check_array("bricks", bricks, wp.vec3i, (None,), device)
    check_array("brick_keys", brick_keys, wp.int64, (None,), device)
    check_array("brick_places", brick_places, wp.int32, (len(brick_keys),), device)
    check_array("occupied", occupied, wp.uint64, (None, 8), device)
    if out_clearance is None:
        out_clearance = wp.empty((count, 64), dtype=wp.int32, device=device)
    check_array("out_clearance", out_clearance, wp.int32, (count, 64), device)
    tasks = min(count, _TASKS)
    window = wp.zeros(tasks * int(_SCRATCH) + 8, dtype=wp.uint64, device=device)
    blocks = wp.array(ptr=window.ptr, dtype=words8, shape=(len(window) - 8,), strides=(8,), device=device)
    launch_ranges(
        _brick_clearance_kernel,
        tasks,
        inputs=[bricks, -(-count // max(tasks, 1)), brick_keys, brick_places, occupied, wp.vec3i(*shape)],
        outputs=[window, blocks, out_clearance],
        device=device,
        threads=threads,
    )
    return out_clearance
