"""Which poses may see a brick of elements: one test for the whole brick instead of one for each element.

A pose stays unless it is certain that it sees no point of the brick's box. For each border of the view (a plane through
the camera) and for the near plane it is enough to look at the corner of the box that lies furthest inside; a margin for
rounding, far above what float32 can do to the exact test, keeps the answer safe. Sixteen poses are tested at once.
Cost: about sixty vector operations for sixteen poses and a brick. Limit: the lists are memory of one launch, which must
be one serial loop, as it is on a CPU.
"""

import warp as wp

from maomaps_warp.kernels.association_memory import (
    BINS,
    CULLED_BOUND,
    CULLED_POSE,
    LIST_BOUND,
    LIST_POSE,
    LIST_ROWS,
    PoseLists,
)
from maomaps_warp.kernels.association_types import View
from maomaps_warp.kernels.lane_logic import any_of, flag
from maomaps_warp.kernels.lane_memory import float_at, int_at, put
from maomaps_warp.kernels.lanes import LANES, lanes_f, lanes_i
from maomaps_warp.kernels.modules import OPTIONS
from maomaps_warp.kernels.ray_leap import smaller

wp.set_module_options(OPTIONS)

_BIN_BITS = wp.constant(19)
_FIRST_BIN = wp.constant((127 - 8) << 4)
#: Relative error of a plane's distance that is allowed for, 30 times what five float32 operations can cause.
_ROUNDING = wp.constant(wp.float32(1.0e-5))


@wp.func
def _outside(low: wp.float32, high: wp.float32, c: lanes_f) -> lanes_f:
    # How far c lies outside [low, high]. Rounding is monotonic: no element of the box is nearer, to the last bit.
    r = lanes_f()
    below = lanes_f(low) - c
    above = c - lanes_f(high)
    for k in range(16):
        gap = wp.where(below[k] > above[k], below[k], above[k])
        r[k] = wp.where(gap > 0.0, gap, 0.0)
    return r


@wp.func
def cull_poses(
    low: wp.vec3,
    high: wp.vec3,
    blocks: wp.array2d(dtype=lanes_f),
    poses: wp.int32,
    view: View,
    inv_voxel_size: wp.float32,
    out: PoseLists,
) -> wp.int32:
    """List the poses that may see an element in the box [low, high] in order of time; gives how many.

    Args:
        low, high: the box, metres.
        blocks: (blocks, BLOCK_ROWS) sixteen poses each, see `BLOCK_ROWS`.
        poses: how many poses the blocks hold.
        view: what an image shows.
        inv_voxel_size: 1 / metres; a camera within half a voxel of an element sees it wherever it looks.
        out: where they are listed.
    """
    center = 0.5 * (low + high)
    half = 0.5 * (high - low)
    steepest_y = wp.max(wp.abs(view.y_min), wp.abs(view.y_max))
    slope = 1.0 + wp.max(wp.max(wp.abs(view.x_min), wp.abs(view.x_max)), steepest_y)
    span = wp.abs(low[0]) + wp.abs(low[1]) + wp.abs(low[2]) + wp.abs(high[0]) + wp.abs(high[1]) + wp.abs(high[2])
    near = wp.where(view.two_sided, 0.0, view.near)
    max_square = view.max_range * view.max_range
    half_voxel = 0.50001 / inv_voxel_size + _ROUNDING * span
    both_sides = flag(view.two_sided)
    count = int(0)
    for block in range(blocks.shape[0]):
        cx = blocks[block, 0]
        cy = blocks[block, 1]
        cz = blocks[block, 2]
        x = lanes_f(center[0]) - cx
        y = lanes_f(center[1]) - cy
        z = lanes_f(center[2]) - cz
        reach = wp.abs(x) + wp.abs(y) + wp.abs(z)
        margin = (reach + lanes_f(span)) * (_ROUNDING * slope)
        ahead = lanes_f(3.0e38)  # signed distance to the nearest border for a camera that looks forward, ...
        behind = lanes_f(3.0e38)  # ... and for its mirror image
        for plane in range(5):
            nx = blocks[block, 3 + 3 * plane]
            ny = blocks[block, 4 + 3 * plane]
            nz = blocks[block, 5 + 3 * plane]
            inside = wp.cw_mul(nx, x) + wp.cw_mul(ny, y) + wp.cw_mul(nz, z)
            size = wp.abs(nx) * half[0] + wp.abs(ny) * half[1] + wp.abs(nz) * half[2] + margin
            if plane == 4:
                size = size - lanes_f(near)
            ahead = smaller(ahead, size + inside)
            behind = smaller(behind, size - inside)
        gx = _outside(low[0], high[0], cx)
        gy = _outside(low[1], high[1], cy)
        gz = _outside(low[2], high[2], cz)
        square = wp.cw_mul(gx, gx) + wp.cw_mul(gy, gy) + wp.cw_mul(gz, gz)
        keep = lanes_i()
        for k in range(16):
            seen = flag(ahead[k] >= 0.0) | (flag(behind[k] >= 0.0) & both_sides)
            within = flag(gx[k] <= half_voxel) & flag(gy[k] <= half_voxel) & flag(gz[k] <= half_voxel)
            is_pose = flag(block * LANES + k < poses)
            keep[k] = ((seen & flag(square[k] <= max_square)) | within) & is_pose
        if any_of(keep):
            # Every pose is written, and the next one over it if it is not kept: no branch.
            for k in range(16):
                put(out.address, CULLED_POSE * out.room + count, block * LANES + k)
                put(out.address, CULLED_BOUND * out.room + count, square[k])
                count += keep[k]
    return count


@wp.func
def list_by_time(count: wp.int32, backwards: wp.bool, lists: PoseLists):
    """List culled poses in order of time, or the other way round."""
    for rank in range(count):
        taken = rank
        if backwards:
            taken = count - 1 - rank
        put(lists.address, LIST_POSE * lists.room + rank, int_at(lists.address, CULLED_POSE * lists.room + taken))
        put(lists.address, LIST_BOUND * lists.room + rank, float(0.0))


@wp.func(inline=True)
def _bin_of(square: wp.float32) -> wp.int32:
    return wp.clamp((wp.cast(square, wp.int32) >> _BIN_BITS) - _FIRST_BIN, 0, BINS - 1)


@wp.func
def list_by_distance(count: wp.int32, lists: PoseLists):
    """List culled poses by how near they are at least, in bins of a few per cent; in order of time within a bin."""
    address = lists.address
    bins = LIST_ROWS * lists.room
    culled = CULLED_BOUND * lists.room
    for b in range(BINS):
        put(address, bins + b, int(0))
    for rank in range(count):
        b = _bin_of(float_at(address, culled + rank))
        put(address, bins + b, int_at(address, bins + b) + 1)
    next = int(0)
    for b in range(BINS):
        begin = next
        next += int_at(address, bins + b)
        put(address, bins + b, begin)
    for rank in range(count):
        b = _bin_of(float_at(address, culled + rank))
        place = int_at(address, bins + b)
        put(address, bins + b, place + 1)
        put(address, LIST_POSE * lists.room + place, int_at(address, CULLED_POSE * lists.room + rank))
        put(address, LIST_BOUND * lists.room + place, float_at(address, culled + rank))
    least = float(3.0e38)
    for rank in range(count):
        place = LIST_BOUND * lists.room + count - 1 - rank
        least = wp.min(least, float_at(address, place))
        put(address, place, least)
