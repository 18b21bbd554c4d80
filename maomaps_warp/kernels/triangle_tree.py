"""A tree of boxes around triangles, for packets of rays on a CPU: wp.Mesh has one, but shows it to single rays only.

Idea: from the root down, a node's triangles are sorted into slices along the axis on which their middles are spread
widest, and cut between two slices where the expected cost of a ray is least (surface area heuristic, binned: I. Wald,
"On fast construction of SAH-based bounding volume hierarchies", IEEE Symposium on Interactive Ray Tracing, 2007).
Cost: two passes over the triangles for each level, serial: 0.1 s for a hundred thousand. Limit: what moves needs a new
tree.
"""

import numpy as np
import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.lanes import lanes_f, lanes_i
from maomaps_warp.kernels.modules import RENDER

#: Slices that a node is cut between.
_SLICES = wp.constant(16)
#: Triangles of a leaf: at most so many, unless their middles coincide; so few are never cut.
_MOST_OF_LEAF = wp.constant(8)
_FEW = wp.constant(2)
#: Cost of a box, in triangles.
_BOX_COST = wp.constant(wp.float32(0.5))
#: From this depth on nodes are cut into halves, so that no path is longer than MAX_DEPTH.
_DEEP = wp.constant(32)
MAX_DEPTH = 64
#: Boxes are wider than their triangles, by this share of the largest coordinate: rays that pass an edge are rounded.
_MARGIN = wp.constant(wp.float32(1.0e-6))


@wp.struct
class TriangleTree:
    """Triangles in the order of a tree's leaves. Node 0 is the root; a node's children follow one another."""

    lower: wp.array(dtype=wp.vec3)  # (N,) corners of each node's box, metres
    upper: wp.array(dtype=wp.vec3)  # (N,)
    first: wp.array(dtype=wp.int32)  # (N,) a leaf's first triangle in the leaves' order; else the first child
    count: wp.array(dtype=wp.int32)  # (N,) a leaf's triangles; 0: no leaf
    axis: wp.array(dtype=wp.int32)  # (N,) on which the first child lies lower than the second, as a rule
    corners: wp.array(dtype=wp.vec3)  # (3 F,) of the triangles in the leaves' order, metres
    face: wp.array(dtype=wp.int32)  # (F,) which of the caller's triangles each is


@wp.func
def _half_area(lower: wp.vec3, upper: wp.vec3) -> wp.float32:
    size = wp.max(upper - lower, wp.vec3(0.0))
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


@wp.func
def _slice_of(middle: wp.float32, low: wp.float32, slices_per_metre: wp.float32) -> wp.int32:
    return wp.clamp(wp.int32((middle - low) * slices_per_metre), 0, _SLICES - 1)


@wp.func
def _widest(size: wp.vec3) -> wp.int32:
    axis = wp.int32(0)
    if size[1] > size[0]:
        axis = 1
    if size[2] > size[axis]:
        axis = 2
    return axis


@wp.kernel(module=RENDER)
def _build_kernel(
    # In: boxes and middles of the triangles.
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    middle: wp.array(dtype=wp.vec3),
    # Memory: nodes that wait, with their first triangle, how many they have, and their depth; boxes of the slices.
    waiting: wp.array2d(dtype=wp.int32),
    slice_low: wp.array(dtype=wp.vec3),
    slice_high: wp.array(dtype=wp.vec3),
    # In and out:
    order: wp.array(dtype=wp.int32),
    # Out:
    tree: TriangleTree,
    out_nodes: wp.array(dtype=wp.int32),
):
    nodes = wp.int32(1)
    waits = wp.int32(1)
    waiting[0, 0] = 0
    waiting[0, 1] = 0
    waiting[0, 2] = order.shape[0]
    waiting[0, 3] = 0
    while waits > 0:
        waits -= 1
        node = waiting[waits, 0]
        first = waiting[waits, 1]
        count = waiting[waits, 2]
        depth = waiting[waits, 3]
        lower = wp.vec3(wp.inf)
        upper = wp.vec3(-wp.inf)
        middle_low = wp.vec3(wp.inf)
        middle_high = wp.vec3(-wp.inf)
        for i in range(first, first + count):
            triangle = order[i]
            lower = wp.min(lower, low[triangle])
            upper = wp.max(upper, high[triangle])
            middle_low = wp.min(middle_low, middle[triangle])
            middle_high = wp.max(middle_high, middle[triangle])
        margin = _MARGIN * wp.max(wp.max(wp.abs(lower)), wp.max(wp.abs(upper)))
        tree.lower[node] = lower - wp.vec3(margin)
        tree.upper[node] = upper + wp.vec3(margin)
        axis = _widest(middle_high - middle_low)
        spread = middle_high[axis] - middle_low[axis]
        cut = wp.int32(0)  # triangles of the first child; 0: a leaf
        if count > _FEW and spread > 0.0:
            slices_per_metre = wp.float32(_SLICES) / spread
            counts = lanes_i()
            for s in range(_SLICES):
                slice_low[s] = wp.vec3(wp.inf)
                slice_high[s] = wp.vec3(-wp.inf)
            for i in range(first, first + count):
                triangle = order[i]
                s = _slice_of(middle[triangle][axis], middle_low[axis], slices_per_metre)
                counts[s] += 1
                slice_low[s] = wp.min(slice_low[s], low[triangle])
                slice_high[s] = wp.max(slice_high[s], high[triangle])
            # Areas of what lies behind each border, then of what lies before it.
            behind = lanes_f()
            box_low = wp.vec3(wp.inf)
            box_high = wp.vec3(-wp.inf)
            number = wp.int32(0)
            for back in range(_SLICES - 1):
                s = _SLICES - 1 - back
                box_low = wp.min(box_low, slice_low[s])
                box_high = wp.max(box_high, slice_high[s])
                number += counts[s]
                behind[s] = wp.float32(number) * _half_area(box_low, box_high)
            box_low = wp.vec3(wp.inf)
            box_high = wp.vec3(-wp.inf)
            number = wp.int32(0)
            least = wp.float32(wp.inf)
            border = wp.int32(1)
            for s in range(_SLICES - 1):
                box_low = wp.min(box_low, slice_low[s])
                box_high = wp.max(box_high, slice_high[s])
                number += counts[s]
                cost = behind[s + 1] + wp.float32(number) * _half_area(box_low, box_high)
                if number > 0 and number < count and cost < least:
                    least = cost
                    border = s + 1
                    cut = number
            whole = _half_area(lower, upper)
            if count <= _MOST_OF_LEAF and wp.float32(count) * whole <= least + 2.0 * _BOX_COST * whole:
                cut = 0
            elif depth >= _DEEP or cut == 0:
                cut = count // 2
            else:
                # Those before the border change places with those behind it.
                left = first
                right = first + count - 1
                while left <= right:
                    triangle = order[left]
                    if _slice_of(middle[triangle][axis], middle_low[axis], slices_per_metre) < border:
                        left += 1
                    else:
                        order[left] = order[right]
                        order[right] = triangle
                        right -= 1
        elif count > _MOST_OF_LEAF:
            cut = count // 2
        tree.axis[node] = axis
        if cut == 0:
            tree.first[node] = first
            tree.count[node] = count
        else:
            tree.first[node] = nodes
            tree.count[node] = 0
            for child in range(2):
                waiting[waits, 0] = nodes + child
                waiting[waits, 1] = first + child * cut
                waiting[waits, 2] = wp.where(child == 0, cut, count - cut)
                waiting[waits, 3] = depth + 1
                waits += 1
            nodes += 2
    out_nodes[0] = nodes


