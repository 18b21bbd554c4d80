"""Back-projection on a CPU: rows of depth into bricks of 8 x 8 x 8 voxels, 16 pixels at a time.

Idea: the cells of 16 neighbouring pixels are computed in vectors, without a branch, into a row of words (brick and
place in it); then each word adds its pixel to an accumulator (red, green, blue, count) with one load, one addition and
one store, all of one size, so that the next addition finds the sum on its way to memory. Pixels that are no samples go
to a brick that nobody reads. Bricks are found through a dense directory over a window of the grid and taken from a pool
when first touched. The words of a row are worked through with a distance of four, because neighbouring pixels often
share a voxel, and an addition has to wait for the one before. Few rows of all frames are taken before the next few:
frames that follow one another see the same voxels there, which are still in the fastest cache.
Cost: about 18 instructions a pixel; memory grows with the bricks that are touched.
Limit: one table, one thread. Sums are int32: a cell takes `MAX_SAMPLES` at most, and the caller keeps count. A row is
added whole or not at all: without room in the pool it stays pending; if it may leave the window it is marked.

The arithmetic is that of `back_projection`, operation for operation. CUDA takes that kernel.
"""

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import MAP

#: Pixels of a packet; rows are padded to multiples of it.
LANES = 16
vec16 = wp.types.vector(length=LANES, dtype=wp.float32)
ints16 = wp.types.vector(length=LANES, dtype=wp.int32)

#: A word holds the brick's place in the directory above these bits, the cell's place in the brick in them.
CELL_BITS = wp.constant(9)
#: Most entries of a directory: what a word has bits for.
MAX_DIRECTORY = 1 << 22
#: Samples that a cell can take: 2 * 255 * n + n must not leave uint32, when means are rounded.
MAX_SAMPLES = ((1 << 32) - 1) // 511

#: What `pending` says of a row.
DONE = wp.constant(0)
PENDING = wp.constant(1)
OUTSIDE = wp.constant(2)

# x + ROUND - ROUND rounds |x| < 2^22 to a whole number, halves to even: 1.5 * 2^23.
_ROUND = wp.constant(12582912.0)
#: Rows of an image that are worked on in one frame after the other.
_BLOCK_ROWS = wp.constant(8)
#: `nearest` counts in max_range / FULL_SHARE.
FULL_SHARE = wp.constant(1 << 20)


@wp.struct
class DepthRows:
    """What the images of a batch share. All of them are rows of packets: their width is a multiple of 16."""

    columns: wp.array(dtype=vec16)  # (W / 16,) (u - cx) / fx
    rows: wp.array(dtype=wp.float32)  # (H,) (v - cy) / fy
    least_squared: wp.float32  # metres squared, distance to the camera, exclusive
    most_squared: wp.float32  # metres squared, exclusive
    max_range: wp.float32  # metres
    floor_step: wp.float32  # 0: cells are rounded; 1: floored
    with_colors: wp.int32


@wp.struct
class BrickWindow:
    """The part of the grid that the directory covers."""

    low: wp.vec3i  # its first cell, a multiple of 8
    size: wp.vec3i  # cells, multiples of 8


@wp.struct
class BrickTable:
    """Accumulators of one thread. A cell is 4 int32 (red, green, blue, samples), or 1 (samples) without colours."""

    directory: wp.array(dtype=wp.uint64)  # address of a brick, 0 = none; entry 0: the brick for what is no sample
    pool: wp.uint64  # address of the first brick of the pool, zeros
    places: wp.array(dtype=wp.int32)  # (capacity,) directory entry of each brick of the pool
    used: wp.array(dtype=wp.int32)  # (1,) bricks of the pool in use


