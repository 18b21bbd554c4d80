"""Building a distance field, 64 cells at a time.

One bit a cell says "a voxel lies within r cells". Widening those bits by one cell is a handful of shifts and ors of
64-bit words, eight words to a vector. First each layer of one x by itself, for r = 0 to 14, then across the layers: a
cell is free of r where none of the layers x - r .. x + r has it. The clearance is the number of reaches r that leave a
cell free, counted in four binary digits, again 64 cells at a time.

Cost: about 360 loads of eight words for 512 cells, half of them where rooms are low: a block of cells is done with the
first reach that leaves none free. Limit: fifteen bit planes of a slab of layers: 120 MB, or 56 layers if that is more.
"""

import warp as wp

from maomaps_warp.kernels.bit_fields import spread_bits
from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.distance_field import MAX_CLEARANCE, DistanceField
from maomaps_warp.kernels.modules import SCORE
from maomaps_warp.kernels.ranges import launch_ranges

#: Words of one bit plane of a slab: fifteen planes of it take 120 MB. But a slab has at least 28 layers, beside the 28
#: around it that are widened with it: less would widen the same layers over and over.
_PLANE_WORDS = 1 << 20

words8 = wp.types.vector(length=8, dtype=wp.uint64)


@wp.func
def _first_voxel_of_layer(ijk: wp.array(dtype=wp.vec3i), i: wp.int32) -> wp.int32:
    """Position of the first voxel whose first index is at least `i`, in a map sorted by (i, j, k)."""
    low = int(0)
    high = ijk.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if ijk[middle][0] < i:
            low = middle + 1
        else:
            high = middle
    return low


@wp.kernel(module=SCORE)
def _fill_columns_kernel(
    # In:
    start: wp.int32,
    ijk: wp.array(dtype=wp.vec3i),
    field: DistanceField,
    # Out:
    out_columns: wp.array(dtype=wp.uint64),
    out_ranks: wp.array(dtype=wp.int32),
):
    x = start + wp.tid()
    last = _first_voxel_of_layer(ijk, field.lower[0] + x + 1)
    for voxel in range(_first_voxel_of_layer(ijk, field.lower[0] + x), last):
        cell = ijk[voxel] - field.lower
        word = (cell[2] >> 6) + field.words * cell[1] + field.layer * x
        column = out_columns[word]
        if column == wp.uint64(0):
            out_ranks[word] = voxel
        out_columns[word] = column | (wp.uint64(1) << wp.uint64(cell[2] & 63))


