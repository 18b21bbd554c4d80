"""Renders depth and colour images of a triangle mesh by casting one ray a pixel.

The pinhole model is that of sensor_msgs/CameraInfo without distortion: the optical frame has x right, y down,
z forward, and pixel (0, 0) is the centre of the first pixel.
"""

import math

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import RENDER
from maomaps_warp.kernels.ranges import launch_ranges

#: Depth of a pixel whose ray hits nothing, metres: depth images say "missing" so (elsewhere it is inf).
NO_DEPTH = wp.constant(wp.float32(0.0))
#: Shares of the light: from everywhere, from the camera, from above; dimensionless, their sum is 1.
_AMBIENT = wp.constant(wp.float32(0.48))
_HEADLIGHT = wp.constant(wp.float32(0.34))
_SKYLIGHT = wp.constant(wp.float32(0.18))
#: Edge of the texture's grains, metres, and how much they change the brightness, dimensionless.
_GRAIN_SIZE = wp.constant(wp.float32(0.023))
_GRAIN_CONTRAST = wp.constant(wp.float32(0.045))
#: How far behind the surface the texture is sampled, metres: a face between grains would flicker otherwise.
_GRAIN_INSET = wp.constant(wp.float32(0.004))
#: Least pixels of a range of a launch.
_LEAST_PIXELS = 1024


@wp.func
def pixel_direction(
    u: wp.float32, v: wp.float32, fx: wp.float32, fy: wp.float32, cx: wp.float32, cy: wp.float32
) -> wp.vec3f:
    """Direction of pixel (u, v) in the optical frame, scaled to z = 1, so that a ray's t is the depth."""
    return wp.vec3f((u - cx) / fx, (v - cy) / fy, 1.0)


@wp.func
def grain(point: wp.vec3f) -> wp.float32:
    """Brightness factor of a surface point (metres): one pseudo-random value for each small cube of space."""
    i = wp.int32(wp.floor(point[0] / _GRAIN_SIZE))
    j = wp.int32(wp.floor(point[1] / _GRAIN_SIZE))
    k = wp.int32(wp.floor(point[2] / _GRAIN_SIZE))
    # Teschner et al. 2003, Optimized spatial hashing: three large primes, here followed by one more mix.
    mixed = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791)
    mixed = (mixed ^ (mixed >> 13)) * 1274126177
    share = wp.float32((mixed >> 16) & 255) / 255.0
    return 1.0 + _GRAIN_CONTRAST * (2.0 * share - 1.0)


@wp.func
def shaded(albedo: wp.vec3ub, normal: wp.vec3f, direction: wp.vec3f, brightness: wp.float32) -> wp.vec3ub:
    """Colour of a surface under light from the camera and from above.

    `normal` is a unit vector of either sign, `direction` the ray's, both in the world; z is up. Both sides
    of a face look alike.
    """
    facing = wp.dot(normal, wp.normalize(direction))
    upward = wp.where(facing > 0.0, -normal[2], normal[2])
    light = brightness * (_AMBIENT + _HEADLIGHT * wp.abs(facing) + _SKYLIGHT * (0.5 + 0.5 * upward))
    return wp.vec3ub(
        wp.uint8(wp.min(wp.float32(albedo[0]) * light + 0.5, 255.0)),
        wp.uint8(wp.min(wp.float32(albedo[1]) * light + 0.5, 255.0)),
        wp.uint8(wp.min(wp.float32(albedo[2]) * light + 0.5, 255.0)),
    )


@wp.kernel(module=RENDER)
def _render_kernel(
    # In:
    start: wp.int32,
    mesh: wp.uint64,
    face_colors: wp.array(dtype=wp.vec3ub),
    T_world_camera: wp.transformf,
    focal: wp.vec2f,
    center: wp.vec2f,
    max_depth: wp.float32,
    # Out:
    depth: wp.array2d(dtype=wp.float32),
    colors: wp.array2d(dtype=wp.vec3ub),
):
    task = start + wp.tid()
    row = task // depth.shape[1]
    column = task % depth.shape[1]
    origin = wp.transform_get_translation(T_world_camera)
    pixel = pixel_direction(wp.float32(column), wp.float32(row), focal[0], focal[1], center[0], center[1])
    direction = wp.transform_vector(T_world_camera, pixel)
    hit = wp.mesh_query_ray(mesh, origin, direction, max_depth)
    depth[row, column] = wp.where(hit.result, hit.t, NO_DEPTH)
    if colors:
        color = wp.vec3ub()
        if hit.result:
            point = origin + hit.t * direction
            inset = wp.where(wp.dot(hit.normal, direction) > 0.0, _GRAIN_INSET, -_GRAIN_INSET)
            color = shaded(face_colors[hit.face], hit.normal, direction, grain(point + inset * hit.normal))
        colors[row, column] = color


def render_mesh(
    mesh: wp.Mesh,
    face_colors: wp.array | None,
    T_world_camera: wp.transformf,
    width: int,
    height: int,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    max_depth: float,
    *,
    out_depth: wp.array | None = None,
    out_colors: wp.array | None = None,
    threads: int = 1,
) -> tuple[wp.array, wp.array | None]:
    """Renders `mesh` as a pinhole camera sees it; runs on the mesh's device and stream, without a sync.

    Args:
        mesh: the surface, metres, world frame, z up; both sides of a face are seen.
        face_colors: (F,) vec3ub RGB, one a triangle; None renders depth alone.
        T_world_camera: the camera's pose, optical frame (x right, y down, z forward).
        width, height: image size, pixels.
        fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels; (0, 0) is the centre of the first pixel.
        max_depth: surfaces beyond it are not seen, metres along the optical axis.
        out_depth: (height, width) float32 to write into; allocated if None.
        out_colors: (height, width) vec3ub to write into; allocated if None and there are face colours.
        threads: on a CPU.

    Returns:
        depth: (height, width) float32, metres along the optical axis; 0 where the ray hits nothing.
        colors: (height, width) vec3ub RGB, black where the ray hits nothing; None without face colours.

    Raises:
        TypeError: an array has the wrong dtype.
        ValueError: an array has the wrong shape or device, or a number is out of range.
    """
    if width < 1 or height < 1:
        raise ValueError(f"image size must be positive, got {width}x{height}")
    if not (math.isfinite(max_depth) and max_depth > 0.0):
        raise ValueError(f"max_depth must be positive and finite, got {max_depth}")
    if not (fx > 0.0 and fy > 0.0):
        raise ValueError(f"focal lengths must be positive, got fx={fx}, fy={fy}")
    if face_colors is None and out_colors is not None:
        raise ValueError("out_colors needs face_colors")
    device = mesh.device
    image = (height, width)
    if face_colors is not None:
        check_array("face_colors", face_colors, wp.vec3ub, (mesh.indices.size // 3,), device)
        if out_colors is None:
            out_colors = wp.empty(image, dtype=wp.vec3ub, device=device)
        check_array("out_colors", out_colors, wp.vec3ub, image, device)
    if out_depth is None:
        out_depth = wp.empty(image, dtype=wp.float32, device=device)
    check_array("out_depth", out_depth, wp.float32, image, device)
    launch_ranges(
        _render_kernel,
        width * height,
        inputs=[mesh.id, face_colors, T_world_camera, wp.vec2f(fx, fy), wp.vec2f(cx, cy), max_depth],
        outputs=[out_depth, out_colors],
        device=device,
        threads=threads,
        grain=_LEAST_PIXELS,
    )
    return out_depth, out_colors