@wp.func
def _cell_on_axis(
    z: wp.float32,
    a: wp.float32,
    origin: wp.float32,
    ahead: wp.float32,
    side: wp.float32,
    floor_step: wp.float32,
    low: wp.int32,
) -> wp.int32:
    coordinate = origin + z * (ahead + a * side)
    rounded = (coordinate + _ROUND) - _ROUND
    return wp.int32(rounded - wp.where(rounded > coordinate, floor_step, 0.0)) - low


@wp.func
def _is_inside(low: wp.int32, size: wp.int32, origin: wp.float32, a: wp.float32, b: wp.float32, reach: wp.float32):
    # Everything a row can reach lies in a triangle (camera, both ends at max_range) and within `reach` of the camera.
    # One cell of slack for rounding, on both sides. Written so that NaN is outside.
    first = wp.max(wp.min(wp.min(a, b), 0.0), -reach) + origin - 1.0
    last = wp.min(wp.max(wp.max(a, b), 0.0), reach) + origin + 1.0
    return first > wp.float32(low) and last < wp.float32(low + size - 1)


@wp.func
def _brick_of(word: wp.int32, directory: wp.uint64, table: BrickTable, brick_bytes: wp.uint64) -> wp.uint64:
    """Address of the brick of `word`, taken from the pool if it has none; the caller has seen that there is room."""
    number_of_entry = wp.uint64(wp.uint32(word) >> wp.uint32(CELL_BITS))
    entry = wp.array(ptr=directory + number_of_entry * wp.uint64(8), shape=(1,), dtype=wp.uint64)
    brick = entry[0]
    if brick == wp.uint64(0):
        number = table.used[0]
        table.used[0] = number + 1
        table.places[number] = word >> CELL_BITS
        brick = table.pool + wp.uint64(number) * brick_bytes
        entry[0] = brick
    return brick


@wp.func
def _words_of_row(
    images: DepthRows,
    window: BrickWindow,
    address: wp.uint64,
    b: wp.float32,
    origin: wp.vec3,
    ahead: wp.vec3,
    side: wp.vec3,
    words: wp.array(dtype=ints16),
) -> wp.int32:
    """Write the words of a row whose depth lies at `address`; least depth of its samples, in max_range / FULL_SHARE."""
    packets = images.columns.shape[0]
    depth = wp.array(ptr=address, shape=(packets,), dtype=vec16)
    slope_squared = vec16(1.0 + b * b)
    bricks_y, bricks_z = window.size[1] >> 3, window.size[2] >> 3
    shares = wp.float32(FULL_SHARE) / images.max_range
    least = ints16(FULL_SHARE)
    for packet in range(packets):
        z = depth[packet]
        a = images.columns[packet]
        distance_squared = wp.cw_mul(wp.cw_mul(z, z), slope_squared + wp.cw_mul(a, a))
        word = ints16()
        share = ints16()
        for lane in range(16):
            taken = (
                wp.where(z[lane] > 0.0, -1, 0)
                & wp.where(distance_squared[lane] > images.least_squared, -1, 0)
                & wp.where(distance_squared[lane] < images.most_squared, -1, 0)
            )
            sample = wp.where(taken != 0, z[lane], 0.0)
            i = _cell_on_axis(sample, a[lane], origin[0], ahead[0], side[0], images.floor_step, window.low[0])
            j = _cell_on_axis(sample, a[lane], origin[1], ahead[1], side[1], images.floor_step, window.low[1])
            k = _cell_on_axis(sample, a[lane], origin[2], ahead[2], side[2], images.floor_step, window.low[2])
            entry = ((i >> 3) * bricks_y + (j >> 3)) * bricks_z + (k >> 3) + 1
            place = ((i & 7) << 6) | ((j & 7) << 3) | (k & 7)
            # What is no sample goes to a cell of its lane, or one addition would have to wait for the other.
            word[lane] = (((entry << CELL_BITS) | place) & taken) | (lane & ~taken)
            share[lane] = wp.int32(sample * shares) | (~taken & FULL_SHARE)
        least = wp.min(least, share)
        words[packet] = word
    return wp.min(least)


