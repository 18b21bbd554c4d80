"""From bricks of several threads to the sorted cells of a map.

Idea: bricks come sorted by their place in the grid. A first kernel adds up what threads hold of one brick, notes its
occupied cells as bits and counts them for each of its 8 layers along i; sums of these counts say where each layer's
cells begin in the sorted map. A second kernel writes the cells of one layer of a slab of bricks in order, without
sorting any of them.
Cost: a sweep over the touched bricks, and one over the occupied cells. Limit: a cell's samples of all threads together
stay within `MAX_SAMPLES`.
"""

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import MAP
from maomaps_warp.kernels.ranges import launch_ranges
from maomaps_warp.kernels.voxel_bricks import ints16

#: Tasks of a range: bricks, and layers of slabs.
_BRICKS_A_RANGE = 64
_LAYERS_A_RANGE = 2


@wp.func
def _samples(brick: wp.uint64, cell: wp.int32, channels: wp.int32) -> wp.int32:
    at = brick + wp.uint64((cell + 1) * channels - 1) * wp.uint64(4)
    return wp.array(ptr=at, shape=(1,), dtype=wp.int32)[0]


@wp.kernel(module=MAP)
def _merge_kernel(
    # In:
    start: wp.int32,
    sources: wp.array2d(dtype=wp.uint64),
    channels: wp.int32,
    # Out:
    merged: wp.array(dtype=wp.uint64),
    lines: wp.array2d(dtype=wp.uint8),
    occupied: wp.array2d(dtype=wp.int32),
):
    brick = start + wp.tid()
    target = wp.uint64(0)
    for thread in range(sources.shape[1]):
        source = sources[brick, thread]
        if target == wp.uint64(0):
            target = source
        elif source != wp.uint64(0):
            into = wp.array(ptr=target, shape=(32 * channels,), dtype=ints16)
            more = wp.array(ptr=source, shape=(32 * channels,), dtype=ints16)
            for part in range(32 * channels):
                into[part] = into[part] + more[part]
    merged[brick] = target
    count = int(0)
    for line in range(lines.shape[1]):  # 64, but Warp unrolls what it knows, and compiles it for seconds
        if (line & 7) == 0:
            count = 0
        bits = int(0)
        for k in range(8):
            is_occupied = wp.where(_samples(target, line * 8 + k, channels) != 0, 1, 0)
            bits = bits | (is_occupied << k)
            count += is_occupied
        lines[brick, line] = wp.uint8(bits)
        occupied[brick, line >> 3] = count


@wp.func
def _mean(total: wp.int32, samples: wp.uint32, rounded: wp.int32) -> wp.uint8:
    halves = wp.uint32(1 + rounded)
    return wp.uint8((halves * wp.uint32(total) + wp.uint32(rounded) * samples) / (halves * samples))


@wp.kernel(module=MAP)
def _write_kernel(
    # In:
    start: wp.int32,
    bricks: wp.array(dtype=wp.vec3i),
    merged: wp.array(dtype=wp.uint64),
    lines: wp.array2d(dtype=wp.uint8),
    slabs: wp.array(dtype=wp.int32),
    offsets: wp.array(dtype=wp.int32),
    channels: wp.int32,
    rounded: wp.int32,
    # Out:
    ijk: wp.array(dtype=wp.vec3i),
    counts: wp.array(dtype=wp.int64),
    colors: wp.array2d(dtype=wp.uint8),
):
    task = start + wp.tid()
    slab = task / 8
    layer = task - slab * 8
    at = offsets[task]
    first = slabs[slab]
    end = slabs[slab + 1]
    while first < end:
        # Bricks of the slab with the same j: a line along k.
        last = first + 1
        while last < end and bricks[last][1] == bricks[first][1]:
            last += 1
        for row in range(lines.shape[1] / 8):
            for brick in range(first, last):
                bits = wp.int32(lines[brick, layer * 8 + row])
                while bits != 0:
                    others = bits & (bits - 1)
                    k = wp.bit_count((bits ^ others) - 1)  # place of the lowest bit
                    bits = others
                    cell = layer * 64 + row * 8 + k
                    address = merged[brick]
                    low = bricks[brick]
                    samples = _samples(address, cell, channels)
                    ijk[at] = wp.vec3i(low[0] * 8 + layer, low[1] * 8 + row, low[2] * 8 + k)
                    counts[at] = wp.int64(samples)
                    if channels == 4:
                        sums = wp.array(ptr=address + wp.uint64(cell * 16), shape=(3,), dtype=wp.int32)
                        for channel in range(3):
                            colors[at, channel] = _mean(sums[channel], wp.uint32(samples), rounded)
                    at += 1
        first = last


