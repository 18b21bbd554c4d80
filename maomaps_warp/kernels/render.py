"""Renders images of a triangle mesh by casting rays through its pixels.

The pinhole model is that of sensor_msgs/CameraInfo without distortion: the optical frame has x right, y down,
z forward, and pixel (0, 0) is the centre of the first pixel. Depth, normals and parts are those of the ray through the
pixel's centre, so that a depth is that of one surface; colours are the mean over a grid of rays. Which face a ray meets
is found in two ways; what it meets there is computed by one function for both (`pixels.surface_at`).

Cost: one ray of depth and samples^2 of colours a pixel. Down wp.Mesh's tree they walk alone; faces that show only their
front are passed from behind, as a rasteriser that culls them does: a new walk from there on, which misses what lies
less than 0.01 mm behind (beyond 25 m what the depth is rounded by), such as the other side of a sheet of two faces.
Down a `TriangleTree`, on a CPU, sixteen walk together and miss nothing (`tile_cast`).
"""

from dataclasses import dataclass

import warp as wp

from maomaps_warp.kernels.appearance import Appearance, color_of_hit
from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.lanes import lanes_f
from maomaps_warp.kernels.modules import RENDER
from maomaps_warp.kernels.pixels import View, is_seen, ray_through, search_depth, surface_at, write_surface
from maomaps_warp.kernels.ranges import launch_ranges
from maomaps_warp.kernels.tile_cast import TILE, cast_tile, tile_rays
from maomaps_warp.kernels.triangle_tree import TriangleTree, check_tree

#: How many culled faces a ray passes at most, and how far behind one it goes on, metres of depth and share of it.
_MOST_PASSED = wp.constant(64)
_BEHIND = wp.constant(wp.float32(1.0e-5))
_BEHIND_SHARE = wp.constant(wp.float32(4.0e-7))
#: Least pixels of a range of a launch.
_LEAST_PIXELS = 1024


@wp.func
def first_seen(
    mesh: wp.uint64, is_double_sided: wp.array(dtype=wp.uint8), origin: wp.vec3, direction: wp.vec3, max_t: wp.float32
) -> wp.int32:
    """The first face on a ray that shows this side; -1: none."""
    face = wp.int32(-1)
    t = wp.float32(0.0)
    passed = wp.int32(0)
    while passed < _MOST_PASSED:
        hit = wp.mesh_query_ray(mesh, origin + t * direction, direction, max_t - t)
        if not hit.result:
            passed = _MOST_PASSED
        elif is_double_sided[hit.face] == wp.uint8(0) and wp.dot(hit.normal, direction) > 0.0:
            t = t + hit.t
            t = t + wp.max(_BEHIND, _BEHIND_SHARE * t)
            passed += 1
        else:
            face = hit.face
            passed = _MOST_PASSED
    return face


@wp.func
def _surface_of_mesh(mesh: wp.uint64, face: wp.int32, origin: wp.vec3, direction: wp.vec3):
    return surface_at(
        wp.mesh_get_point(mesh, 3 * face),
        wp.mesh_get_point(mesh, 3 * face + 1),
        wp.mesh_get_point(mesh, 3 * face + 2),
        origin,
        direction,
    )


@wp.func
def _surface_of_tree(tree: TriangleTree, place: wp.int32, origin: wp.vec3, direction: wp.vec3):
    return surface_at(
        tree.corners[3 * place], tree.corners[3 * place + 1], tree.corners[3 * place + 2], origin, direction
    )


@wp.func
def _as_bytes(color: wp.vec3) -> wp.vec3ub:
    return wp.vec3ub(
        wp.uint8(wp.min(color[0] + 0.5, 255.0)),
        wp.uint8(wp.min(color[1] + 0.5, 255.0)),
        wp.uint8(wp.min(color[2] + 0.5, 255.0)),
    )


@wp.func
def _offset(number: wp.int32, samples: wp.int32) -> wp.float32:
    """How far a sample lies from a pixel's centre along one axis, pixels."""
    return wp.where(samples > 1, (wp.float32(number) + 0.5) / wp.float32(samples) - 0.5, 0.0)