@wp.func
def _add_colors(
    packets: wp.int32, row_words: wp.uint64, row_colors: wp.uint64, table: BrickTable, keep: wp.vec4i, add: wp.vec4i
):
    directory = table.directory.ptr
    for packet in range(packets):
        of_packet = wp.array(ptr=row_words + wp.uint64(packet * 64), shape=(16,), dtype=wp.int32)
        color = wp.array(ptr=row_colors + wp.uint64(packet * 48), shape=(48,), dtype=wp.uint8)
        for turn in range(16):
            lane = (turn & 3) * 4 + (turn >> 2)
            brick = _brick_of(of_packet[lane], directory, table, wp.uint64(16 * 512))
            cell = wp.array(ptr=brick + wp.uint64((of_packet[lane] & 511) << 4), shape=(4,), dtype=wp.int32)
            # Four bytes at once, of which `keep` blots out the neighbour's and `add` counts this pixel: four equal
            # sums, which become one vector. All are read before any is written. The neighbour's is the next one's red,
            # of the last pixel the blue before it: no byte may be read beyond the image.
            red = wp.int32(color[3 * lane])
            green = wp.int32(color[3 * lane + 1])
            blue = wp.int32(color[3 * lane + 2])
            neighbour = wp.int32(color[3 * lane + 3 - 4 * (lane / 15)])
            cell[0] = cell[0] + ((red & keep[0]) | add[0])
            cell[1] = cell[1] + ((green & keep[1]) | add[1])
            cell[2] = cell[2] + ((blue & keep[2]) | add[2])
            cell[3] = cell[3] + ((neighbour & keep[3]) | add[3])


@wp.func
def _add_counts(packets: wp.int32, row_words: wp.uint64, table: BrickTable):
    directory = table.directory.ptr
    for packet in range(packets):
        of_packet = wp.array(ptr=row_words + wp.uint64(packet * 64), shape=(16,), dtype=wp.int32)
        for turn in range(16):
            lane = (turn & 3) * 4 + (turn >> 2)
            brick = _brick_of(of_packet[lane], directory, table, wp.uint64(4 * 512))
            cell = wp.array(ptr=brick + wp.uint64((of_packet[lane] & 511) << 2), shape=(1,), dtype=wp.int32)
            cell[0] = cell[0] + 1


@wp.kernel(module=MAP)
def _accumulate_kernel(
    # In:
    images: DepthRows,
    addresses: wp.array2d(dtype=wp.uint64),
    T_cells_camera: wp.array(dtype=wp.mat44),
    window: BrickWindow,
    keep: wp.vec4i,
    add: wp.vec4i,
    # Out:
    table: BrickTable,
    words: wp.array(dtype=ints16),
    pending: wp.array(dtype=wp.int32),
    nearest: wp.array(dtype=wp.int32),
):
    block, frame, row_of_block = wp.tid()
    row = block * _BLOCK_ROWS + row_of_block
    height = images.rows.shape[0]
    packets = images.columns.shape[0]
    if row >= height:
        return
    task = frame * height + row
    T = T_cells_camera[frame]
    b = images.rows[row]
    side = wp.vec3(T[0, 0], T[1, 0], T[2, 0])
    ahead = wp.vec3(T[0, 2] + T[0, 1] * b, T[1, 2] + T[1, 1] * b, T[2, 2] + T[2, 1] * b)
    origin = wp.vec3(T[0, 3], T[1, 3], T[2, 3])

    first_column = images.columns[0]
    last_column = images.columns[packets - 1]
    one_end = (ahead + first_column[0] * side) * images.max_range
    other_end = (ahead + last_column[15] * side) * images.max_range
    is_inside = bool(True)
    for axis in range(3):
        reach = wp.length(wp.vec3(T[axis, 0], T[axis, 1], T[axis, 2])) * images.max_range
        if not _is_inside(window.low[axis], window.size[axis], origin[axis], one_end[axis], other_end[axis], reach):
            is_inside = False
    if pending[task] == PENDING and not is_inside:
        pending[task] = OUTSIDE
    has_room = table.places.shape[0] - table.used[0] >= packets * 16
    if pending[task] == PENDING and has_room:
        depth = addresses[frame, 0] + wp.uint64(row) * wp.uint64(packets * 64)
        nearest[task] = _words_of_row(images, window, depth, b, origin, ahead, side, words)
        if images.with_colors != 0:
            colors = addresses[frame, 1] + wp.uint64(3 * row) * wp.uint64(packets * 16)
            _add_colors(packets, words.ptr, colors, table, keep, add)
        else:
            _add_counts(packets, words.ptr, table)
        pending[task] = DONE


