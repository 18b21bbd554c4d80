"""Rays of a camera through a tree of triangles on a CPU: a tile of 4 x 4 pixels at a time.

Idea: the rays of a tile pass the same boxes and triangles, so sixteen of them walk down a `TriangleTree` together, as
long as one of them meets a box, nearest child first. Triangles are met in the tile's own frame: the optical frame,
sheared so that the ray through the tile's middle is the z axis. There a ray is (a, b, 1), and corners near it have
small coordinates, which float32 multiplies exactly enough; the test of an edge is the same number, of opposite sign,
for the triangles on its two sides, so that no ray passes between them (S. Woop et al., "Watertight ray/triangle
intersection", Journal of Computer Graphics Techniques 2(1), 2013).
Cost: some 30 vector operations a box, 40 and as many scalar ones again a triangle, for sixteen rays. Limit: triangles
much smaller than a pixel, rays that have nothing in common, and lenses of nearly 180 degrees.
"""

import warp as wp

from maomaps_warp.kernels.lane_logic import any_of, flag
from maomaps_warp.kernels.lanes import lanes_f, lanes_i
from maomaps_warp.kernels.pixels import View
from maomaps_warp.kernels.ray_leap import larger, smaller
from maomaps_warp.kernels.triangle_tree import MAX_DEPTH, TriangleTree

#: Edge of a tile, pixels.
TILE = wp.constant(4)
_stack = wp.types.vector(length=MAX_DEPTH, dtype=wp.int32)
#: Stands for 1 / 0.
_STEEP = wp.constant(wp.float32(1.0e30))
#: More than what rounding takes from where a ray leaves a box (T. Ize, "Robust BVH ray traversal", Journal of Computer
#: Graphics Techniques 2(2), 2013).
_ROUNDED_UP = wp.constant(wp.float32(1.0000005))


@wp.struct
class TileRays:
    """Sixteen rays from one place, and the tile's frame."""

    origin: wp.vec3  # metres, world
    right: wp.vec3  # axes of the optical frame, world
    down: wp.vec3
    forward: wp.vec3
    middle_x: wp.float32  # slopes x / z and y / z of the ray through the middle, optical frame
    middle_y: wp.float32
    a: lanes_f  # slopes of the rays, less those of the middle
    b: lanes_f


@wp.func(inline=True)
def tile_rays(view: View, column: wp.int32, row: wp.int32, across: wp.float32, down: wp.float32) -> TileRays:
    """Rays through the pixels of the tile whose first one is (column, row), each moved by a part of a pixel."""
    rays = TileRays()
    rays.origin = wp.transform_get_translation(view.T_world_camera)
    rays.right = wp.transform_vector(view.T_world_camera, wp.vec3(1.0, 0.0, 0.0))
    rays.down = wp.transform_vector(view.T_world_camera, wp.vec3(0.0, 1.0, 0.0))
    rays.forward = wp.transform_vector(view.T_world_camera, wp.vec3(0.0, 0.0, 1.0))
    rays.middle_x = (wp.float32(column) + across + 1.5 - view.cx) / view.fx
    rays.middle_y = (wp.float32(row) + down + 1.5 - view.cy) / view.fy
    for k in range(16):
        rays.a[k] = (wp.float32(k & 3) - 1.5) / view.fx
        rays.b[k] = (wp.float32(k >> 2) - 1.5) / view.fy
    return rays


@wp.func(inline=True)
def _inverse(v: lanes_f) -> lanes_f:
    r = lanes_f()
    for k in range(16):
        r[k] = wp.where(wp.abs(v[k]) * _STEEP > 1.0, 1.0 / v[k], _STEEP)
    return r


