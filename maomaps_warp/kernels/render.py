"""Renders images of a triangle mesh by casting rays through its pixels.

The pinhole model is that of sensor_msgs/CameraInfo without distortion: the optical frame has x right, y down,
z forward, and pixel (0, 0) is the centre of the first pixel. Depth, normals and parts are those of the ray through the
pixel's centre, so that a depth is that of one surface; colours are the mean over a grid of rays.

Cost: a walk down wp.Mesh's tree for each ray, one of depth and samples^2 of colours a pixel. Faces that show only their
front are passed from behind, as a rasteriser that culls them does: a new walk from there on.
"""

import math
from dataclasses import dataclass

import warp as wp

from maomaps_warp.kernels.appearance import Appearance, color_of_hit
from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import RENDER
from maomaps_warp.kernels.ranges import launch_ranges

#: Depth of a pixel whose ray hits nothing, metres: depth images say "missing" so (elsewhere it is inf).
NO_DEPTH = wp.constant(wp.float32(0.0))
#: Part of such a pixel.
NO_PART = wp.constant(-1)
#: How many culled faces a ray passes at most, and how far behind one it goes on, metres of depth.
_MOST_PASSED = wp.constant(64)
_BEHIND = wp.constant(wp.float32(1.0e-5))
#: Least pixels of a range of a launch.
_LEAST_PIXELS = 1024


@wp.struct
class View:
    """A pinhole camera at a pose."""

    T_world_camera: wp.transformf  # optical frame
    fx: wp.float32  # pixels
    fy: wp.float32
    cx: wp.float32
    cy: wp.float32
    max_depth: wp.float32  # metres along the optical axis
    columns: wp.int32


@wp.func
def ray_through(view: View, u: wp.float32, v: wp.float32) -> wp.vec3:
    """World direction of the ray through image point (u, v), scaled to z = 1 in the optical frame: t is the depth."""
    return wp.transform_vector(view.T_world_camera, wp.vec3((u - view.cx) / view.fx, (v - view.cy) / view.fy, 1.0))


@wp.func
def first_seen(
    mesh: wp.uint64, is_double_sided: wp.array(dtype=wp.uint8), origin: wp.vec3, direction: wp.vec3, max_t: wp.float32
):
    """The first face on a ray that shows this side.

    Returns:
        Face (-1: none), t, barycentric coordinates u and v of its first two corners, normal.
    """
    face = wp.int32(-1)
    t = wp.float32(0.0)
    u = wp.float32(0.0)
    v = wp.float32(0.0)
    normal = wp.vec3(0.0, 0.0, 0.0)
    passed = wp.int32(0)
    while passed < _MOST_PASSED:
        hit = wp.mesh_query_ray(mesh, origin + t * direction, direction, max_t - t)
        if not hit.result:
            passed = _MOST_PASSED
        elif is_double_sided[hit.face] == wp.uint8(0) and wp.dot(hit.normal, direction) > 0.0:
            t = t + hit.t + _BEHIND
            passed += 1
        else:
            face = hit.face
            t = t + hit.t
            u = hit.u
            v = hit.v
            normal = hit.normal
            passed = _MOST_PASSED
    return face, t, u, v, normal


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
    face, t, u, v, normal = first_seen(mesh, is_double_sided, origin, direction, view.max_depth)
    depth[pixel] = wp.where(face >= 0, t, NO_DEPTH)
    if normals.shape[0] > 0:
        # Towards the camera, in the optical frame.
        facing = wp.where(wp.dot(normal, direction) > 0.0, -1.0, 1.0)
        normals[pixel] = wp.quat_rotate_inv(wp.transform_get_rotation(view.T_world_camera), facing * normal)
    if parts.shape[0] > 0:
        part = wp.int32(NO_PART)
        if face >= 0:
            part = face_part[face]
        parts[pixel] = part
    if colors.shape[0] > 0:
        color = wp.vec3(0.0, 0.0, 0.0)
        for sample in range(samples * samples):
            if samples > 1:
                across = (wp.float32(sample % samples) + 0.5) / wp.float32(samples) - 0.5
                down = (wp.float32(sample // samples) + 0.5) / wp.float32(samples) - 0.5
                direction = ray_through(view, column + across, row + down)
                face, t, u, v, normal = first_seen(mesh, is_double_sided, origin, direction, view.max_depth)
            if face >= 0:
                color = color + color_of_hit(look, face, u, v, origin + t * direction, normal, direction)
        color = color / wp.float32(samples * samples)
        colors[pixel] = wp.vec3ub(
            wp.uint8(wp.min(color[0] + 0.5, 255.0)),
            wp.uint8(wp.min(color[1] + 0.5, 255.0)),
            wp.uint8(wp.min(color[2] + 0.5, 255.0)),
        )


@dataclass(frozen=True, eq=False)
class MeshScene:
    """A mesh on a device, ready to be rendered.

    Attributes:
        mesh: metres, world frame, z up.
        look: its colours; None renders none.
        is_double_sided: (F,) uint8: 0 where only the front (counter-clockwise) shows.
        face_part: (F,) int32, which part of the scene each face belongs to.
    """

    mesh: wp.Mesh
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


def view_from(
    T_world_camera: wp.transformf,
    width: int,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    max_depth: float,
) -> View:
    """A camera at a pose.

    Args:
        T_world_camera: its pose, optical frame (x right, y down, z forward).
        width: of the image, pixels.
        fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels; (0, 0) is the centre of the first pixel.
        max_depth: surfaces beyond it are not seen, metres along the optical axis.

    Raises:
        ValueError: a number is out of range.
    """
    if not (math.isfinite(max_depth) and max_depth > 0.0):
        raise ValueError(f"max_depth must be positive and finite, got {max_depth}")
    if not (fx > 0.0 and fy > 0.0):
        raise ValueError(f"focal lengths must be positive, got fx={fx}, fy={fy}")
    view = View()
    view.T_world_camera = T_world_camera
    view.fx, view.fy, view.cx, view.cy = fx, fy, cx, cy
    view.max_depth = max_depth
    view.columns = width
    return view


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
    device = scene.mesh.device
    faces = scene.mesh.indices.size // 3
    check_array("is_double_sided", scene.is_double_sided, wp.uint8, (faces,), device)
    check_array("face_part", scene.face_part, wp.int32, (faces,), device)
    if scene.look is not None:
        check_array("look.face_texture", scene.look.face_texture, wp.int32, (faces,), device)
    depth = _output("out_depth", out_depth, shape, wp.float32, device)
    colors = None if scene.look is None else _output("out_colors", out_colors, shape, wp.vec3ub, device)
    normals = wp.empty(shape, dtype=wp.vec3, device=device) if with_normals else None
    parts = wp.empty(shape, dtype=wp.int32, device=device) if with_parts else None
    look = Appearance() if scene.look is None else scene.look
    launch_ranges(
        _render_kernel,
        height * view.columns,
        inputs=[scene.mesh.id, scene.is_double_sided, scene.face_part, look, view, samples],
        outputs=[None if image is None else image.flatten() for image in (depth, colors, normals, parts)],
        device=device,
        threads=threads,
        grain=_LEAST_PIXELS,
    )
    return Images(depth, colors, normals, parts)


def _output(name: str, given: wp.array | None, shape: tuple[int, int], dtype: type, device: wp.Device) -> wp.array:
    if given is None:
        given = wp.empty(shape, dtype=dtype, device=device)
    check_array(name, given, dtype, shape, device)
    return given