def accumulate_rows(
    images: DepthRows,
    addresses: wp.array,
    T_cells_camera: wp.array,
    window: BrickWindow,
    *,
    out_table: BrickTable,
    out_words: wp.array,
    out_pending: wp.array,
    out_nearest: wp.array,
) -> None:
    """Add depth images to the table of one thread; on a CPU. Threads call it side by side, each with its own outputs.

    Afterwards look at `out_pending`: rows that are still PENDING found too little room in the pool; give the table a
    new pool and call again. Rows that are OUTSIDE may reach out of the window; none of their pixels is in the table.

    Args:
        images: what the N images share.
        addresses: (N, 2) uint64: of each image's depth, (H, W) float32, contiguous, metres along the optical axis, and
            of its colours, (H, W, 3) uint8 RGB, contiguous; or of those rows of larger images that `images.rows` is
            for. The caller keeps that memory alive. Depths <= 0, NaN and
            those out of range are no samples.
        T_cells_camera: (N,) mat44, as `integrate_depth` takes it.
        window: what the directory covers; at most MAX_DIRECTORY - 1 bricks, and |cells| < 2^21.
        out_table: takes the samples. Its pool must have MAX_SAMPLES of room in every cell: the caller keeps count.
        out_words: (W / 16,) ints16, scratch.
        out_pending: (N * H,) int32, rows in order; those that are PENDING are added, and become DONE or OUTSIDE.
        out_nearest: (N * H,) int32, set for each row that is added: a lower bound of its samples' depth, in
            max_range / FULL_SHARE.
    """
    count = addresses.shape[0]
    tasks = count * images.rows.shape[0]
    bricks = (window.size[0] >> 3) * (window.size[1] >> 3) * (window.size[2] >> 3)
    check_array("addresses", addresses, wp.uint64, (None, 2), "cpu")
    check_array("T_cells_camera", T_cells_camera, wp.mat44, (count,), "cpu")
    check_array("out_table.directory", out_table.directory, wp.uint64, (bricks + 1,), "cpu")
    check_array("out_table.places", out_table.places, wp.int32, (None,), "cpu")
    check_array("out_table.used", out_table.used, wp.int32, (1,), "cpu")
    check_array("out_words", out_words, ints16, images.columns.shape, "cpu")
    check_array("out_pending", out_pending, wp.int32, (tasks,), "cpu")
    check_array("out_nearest", out_nearest, wp.int32, (tasks,), "cpu")
    if bricks >= MAX_DIRECTORY or any(n % 8 for n in (*window.low, *window.size)):
        raise ValueError(f"window: expected multiples of 8 and fewer than {MAX_DIRECTORY} bricks, got {bricks}")
    wp.launch(
        _accumulate_kernel,
        dim=(-(-images.rows.shape[0] // _BLOCK_ROWS), count, _BLOCK_ROWS),
        inputs=[images, addresses, T_cells_camera, window, wp.vec4i(255, 255, 255, 0), wp.vec4i(0, 0, 0, 1)],
        outputs=[out_table, out_words, out_pending, out_nearest],
        device="cpu",
    )