@wp.func(inline=True)
def _meet_box(lower: wp.vec3, upper: wp.vec3, ix: lanes_f, iy: lanes_f, iz: lanes_f, best: lanes_f) -> wp.bool:
    """Whether a ray is in a box, given relative to where rays begin, before it has gone `best` far (slab method)."""
    x0 = ix * lower[0]
    x1 = ix * upper[0]
    y0 = iy * lower[1]
    y1 = iy * upper[1]
    z0 = iz * lower[2]
    z1 = iz * upper[2]
    enter = larger(smaller(x0, x1), larger(smaller(y0, y1), smaller(z0, z1)))
    leave = smaller(larger(x0, x1), smaller(larger(y0, y1), larger(z0, z1)))
    meets = lanes_i()
    for k in range(16):
        until = _ROUNDED_UP * wp.where(leave[k] < best[k], leave[k], best[k])
        meets[k] = flag(enter[k] <= until) & flag(leave[k] >= 0.0)
    return any_of(meets)


@wp.func(inline=True)
def _in_tile(rays: TileRays, point: wp.vec3) -> wp.vec3:
    """A point in the tile's frame."""
    p = point - rays.origin
    z = wp.dot(rays.forward, p)
    return wp.vec3(wp.dot(rays.right, p) - rays.middle_x * z, wp.dot(rays.down, p) - rays.middle_y * z, z)


@wp.func(inline=False)
def cast_tile(
    tree: TriangleTree, is_double_sided: wp.array(dtype=wp.uint8), rays: TileRays, max_t: wp.float32
) -> lanes_i:
    """The first triangle on each ray that shows this side, by its place in the leaves' order; -1: none."""
    ahead = rays.forward + rays.middle_x * rays.right + rays.middle_y * rays.down
    ix = _inverse(rays.a * rays.right[0] + rays.b * rays.down[0] + lanes_f(ahead[0]))
    iy = _inverse(rays.a * rays.right[1] + rays.b * rays.down[1] + lanes_f(ahead[1]))
    iz = _inverse(rays.a * rays.right[2] + rays.b * rays.down[2] + lanes_f(ahead[2]))
    best = lanes_f(max_t)
    place = lanes_i(-1)
    stack = _stack()
    waits = wp.int32(1)
    while waits > 0:
        waits -= 1
        node = stack[waits]
        if _meet_box(tree.lower[node] - rays.origin, tree.upper[node] - rays.origin, ix, iy, iz, best):
            first = tree.first[node]
            count = tree.count[node]
            if count == 0:
                farther = wp.where(ahead[tree.axis[node]] < 0.0, 0, 1)
                stack[waits] = first + farther
                stack[waits + 1] = first + 1 - farther
                waits += 2
            for p in range(first, first + count):
                a = _in_tile(rays, tree.corners[3 * p])
                b = _in_tile(rays, tree.corners[3 * p + 1])
                c = _in_tile(rays, tree.corners[3 * p + 2])
                normal = wp.cross(b - a, c - a)
                distance = wp.dot(normal, a)
                shows_both = wp.int32(is_double_sided[tree.face[p]])
                facing = rays.a * normal[0] + rays.b * normal[1] + lanes_f(normal[2])
                na = wp.cross(b, c)
                nb = wp.cross(c, a)
                nc = wp.cross(a, b)
                beside_a = rays.a * na[0] + rays.b * na[1] + lanes_f(na[2])
                beside_b = rays.a * nb[0] + rays.b * nb[1] + lanes_f(nb[2])
                beside_c = rays.a * nc[0] + rays.b * nc[1] + lanes_f(nc[2])
                for k in range(16):
                    least = wp.where(beside_a[k] < beside_b[k], beside_a[k], beside_b[k])
                    least = wp.where(least < beside_c[k], least, beside_c[k])
                    most = wp.where(beside_a[k] > beside_b[k], beside_a[k], beside_b[k])
                    most = wp.where(most > beside_c[k], most, beside_c[k])
                    front = flag(facing[k] < 0.0)
                    t = distance / wp.where(facing[k] != 0.0, facing[k], 1.0)
                    inside = (flag(least >= 0.0) | flag(most <= 0.0)) & flag(facing[k] != 0.0)
                    hit = inside & (front | shows_both) & flag(t > 0.0) & flag(t < best[k])
                    best[k] = wp.where(hit != 0, t, best[k])
                    place[k] = wp.where(hit != 0, p, place[k])
    return place
