"""A camera's pixels: the rays through them, and what is written where one meets a triangle."""

import math

import warp as wp

#: Depth of a pixel whose ray hits nothing, metres: depth images say "missing" so (elsewhere it is inf).
NO_DEPTH = wp.constant(wp.float32(0.0))
#: Part of such a pixel.
NO_PART = wp.constant(-1)


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
def search_depth(view: View) -> wp.float32:
    """How far faces are looked for; `is_seen` decides."""
    return view.max_depth * 1.00001


@wp.func
def is_seen(view: View, t: wp.float32) -> wp.bool:
    """Whether what `surface_at` finds lies ahead and near enough; whoever looked for the face rounded otherwise."""
    return t > 0.0 and t < view.max_depth


@wp.func
def surface_at(a: wp.vec3, b: wp.vec3, c: wp.vec3, origin: wp.vec3, direction: wp.vec3):
    """Where a ray meets a triangle that it is known to meet.

    Returns:
        t, barycentric coordinates u and v of the corners a and b, unit normal (a, b, c counter-clockwise).
    """
    ab = b - a
    ac = c - a
    to_a = a - origin
    normal = wp.cross(ab, ac)
    square = wp.dot(normal, normal)
    t = wp.dot(normal, to_a) / wp.dot(normal, direction)
    # From where it is met, not from the ray: the products of far corners would drown a small triangle in rounding.
    p = t * direction - to_a
    v = wp.dot(wp.cross(p, ac), normal) / square
    w = wp.dot(wp.cross(ab, p), normal) / square
    return t, 1.0 - v - w, v, normal / wp.sqrt(square)


@wp.func
def write_surface(
    view: View,
    pixel: wp.int32,
    face: wp.int32,
    t: wp.float32,
    normal: wp.vec3,
    direction: wp.vec3,
    face_part: wp.array(dtype=wp.int32),
    # Out, or empty:
    depth: wp.array(dtype=wp.float32),
    normals: wp.array(dtype=wp.vec3),
    parts: wp.array(dtype=wp.int32),
):
    """What is seen along the ray through a pixel's centre; `face` -1: nothing."""
    depth[pixel] = wp.where(face >= 0, t, NO_DEPTH)
    if normals.shape[0] > 0:
        seen = wp.vec3(0.0, 0.0, 0.0)
        if face >= 0:
            # Towards the camera, in the optical frame.
            facing = wp.where(wp.dot(normal, direction) > 0.0, -1.0, 1.0)
            seen = wp.quat_rotate_inv(wp.transform_get_rotation(view.T_world_camera), facing * normal)
        normals[pixel] = seen
    if parts.shape[0] > 0:
        part = wp.int32(NO_PART)
        if face >= 0:
            part = face_part[face]
        parts[pixel] = part


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
