"""When a camera sees a point: the geometry that decides an association, shared by all its kernels."""

import warp as wp

from maomaps_warp.kernels.association_types import View
from maomaps_warp.kernels.lane_logic import flag
from maomaps_warp.kernels.modules import OPTIONS

# No fused multiply-adds: CPU and CUDA, lanes and scalars must agree on the rays that pass an edge.
wp.set_module_options(OPTIONS)

# Metres. Many voxel centres lie exactly a tolerance apart (0.5 m = 10 voxels); rounding must not decide there.
TIE = wp.constant(wp.float32(1.0e-5))
# Square metres: a camera nearer to a point than 1e-6 m stands on it.
ON_THE_POINT = wp.constant(wp.float32(1.0e-12))


@wp.func
def to_camera(rotation: wp.mat33, offset: wp.vec3) -> wp.vec3:
    """Camera coordinates of a point that lies `offset` (map frame) from the camera, metres."""
    return wp.vec3(
        offset[0] * rotation[0, 0] + offset[1] * rotation[1, 0] + offset[2] * rotation[2, 0],
        offset[0] * rotation[0, 1] + offset[1] * rotation[1, 1] + offset[2] * rotation[2, 1],
        offset[0] * rotation[0, 2] + offset[1] * rotation[1, 2] + offset[2] * rotation[2, 2],
    )


@wp.func
def to_map(rotation: wp.mat33, direction: wp.vec3) -> wp.vec3:
    """A camera-frame direction in the map's frame."""
    return wp.vec3(
        direction[0] * rotation[0, 0] + direction[1] * rotation[0, 1] + direction[2] * rotation[0, 2],
        direction[0] * rotation[1, 0] + direction[1] * rotation[1, 1] + direction[2] * rotation[1, 2],
        direction[0] * rotation[2, 0] + direction[1] * rotation[2, 1] + direction[2] * rotation[2, 2],
    )


@wp.func
def square_length(offset: wp.vec3) -> wp.float32:
    """Squared length, the terms added in the order x, y, z."""
    return offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]


@wp.func(inline=True)
def is_in_view(view: View, x: wp.float32, y: wp.float32, z: wp.float32, square_distance: wp.float32) -> wp.int32:
    """`in_view` as 1 or 0."""
    # A point behind the camera is, under the two-sided rule, what its mirror image in front of it is.
    side = wp.where(view.two_sided, wp.where(z < 0.0, -1.0, 1.0), 1.0)
    right = side * x
    down = side * y
    depth = side * z
    # Slopes times depth, not coordinates by depth: no division, and no special case at depth 0.
    return (
        flag(depth > wp.where(view.two_sided, 0.0, view.near))
        & flag(right >= view.x_min * depth)
        & flag(right < view.x_max * depth)
        & flag(down >= view.y_min * depth)
        & flag(down < view.y_max * depth)
        & flag(square_distance <= view.max_range * view.max_range)
    )


@wp.func
def in_view(view: View, p_camera: wp.vec3, square_distance: wp.float32) -> wp.bool:
    """Whether the image shows `p_camera` (metres, optical frame; square metres), were nothing in the way."""
    return is_in_view(view, p_camera[0], p_camera[1], p_camera[2], square_distance) != 0


@wp.func(inline=True)
def is_camera_inside(view: View, x: wp.float32, y: wp.float32, z: wp.float32, inv_voxel_size: wp.float32) -> wp.int32:
    """1 if the camera stands in the predicted voxel (x, y, z) away: it sees that voxel wherever it looks."""
    return (
        flag(not view.two_sided)
        & flag(wp.abs(x) * inv_voxel_size < 0.5)
        & flag(wp.abs(y) * inv_voxel_size < 0.5)
        & flag(wp.abs(z) * inv_voxel_size < 0.5)
    )


@wp.func(inline=True)
def direction_of(p_camera: wp.vec3, square_distance: wp.float32) -> wp.vec3:
    """Direction of `p_camera`, of any length; straight ahead if the camera stands on it."""
    ahead = square_distance <= ON_THE_POINT
    return wp.vec3(
        wp.where(ahead, 0.0, p_camera[0]), wp.where(ahead, 0.0, p_camera[1]), wp.where(ahead, 1.0, p_camera[2])
    )


@wp.func(inline=True)
def is_near(tolerance: wp.float32, x: wp.float32, y: wp.float32, z: wp.float32) -> wp.int32:
    """1 if a surface that lies (x, y, z) from a point is nearer to it than `tolerance` (metres): it is visible."""
    reach = wp.where(tolerance > TIE, tolerance - TIE, 0.0)
    return flag(x * x + y * y + z * z < reach * reach)