@wp.kernel(module=RENDER)
def _render_kernel(
    # In:
    start: wp.int32,
    mesh: wp.uint64,
    is_double_sided: wp.array(dtype=wp.uint8),
    face_part: wp.array(dtype=wp.int32),
    look: Appearance,
    view: View,
    samples: wp.int32,
    # Out, each of (height * width,), or empty if not asked for:
    depth: wp.array(dtype=wp.float32),
    colors: wp.array(dtype=wp.vec3ub),
    normals: wp.array(dtype=wp.vec3),
    parts: wp.array(dtype=wp.int32),
):
    pixel = start + wp.tid()
    row = wp.float32(pixel // view.columns)
    column = wp.float32(pixel % view.columns)
    origin = wp.transform_get_translation(view.T_world_camera)
    direction = ray_through(view, column, row)
    face = first_seen(mesh, is_double_sided, origin, direction, search_depth(view))
    t, u, v, normal = _surface_of_mesh(mesh, wp.max(face, 0), origin, direction)
    face = wp.where(is_seen(view, t), face, -1)
    write_surface(view, pixel, face, t, normal, direction, face_part, depth, normals, parts)
    if colors.shape[0] > 0:
        color = wp.vec3(0.0, 0.0, 0.0)
        for sample in range(samples * samples):
            if samples > 1:
                across = _offset(sample % samples, samples)
                direction = ray_through(view, column + across, row + _offset(sample // samples, samples))
                face = first_seen(mesh, is_double_sided, origin, direction, search_depth(view))
                t, u, v, normal = _surface_of_mesh(mesh, wp.max(face, 0), origin, direction)
            if face >= 0 and is_seen(view, t):
                color = color + color_of_hit(look, face, u, v, origin + t * direction, normal, direction)
        colors[pixel] = _as_bytes(color / wp.float32(samples * samples))


@wp.kernel(module=RENDER)
def _render_tiles_kernel(
    # In:
    start: wp.int32,
    tree: TriangleTree,
    is_double_sided: wp.array(dtype=wp.uint8),
    face_part: wp.array(dtype=wp.int32),
    look: Appearance,
    view: View,
    rows: wp.int32,
    samples: wp.int32,
    # Out, as those of `_render_kernel`:
    depth: wp.array(dtype=wp.float32),
    colors: wp.array(dtype=wp.vec3ub),
    normals: wp.array(dtype=wp.vec3),
    parts: wp.array(dtype=wp.int32),
):
    tile = start + wp.tid()
    tiles_of_row = (view.columns + TILE - 1) // TILE
    first_column = (tile % tiles_of_row) * TILE
    first_row = (tile // tiles_of_row) * TILE
    origin = wp.transform_get_translation(view.T_world_camera)
    places = cast_tile(tree, is_double_sided, tile_rays(view, first_column, first_row, 0.0, 0.0), search_depth(view))
    for k in range(16):
        column = first_column + (k & 3)
        row = first_row + (k >> 2)
        if column < view.columns and row < rows:
            place = wp.max(places[k], 0)
            direction = ray_through(view, wp.float32(column), wp.float32(row))
            t, _u, _v, normal = _surface_of_tree(tree, place, origin, direction)
            face = wp.where(places[k] >= 0 and is_seen(view, t), tree.face[place], -1)
            pixel = row * view.columns + column
            write_surface(view, pixel, face, t, normal, direction, face_part, depth, normals, parts)
    if colors.shape[0] > 0:
        red = lanes_f()
        green = lanes_f()
        blue = lanes_f()
        for sample in range(samples * samples):
            across = _offset(sample % samples, samples)
            down = _offset(sample // samples, samples)
            if samples > 1:
                shifted = tile_rays(view, first_column, first_row, across, down)
                places = cast_tile(tree, is_double_sided, shifted, search_depth(view))
            for k in range(16):
                place = places[k]
                if place >= 0:
                    column_k = wp.float32(first_column + (k & 3)) + across
                    direction_k = ray_through(view, column_k, wp.float32(first_row + (k >> 2)) + down)
                    t_k, u_k, v_k, normal_k = _surface_of_tree(tree, place, origin, direction_k)
                    if is_seen(view, t_k):
                        point = origin + t_k * direction_k
                        color = color_of_hit(look, tree.face[place], u_k, v_k, point, normal_k, direction_k)
                        red[k] += color[0]
                        green[k] += color[1]
                        blue[k] += color[2]
        for k in range(16):
            column = first_column + (k & 3)
            row = first_row + (k >> 2)
            if column < view.columns and row < rows:
                mean = wp.vec3(red[k], green[k], blue[k]) / wp.float32(samples * samples)
                colors[row * view.columns + column] = _as_bytes(mean)


@dataclass(frozen=True, eq=False)
class MeshScene:
    """A mesh on a device, ready to be rendered.

    Attributes:
        mesh: metres, world frame, z up; on a CPU a `TriangleTree` is rendered several times as fast.
        look: its colours; None renders none.
        is_double_sided: (F,) uint8: 0 where only the front (counter-clockwise) shows.
        face_part: (F,) int32, which part of the scene each face belongs to.
    """

    mesh: "wp.Mesh | TriangleTree"
    look: "Appearance | None"
    is_double_sided: wp.array
    face_part: wp.array


@dataclass(frozen=True, eq=False)
class Images:
    """What a camera sees; None where it was not asked for.

    Attributes:
        depth: (height, width) float32, metres along the optical axis; 0 where the ray hits nothing.
        colors: (height, width) vec3ub RGB, black where the rays hit nothing.
        normals: (height, width) vec3, unit vectors towards the camera, optical frame; 0 where the ray hits nothing.
        parts: (height, width) int32; -1 where the ray hits nothing.
    """

    depth: wp.array
    colors: wp.array | None
    normals: wp.array | None
    parts: wp.array | None


def render_scene(
    scene: MeshScene,
    view: View,
    height: int,
    *,
    samples: int = 1,
    with_normals: bool = False,
    with_parts: bool = False,
    out_depth: wp.array | None = None,
    out_colors: wp.array | None = None,
    threads: int = 1,
) -> Images:
    """Renders a scene as a pinhole camera sees it; runs on the scene's device and stream, without a sync.

    Args:
        scene: what there is; colours are rendered if it has some.
        view: the camera.
        height: of the image, pixels; its width is the view's.
        samples: colours are the mean of samples x samples rays a pixel.
        with_normals, with_parts: render those, too.
        out_depth: (height, width) float32 to write into; allocated if None.
        out_colors: (height, width) vec3ub to write into; allocated if None and the scene has colours.
        threads: on a CPU.

    Raises:
        TypeError: an array has the wrong dtype.
        ValueError: an array has the wrong shape or device, or a number is out of range.
    """
    shape = (height, view.columns)
    if min(shape) < 1 or samples < 1:
        raise ValueError(f"image size and samples must be positive, got {shape[1]}x{shape[0]}, {samples}")
    if scene.look is None and out_colors is not None:
        raise ValueError("out_colors needs a scene with colours")
    is_mesh = isinstance(scene.mesh, wp.Mesh)
    if is_mesh:
        device, faces = scene.mesh.device, scene.mesh.indices.size // 3
    else:
        check_tree("scene.mesh", scene.mesh)
        device, faces = scene.mesh.face.device, len(scene.mesh.face)
    if faces < 1:
        raise ValueError("scene.mesh: expected at least one triangle, got none")
    check_array("is_double_sided", scene.is_double_sided, wp.uint8, (faces,), device)
    check_array("face_part", scene.face_part, wp.int32, (faces,), device)
    if scene.look is not None:
        check_array("look.face_texture", scene.look.face_texture, wp.int32, (faces,), device)
    depth = _output("out_depth", out_depth, shape, wp.float32, device)
    colors = None if scene.look is None else _output("out_colors", out_colors, shape, wp.vec3ub, device)
    normals = wp.empty(shape, dtype=wp.vec3, device=device) if with_normals else None
    parts = wp.empty(shape, dtype=wp.int32, device=device) if with_parts else None
    look = Appearance() if scene.look is None else scene.look
    outputs = [None if image is None else image.flatten() for image in (depth, colors, normals, parts)]
    scenery = [scene.is_double_sided, scene.face_part, look, view]
    if is_mesh:
        kernel, tasks, inputs = _render_kernel, height * view.columns, [scene.mesh.id, *scenery, samples]
        grain = _LEAST_PIXELS
    else:
        tile = int(TILE)
        kernel, tasks = _render_tiles_kernel, -(-height // tile) * -(-view.columns // tile)
        inputs = [scene.mesh, *scenery, height, samples]
        grain = _LEAST_PIXELS // tile**2
    launch_ranges(kernel, tasks, inputs=inputs, outputs=outputs, device=device, threads=threads, grain=grain)
    return Images(depth, colors, normals, parts)


def _output(name: str, given: wp.array | None, shape: tuple[int, int], dtype: type, device: wp.Device) -> wp.array:
    if given is None:
        given = wp.empty(shape, dtype=dtype, device=device)
    check_array(name, given, dtype, shape, device)
    return given
