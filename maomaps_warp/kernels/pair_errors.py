"""Errors of correspondences in float64: in the world, and between the points in their own cameras' frames."""

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import SCORE
from maomaps_warp.kernels.ranges import launch_ranges


@wp.struct
class Pairs:
    """Correspondences as indices."""

    pose: wp.array(dtype=wp.int32)  # (M,) the pose pair that saw it
    est_index: wp.array(dtype=wp.int32)  # (M,) into est_points
    gt_index: wp.array(dtype=wp.int32)  # (M,) into gt_points
    est_points: wp.array(dtype=wp.vec3d)  # metres, world
    gt_points: wp.array(dtype=wp.vec3d)
    T_world_camera_est: wp.array(dtype=wp.mat44d)  # (P,)
    T_world_camera_gt: wp.array(dtype=wp.mat44d)  # (P,)


@wp.func
def in_camera_exact(T_world_camera: wp.mat44d, point: wp.vec3d) -> wp.vec3d:
    """`point` (world) in the camera's frame, metres."""
    x = point[0] - T_world_camera[0, 3]
    y = point[1] - T_world_camera[1, 3]
    z = point[2] - T_world_camera[2, 3]
    return wp.vec3d(
        T_world_camera[0, 0] * x + T_world_camera[1, 0] * y + T_world_camera[2, 0] * z,
        T_world_camera[0, 1] * x + T_world_camera[1, 1] * y + T_world_camera[2, 1] * z,
        T_world_camera[0, 2] * x + T_world_camera[1, 2] * y + T_world_camera[2, 2] * z,
    )


@wp.kernel(module=SCORE)
def _pair_errors_kernel(
    # In:
    start: wp.int32,
    pairs: Pairs,
    # Out:
    out_absolute: wp.array(dtype=wp.float64),
    out_relative: wp.array(dtype=wp.float64),
):
    i = start + wp.tid()
    pose = pairs.pose[i]
    est = pairs.est_points[pairs.est_index[i]]
    gt = pairs.gt_points[pairs.gt_index[i]]
    out_absolute[i] = wp.length(est - gt)
    est_camera = in_camera_exact(pairs.T_world_camera_est[pose], est)
    gt_camera = in_camera_exact(pairs.T_world_camera_gt[pose], gt)
    out_relative[i] = wp.length(est_camera - gt_camera)


def pair_errors(
    pairs: Pairs, *, out_absolute: wp.array | None = None, out_relative: wp.array | None = None, threads: int = 1
) -> tuple[wp.array, wp.array]:
    """|m* - m| and |T*^-1 m* - T^-1 m| of every correspondence.

    Args:
        pairs: M correspondences.
        out_absolute, out_relative: (M,) float64, metres. None: allocated.
        threads: on a CPU.

    Returns:
        out_absolute and out_relative.
    """
    device, count = pairs.pose.device, len(pairs.pose)
    check_array("pairs.pose", pairs.pose, wp.int32, (None,), device)
    check_array("pairs.est_index", pairs.est_index, wp.int32, (count,), device)
    check_array("pairs.gt_index", pairs.gt_index, wp.int32, (count,), device)
    check_array("pairs.est_points", pairs.est_points, wp.vec3d, (None,), device)
    check_array("pairs.gt_points", pairs.gt_points, wp.vec3d, (None,), device)
    check_array("pairs.T_world_camera_est", pairs.T_world_camera_est, wp.mat44d, (None,), device)
    check_array("pairs.T_world_camera_gt", pairs.T_world_camera_gt, wp.mat44d, (len(pairs.T_world_camera_est),), device)
    if out_absolute is None:
        out_absolute = wp.empty(count, dtype=wp.float64, device=device)
    if out_relative is None:
        out_relative = wp.empty(count, dtype=wp.float64, device=device)
    check_array("out_absolute", out_absolute, wp.float64, (count,), device)
    check_array("out_relative", out_relative, wp.float64, (count,), device)
    launch_ranges(
        _pair_errors_kernel,
        count,
        inputs=[pairs],
        outputs=[out_absolute, out_relative],
        device=device,
        threads=threads,
        grain=1 << 14,
    )
    return out_absolute, out_relative