@wp.kernel(module=SCORE)
def _widen_in_layers_kernel(
    # In:
    start: wp.int32,
    field: DistanceField,
    first_layer: wp.int32,
    plane: wp.int32,
    # Out:
    out_planes: wp.array(dtype=wp.uint64),
    out_blocks: wp.array(dtype=words8),
):
    # out_blocks is the same memory: element i holds words i .. i + 7. Words before and after a layer, which other tasks
    # may be writing, reach only the layer's first and last column: those are border, all ones already.
    slot = start + wp.tid()
    x = first_layer + slot
    base = field.words + 1 + slot * field.layer
    ones = ~wp.uint64(0)
    for row in range(field.layer):
        y = row // field.words
        w = row - y * field.words
        word = ones
        if x > 0 and x < field.nx - 1 and y > 0 and y < field.ny - 1:
            word = field.columns[row + field.layer * x]
            if w == 0:
                word = word | wp.uint64(1)
            if w == field.words - 1:
                word = word | (ones << wp.uint64((field.nz - 1) & 63))
        out_planes[base + row] = word
    one = words8(wp.uint64(1))
    high = words8(wp.uint64(63))
    for _reach in range(1, wp.int32(MAX_CLEARANCE)):
        for block in range(field.layer // 8):
            i = base + 8 * block
            here = out_blocks[i] | out_blocks[i - field.words] | out_blocks[i + field.words]
            below = out_blocks[i - 1] | out_blocks[i - field.words - 1] | out_blocks[i + field.words - 1]
            above = out_blocks[i + 1] | out_blocks[i - field.words + 1] | out_blocks[i + field.words + 1]
            out_blocks[i + plane] = here | (here << one) | (here >> one) | (below >> high) | (above << high)
        base += plane


@wp.kernel(module=SCORE)
def _count_clearance_kernel(
    # In:
    start: wp.int32,
    field: DistanceField,
    blocks: wp.array(dtype=words8),
    first_layer: wp.int32,
    layers: wp.int32,
    plane: wp.int32,
    first_out: wp.int32,
    # Out:
    out_clearance: wp.array(dtype=wp.int32),
):
    task = start + wp.tid()
    blocks_of_layer = field.layer // 8
    x = first_out + task // blocks_of_layer
    row = 8 * (task % blocks_of_layer)
    # The number of reaches that leave a cell free, in four binary digits for each of the block's 512 cells.
    digit0 = words8()
    digit1 = words8()
    digit2 = words8()
    digit3 = words8()
    base = field.words + 1 + row
    slot = x - first_layer
    for reach in range(wp.int32(MAX_CLEARANCE)):  # a loop: unrolled it takes seconds to compile
        met = blocks[base + slot * field.layer]
        for step in range(1, reach + 1):
            met = met | blocks[base + wp.max(slot - step, 0) * field.layer]
            met = met | blocks[base + wp.min(slot + step, layers - 1) * field.layer]
        carry = ~met
        free = wp.uint64(0)
        for lane in range(8):
            free = free | carry[lane]
        if free == wp.uint64(0):
            break  # nor does any further reach leave a cell free
        for_next = digit0 & carry
        digit0 = digit0 ^ carry
        carry = digit1 & for_next
        digit1 = digit1 ^ for_next
        for_next = digit2 & carry
        digit2 = digit2 ^ carry
        digit3 = digit3 ^ for_next
        base += plane
    octets = field.nz >> 3
    y = row // field.words
    w = row - y * field.words
    for lane in range(wp.min(8, field.layer - row)):
        if y < field.ny:
            first = octets * (y + field.ny * x) + 8 * w
            for octet in range(wp.min(8, octets - 8 * w)):
                shift = wp.uint64(8 * octet)
                low = spread_bits(digit0[lane] >> shift) | (spread_bits(digit1[lane] >> shift) << 1)
                high = spread_bits(digit2[lane] >> shift) | (spread_bits(digit3[lane] >> shift) << 1)
                out_clearance[first + octet] = low | (high << 2)
        w += 1
        if w == field.words:
            w = 0
            y += 1


def lay_out_field(
    lower: tuple[int, int, int], upper: tuple[int, int, int], voxel_size: float, center_offset: float
) -> DistanceField:
    """A field around cells `lower` to `upper` that holds nothing yet; arguments as for `build_distance_field`."""
    field = DistanceField()
    field.lower = wp.vec3i(*(a - 1 for a in lower))
    field.nx, field.ny, field.nz, field.words, layer = _layout(lower, upper)
    if layer * field.nx < 1 << 31:  # else it has to be bricked, and needs none
        field.layer = layer
    field.voxel_size, field.inv_voxel_size, field.center_offset = voxel_size, 1.0 / voxel_size, center_offset
    field.origin_scale = 1.0 / voxel_size
    field.origin_shift = wp.vec3d(*(0.5 - center_offset - (a - 1) for a in lower))
    return field


def build_distance_field(
    ijk: wp.array,
    lower: tuple[int, int, int],
    upper: tuple[int, int, int],
    voxel_size: float,
    center_offset: float,
    *,
    threads: int = 1,
) -> DistanceField:
    """The dense distance field of occupied voxels.

    Args:
        ijk: (N,) vec3i, occupied voxels, unique, in the order of (i, j, k).
        lower, upper: least and greatest index along each axis; all voxels must lie within.
        voxel_size: metres.
        center_offset: 0 if cells are centred on multiples of the voxel size, 0.5 if they start there.
        threads: on a CPU.

    Raises:
        ValueError: the box has too many cells for a dense field.
    """
    device = ijk.device
    check_array("ijk", ijk, wp.vec3i, (None,), device)
    nx, ny, nz, _, layer = _layout(lower, upper)
    if max(nx * ny * nz, nx * layer) >= 1 << 31:
        raise ValueError(f"a box of {nx} x {ny} x {nz} cells is too large for a dense field")
    field = lay_out_field(lower, upper, voxel_size, center_offset)
    columns = wp.zeros(field.layer * field.nx, dtype=wp.uint64, device=device)
    ranks = wp.empty(field.layer * field.nx, dtype=wp.int32, device=device)
    launch_ranges(
        _fill_columns_kernel,
        field.nx,
        inputs=[ijk, field],
        outputs=[columns, ranks],
        device=device,
        threads=threads,
    )
    field.columns, field.ranks = columns, ranks
    field.clearance = wp.empty(field.nx * field.ny * field.nz // 8, dtype=wp.int32, device=device)
    field.clearance_address = field.clearance.ptr
    _fill_clearance(field, threads)
    return field


def _slab_layers(nx: int, layer: int) -> tuple[int, int]:
    """Layers of x whose clearances are counted at a time, and how many are widened for them."""
    halo = int(MAX_CLEARANCE) - 1
    slab = max(_PLANE_WORDS // layer - 2 * halo, 2 * halo)
    return slab, min(slab + 2 * halo, nx)


def dense_bytes_of(lower: tuple[int, int, int], upper: tuple[int, int, int]) -> int:
    """What a dense field around cells `lower` to `upper` takes while it is built."""
    nx, ny, nz, _, layer = _layout(lower, upper)
    planes = int(MAX_CLEARANCE) * 8 * layer * _slab_layers(nx, layer)[1]
    return nx * ny * nz // 2 + 12 * layer * nx + planes


def _layout(lower: tuple[int, int, int], upper: tuple[int, int, int]) -> tuple[int, int, int, int, int]:
    """nx, ny, nz, words and layer of a field, see DistanceField."""
    nx, ny, deep = (b - a + 3 for a, b in zip(lower, upper, strict=True))
    nz = -(-deep // 8) * 8  # whole elements of `clearance`
    words = -(-nz // 64)
    return nx, ny, nz, words, -(-ny * words // 8) * 8


def _fill_clearance(field: DistanceField, threads: int) -> None:
    """Fill `field.clearance` from `field.columns`, slab by slab of layers."""
    device = field.columns.device
    halo = MAX_CLEARANCE - 1
    slab, most = _slab_layers(field.nx, field.layer)
    plane = most * field.layer
    # Room at both ends for the neighbours of the first and the last word, whatever they hold.
    planes = wp.empty(MAX_CLEARANCE * plane + 2 * field.words + 16, dtype=wp.uint64, device=device)
    blocks = wp.array(ptr=planes.ptr, dtype=words8, shape=(len(planes) - 8,), strides=(8,), device=device)
    for first in range(0, field.nx, slab):
        last = min(first + slab, field.nx)
        first_layer = max(first - halo, 0)
        layers = min(last + halo, field.nx) - first_layer
        launch_ranges(
            _widen_in_layers_kernel,
            layers,
            inputs=[field, first_layer, plane],
            outputs=[planes, blocks],
            device=device,
            threads=threads,
        )
        launch_ranges(
            _count_clearance_kernel,
            (last - first) * (field.layer // 8),
            inputs=[field, blocks, first_layer, layers, plane, first],
            outputs=[field.clearance],
            device=device,
            threads=threads,
        )