def merge_bricks(
    sources: wp.array,
    channels: int,
    *,
    out_merged: wp.array,
    out_lines: wp.array,
    out_occupied: wp.array,
    threads: int = 1,
) -> None:
    """Add up what threads hold of each brick, in the memory of the first that has it; on a CPU.

    Args:
        sources: (B, T) uint64, addresses of brick b of thread t, 0 = none; one of each row at least is not 0. As
            `voxel_bricks` fills them.
        channels: int32 of a cell: 4 with colours, 1 without.
        out_merged: (B,) uint64, where the sums are.
        out_lines: (B, 64) uint8, of each line of 8 cells along k, a bit for each that is occupied.
        out_occupied: (B, 8) int32, occupied cells of each layer along i.
        threads: launch on so many.
    """
    count = sources.shape[0]
    check_array("sources", sources, wp.uint64, (None, None), "cpu")
    check_array("out_merged", out_merged, wp.uint64, (count,), "cpu")
    check_array("out_lines", out_lines, wp.uint8, (count, 64), "cpu")
    check_array("out_occupied", out_occupied, wp.int32, (count, 8), "cpu")
    if channels not in (1, 4):
        raise ValueError(f"channels: expected 1 or 4, got {channels}")
    launch_ranges(
        _merge_kernel,
        count,
        inputs=[sources, channels],
        outputs=[out_merged, out_lines, out_occupied],
        device="cpu",
        threads=threads,
        grain=_BRICKS_A_RANGE,
    )


def write_cells(
    bricks: wp.array,
    merged: wp.array,
    lines: wp.array,
    slabs: wp.array,
    offsets: wp.array,
    *,
    rounded: bool,
    out_ijk: wp.array,
    out_counts: wp.array,
    out_colors: wp.array,
    threads: int = 1,
) -> None:
    """Write the occupied cells of bricks in the order of their indices; on a CPU.

    Args:
        bricks: (B,) vec3i, index of each brick (its first cell divided by 8), in order.
        merged, lines: from `merge_bricks`.
        slabs: (S + 1,) int32, where each run of bricks with the same first index begins; the last is B.
        offsets: (S * 8,) int32, where the cells of each layer of each slab go.
        rounded: colours are means rounded half up, else rounded down.
        out_ijk: (N,) vec3i.
        out_counts: (N,) int64.
        out_colors: (N, 3) uint8; (0, 3) where cells have no colours.
        threads: launch on so many.
    """
    count, cells = bricks.shape[0], out_ijk.shape[0]
    with_colors = out_colors.shape[0] > 0
    check_array("bricks", bricks, wp.vec3i, (None,), "cpu")
    check_array("merged", merged, wp.uint64, (count,), "cpu")
    check_array("lines", lines, wp.uint8, (count, 64), "cpu")
    check_array("slabs", slabs, wp.int32, (None,), "cpu")
    check_array("offsets", offsets, wp.int32, (8 * (slabs.shape[0] - 1),), "cpu")
    check_array("out_ijk", out_ijk, wp.vec3i, (None,), "cpu")
    check_array("out_counts", out_counts, wp.int64, (cells,), "cpu")
    check_array("out_colors", out_colors, wp.uint8, (cells if with_colors else 0, 3), "cpu")
    launch_ranges(
        _write_kernel,
        offsets.shape[0],
        inputs=[bricks, merged, lines, slabs, offsets, 4 if with_colors else 1, int(rounded)],
        outputs=[out_ijk, out_counts, out_colors],
        device="cpu",
        threads=threads,
        grain=_LAYERS_A_RANGE,
    )