def build_triangle_tree(points: wp.array, indices: wp.array) -> TriangleTree:
    """A tree around triangles, on the CPU.

    Args:
        points: (P,) vec3, corners, metres.
        indices: (3 F,) int32, three corners of each triangle, F >= 1.

    Raises:
        TypeError: an array has the wrong dtype.
        ValueError: there are no triangles, a corner is none of the points, or an array has the wrong shape or device.
    """
    check_array("points", points, wp.vec3, (None,), "cpu")
    check_array("indices", indices, wp.int32, (None,), "cpu")
    triangles = len(indices) // 3
    if triangles < 1:
        raise ValueError("indices: expected at least one triangle, got none")
    if len(indices) % 3:
        raise ValueError(f"indices: expected three of each triangle, got {len(indices)}")
    numbers = indices.numpy().reshape(-1, 3)
    lowest, highest = int(numbers.min()), int(numbers.max())
    if lowest < 0 or highest >= len(points):
        raise ValueError(f"indices: expected 0 to {len(points) - 1}, got {lowest if lowest < 0 else highest}")
    corners = points.numpy()[numbers]
    low, high = (of(of(corners[:, 0], corners[:, 1]), corners[:, 2]) for of in (np.fmin, np.fmax))
    tree = TriangleTree()
    most = 2 * triangles
    tree.lower, tree.upper = (wp.empty(most, dtype=wp.vec3, device="cpu") for _ in range(2))
    tree.first, tree.count, tree.axis = (wp.empty(most, dtype=wp.int32, device="cpu") for _ in range(3))
    tree.face = wp.array(np.arange(triangles, dtype=np.int32), dtype=wp.int32, device="cpu")
    boxes = [wp.array(b, dtype=wp.vec3, device="cpu", copy=False) for b in (low, high, 0.5 * (low + high))]
    slices = [wp.empty(int(_SLICES), dtype=wp.vec3, device="cpu") for _ in range(2)]
    waiting = wp.empty((2 * MAX_DEPTH, 4), dtype=wp.int32, device="cpu")
    nodes = wp.empty(1, dtype=wp.int32, device="cpu")
    wp.launch(
        _build_kernel,
        dim=1,
        inputs=[*boxes, waiting, *slices, tree.face, tree, nodes],
        device="cpu",
    )
    used = int(nodes.numpy()[0])
    for name in ("lower", "upper", "first", "count", "axis"):
        setattr(tree, name, getattr(tree, name)[:used].contiguous())
    in_order = corners[tree.face.numpy()].reshape(-1, 3)
    tree.corners = wp.array(in_order, dtype=wp.vec3, device="cpu", copy=False)
    return tree


def check_tree(name: str, tree: TriangleTree) -> None:
    """Raise unless the arrays of a tree fit together and lie on the CPU."""
    if not hasattr(tree, "corners"):
        raise TypeError(f"{name}: expected a wp.Mesh or a TriangleTree, got {type(tree).__name__}")
    check_array(f"{name}.lower", tree.lower, wp.vec3, (None,), "cpu")
    nodes = len(tree.lower)
    check_array(f"{name}.upper", tree.upper, wp.vec3, (nodes,), "cpu")
    for each in ("first", "count", "axis"):
        check_array(f"{name}.{each}", getattr(tree, each), wp.int32, (nodes,), "cpu")
    check_array(f"{name}.face", tree.face, wp.int32, (None,), "cpu")
    check_array(f"{name}.corners", tree.corners, wp.vec3, (3 * len(tree.face),), "cpu")
