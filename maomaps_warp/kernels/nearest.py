"""Exact nearest neighbours of free points in a bounding-volume tree.

The tree is complete: points in Morton order are cut into 2^levels leaves of equal size, node n has children 2n and
2n + 1, and the boxes are tight. Any distribution of points works, clouds far apart and outliers included; float64, so
that an outlier cannot take the precision of the others away.
"""

import warp as wp

from maomaps_warp.kernels.checks import check_array

# No fused multiply-adds: a box must never be a bit farther than a point in it.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# A tree of L levels needs L + 1 places on the stack; 2^31 points are fewer than 32 levels.
_node_stack = wp.types.vector(length=32, dtype=wp.int32)
_distance_stack = wp.types.vector(length=32, dtype=wp.float64)


@wp.struct
class PointTree:
    """A tree over points, metres."""

    points: wp.array(dtype=wp.vec3d)  # (N,) in Morton order
    original: wp.array(dtype=wp.int32)  # (N,) their places in the caller's cloud
    lower: wp.array(dtype=wp.vec3d)  # (2 * leaves,) box of node n; entry 0 unused
    upper: wp.array(dtype=wp.vec3d)  # (2 * leaves,)
    leaf_start: wp.array(dtype=wp.int32)  # (leaves + 1,) points of leaf l: leaf_start[l] to leaf_start[l + 1]


@wp.func
def box_distance_sq(lower: wp.vec3d, upper: wp.vec3d, point: wp.vec3d) -> wp.float64:
    """Squared distance from a point to a box; 0 inside."""
    # where() instead of max(): wp.max carries NaN logic, which costs more than the comparison.
    total = wp.float64(0.0)
    for axis in range(3):
        below = lower[axis] - point[axis]
        above = point[axis] - upper[axis]
        gap = wp.where(below > above, below, above)
        gap = wp.where(gap > wp.float64(0.0), gap, wp.float64(0.0))
        total += gap * gap
    return total


@wp.func
def nearest_point(tree: PointTree, query: wp.vec3d) -> wp.int32:
    """Place in the caller's cloud of the point nearest to `query`; of equally near ones the lowest."""
    leaves = tree.leaf_start.shape[0] - 1
    best = wp.float64(wp.inf)
    result = int(-1)
    nodes = _node_stack()
    distances = _distance_stack()
    nodes[0] = 1
    depth = int(1)
    while depth > 0:
        depth -= 1
        node = nodes[depth]
        # Equal distance is not pruned: the tie goes to the lower place whatever order the nodes come in.
        if distances[depth] <= best:
            if node >= leaves:
                for k in range(tree.leaf_start[node - leaves], tree.leaf_start[node - leaves + 1]):
                    offset = tree.points[k] - query
                    distance = wp.dot(offset, offset)
                    if distance < best or (distance == best and tree.original[k] < result):
                        best = distance
                        result = tree.original[k]
            else:
                left = 2 * node
                to_left = box_distance_sq(tree.lower[left], tree.upper[left], query)
                to_right = box_distance_sq(tree.lower[left + 1], tree.upper[left + 1], query)
                # The nearer child goes on top.
                left_first = to_left <= to_right
                nodes[depth] = wp.where(left_first, left + 1, left)
                distances[depth] = wp.where(left_first, to_right, to_left)
                nodes[depth + 1] = wp.where(left_first, left, left + 1)
                distances[depth + 1] = wp.where(left_first, to_left, to_right)
                depth += 2
    return result


@wp.kernel
def _nearest_kernel(
    # In:
    tree: PointTree,
    queries: wp.array(dtype=wp.vec3d),
    # Out:
    out_index: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    out_index[i] = nearest_point(tree, queries[i])


def find_nearest(tree: PointTree, queries: wp.array, *, out_index: wp.array | None = None) -> wp.array:
    """Nearest tree point of each query, without a cut-off.

    Args:
        tree: at least one point.
        queries: (Q,) vec3d, metres.
        out_index: (Q,) int32. None: allocated.

    Returns:
        out_index: place of the nearest point in the caller's cloud; of equally near ones the lowest.
    """
    device = queries.device
    check_array("queries", queries, wp.vec3d, (None,), device)
    check_array("tree.points", tree.points, wp.vec3d, (None,), device)
    check_array("tree.original", tree.original, wp.int32, (len(tree.points),), device)
    check_array("tree.leaf_start", tree.leaf_start, wp.int32, (None,), device)
    check_array("tree.lower", tree.lower, wp.vec3d, (2 * len(tree.leaf_start) - 2,), device)
    check_array("tree.upper", tree.upper, wp.vec3d, (2 * len(tree.leaf_start) - 2,), device)
    if out_index is None:
        out_index = wp.empty(len(queries), dtype=wp.int32, device=device)
    check_array("out_index", out_index, wp.int32, (len(queries),), device)
    wp.launch(_nearest_kernel, dim=len(queries), inputs=[tree, queries], outputs=[out_index], device=device)
    return out_index
