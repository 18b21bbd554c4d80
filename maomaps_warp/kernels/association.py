"""Association along transferred camera rays: what each predicted voxel should have been.

Paper, section III-C: a predicted point that the camera sees from its estimated pose is matched with what the camera
should have seen along the same camera-frame direction from its ground-truth pose.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.surface import Surface, check_surface, first_surface

# No fused multiply-adds: CPU and CUDA must agree on the rays that pass an edge.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NO_POSE = wp.constant(-1)
# What became of an element, by pose or over all of them.
OUT_OF_VIEW = wp.constant(0)
OCCLUDED = wp.constant(1)
VISIBLE = wp.constant(2)

FAR = wp.constant(wp.float32(1.0e6))  # metres; beyond every map that fits into the packed keys
# Metres. Many voxel centres lie exactly a tolerance apart (0.5 m = 10 voxels); rounding must not decide there.
TIE = wp.constant(wp.float32(1.0e-5))


@wp.struct
class View:
    """Which camera-frame points an image shows."""

    x_min: wp.float32  # borders as slopes x/z and y/z
    x_max: wp.float32
    y_min: wp.float32
    y_max: wp.float32
    near: wp.float32  # metres along the optical axis, exclusive
    max_range: wp.float32  # metres, distance to the camera; inf = no limit
    two_sided: wp.bool  # also the mirrored cone behind the camera (the original's defect)


@wp.struct
class PosePairs:
    """Matched poses, metres relative to the grid's origin."""

    T_map_est: wp.array(dtype=wp.transformf)  # (P,) camera to the estimated map
    T_map_gt: wp.array(dtype=wp.transformf)  # (P,) camera to the ground-truth map


@wp.func
def to_camera(T_map_camera: wp.transformf, point: wp.vec3) -> wp.vec3:
    """`point` (map frame) in the camera's frame, metres."""
    # The difference first: transform_inverse would subtract two rotated positions, both large far from the origin.
    offset = point - wp.transform_get_translation(T_map_camera)
    return wp.quat_rotate_inv(wp.transform_get_rotation(T_map_camera), offset)


@wp.func
def in_view(view: View, p_camera: wp.vec3) -> wp.bool:
    """Whether the image shows `p_camera` (metres, optical frame), were nothing in the way."""
    z = p_camera[2]
    in_front = z > view.near
    if view.two_sided:
        in_front = z != 0.0
    seen = False
    if in_front:
        x = p_camera[0] / z
        y = p_camera[1] / z
        seen = (
            x >= view.x_min
            and x < view.x_max
            and y >= view.y_min
            and y < view.y_max
            and wp.length(p_camera) <= view.max_range
        )
    return seen


@wp.func
def camera_inside(est: Surface, view: View, T_map_est: wp.transformf, point: wp.vec3) -> wp.bool:
    """Whether the camera stands in the predicted voxel centred at `point`: it sees that voxel wherever it looks."""
    offset = point - wp.transform_get_translation(T_map_est)
    largest = wp.max(wp.abs(offset[0]), wp.max(wp.abs(offset[1]), wp.abs(offset[2])))
    return not view.two_sided and largest * est.inv_voxel_size < 0.5


@wp.func
def direction_of(p_camera: wp.vec3) -> wp.vec3:
    """Unit vector to `p_camera`; straight ahead if the camera stands on it."""
    distance = wp.length(p_camera)
    direction = wp.vec3(0.0, 0.0, 1.0)
    if distance > 1.0e-6:
        direction = p_camera / distance
    return direction


@wp.func
def ray_hit(surface: Surface, T_map_camera: wp.transformf, direction: wp.vec3) -> wp.int32:
    """First voxel that a camera at `T_map_camera` sees along a camera-frame unit `direction`, or -1."""
    origin = wp.transform_get_translation(T_map_camera)
    return first_surface(surface, origin, wp.transform_vector(T_map_camera, direction), FAR)


@wp.func
def visible_surface(
    est: Surface, T_map_est: wp.transformf, point: wp.vec3, direction: wp.vec3, tolerance: wp.float32
) -> wp.int32:
    """First predicted voxel in the camera-frame unit `direction` of `point`, if it lies within `tolerance`; else -1."""
    # The ray starts from camera coordinates, as the transferred one does: with equal poses and maps both rays are
    # the same bits, and a map scored against itself gives exactly zero.
    hit = ray_hit(est, T_map_est, direction)
    if hit >= 0:
        if wp.length(est.centers[hit] - point) >= tolerance - TIE:
            hit = int(-1)
    return hit


@wp.kernel
def _associate_kernel(
    # In:
    points: wp.array(dtype=wp.vec3),
    poses: PosePairs,
    order: wp.array(dtype=wp.int32),
    first_wins: wp.bool,
    view: View,
    est: Surface,
    gt: Surface,
    tolerance: wp.float32,
    # Out:
    out_status: wp.array(dtype=wp.int32),
    out_pose: wp.array(dtype=wp.int32),
    out_est_voxel: wp.array(dtype=wp.int32),
    out_gt_voxel: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    point = points[i]
    status = int(OUT_OF_VIEW)
    best = wp.float32(wp.inf)
    best_pose = int(NO_POSE)
    best_voxel = int(-1)
    best_direction = wp.vec3(0.0, 0.0, 0.0)
    for rank in range(order.shape[0]):
        pose = order[rank]
        p_camera = to_camera(poses.T_map_est[pose], point)
        distance = wp.length(p_camera)
        # Only a pose that would win casts a ray; of equally near ones the lower index wins, in whatever order.
        if first_wins or distance < best or (distance == best and pose < best_pose):
            if in_view(view, p_camera) or camera_inside(est, view, poses.T_map_est[pose], point):
                direction = direction_of(p_camera)
                voxel = visible_surface(est, poses.T_map_est[pose], point, direction, tolerance)
                if voxel >= 0:
                    status = int(VISIBLE)
                    best = distance
                    best_pose = pose
                    best_voxel = voxel
                    best_direction = direction
                    if first_wins:
                        break
                elif status == OUT_OF_VIEW:
                    status = int(OCCLUDED)
    gt_voxel = int(-1)
    if best_pose >= 0:
        gt_voxel = ray_hit(gt, poses.T_map_gt[best_pose], best_direction)
    out_status[i] = status
    out_pose[i] = best_pose
    out_est_voxel[i] = best_voxel
    out_gt_voxel[i] = gt_voxel


@wp.kernel
def _associate_all_kernel(
    # In:
    points: wp.array(dtype=wp.vec3),
    poses: PosePairs,
    view: View,
    est: Surface,
    gt: Surface,
    tolerance: wp.float32,
    # Out:
    out_status: wp.array2d(dtype=wp.int32),
    out_est_voxel: wp.array2d(dtype=wp.int32),
    out_gt_voxel: wp.array2d(dtype=wp.int32),
):
    i, pose = wp.tid()
    point = points[i]
    p_camera = to_camera(poses.T_map_est[pose], point)
    status = int(OUT_OF_VIEW)
    voxel = int(-1)
    gt_voxel = int(-1)
    if in_view(view, p_camera) or camera_inside(est, view, poses.T_map_est[pose], point):
        direction = direction_of(p_camera)
        voxel = visible_surface(est, poses.T_map_est[pose], point, direction, tolerance)
        if voxel < 0:
            status = int(OCCLUDED)
        else:
            status = int(VISIBLE)
            gt_voxel = ray_hit(gt, poses.T_map_gt[pose], direction)
    out_status[i, pose] = status
    out_est_voxel[i, pose] = voxel
    out_gt_voxel[i, pose] = gt_voxel


def associate(
    points: wp.array,
    poses: PosePairs,
    order: wp.array,
    first_wins: bool,
    view: View,
    est: Surface,
    gt: Surface,
    tolerance: float,
    *,
    out_status: wp.array | None = None,
    out_pose: wp.array | None = None,
    out_est_voxel: wp.array | None = None,
    out_gt_voxel: wp.array | None = None,
) -> tuple[wp.array, wp.array, wp.array, wp.array]:
    """Choose one pose for each predicted point and transfer its ray.

    Args:
        points: (N,) vec3, predicted points, metres relative to the grid's origin.
        poses: P matched pose pairs.
        order: poses in the order to try, int32 indices into `poses`. For the nearest a random order casts fewest
            rays: along a path each pose tends to be nearer than the one before.
        first_wins: the first pose of `order` that sees a point is chosen; else the nearest.
        view: what an image shows.
        est, gt: surfaces of both maps.
        tolerance: metres; the first predicted voxel on the ray must lie nearer to the point than this.
        out_status: (N,) int32, OUT_OF_VIEW, OCCLUDED or VISIBLE. Like the other outputs allocated if None.
        out_pose: (N,) int32, the chosen pose; -1 if none sees the point.
        out_est_voxel: (N,) int32, first predicted voxel on the ray; -1 if none.
        out_gt_voxel: (N,) int32, first ground-truth voxel on the transferred ray; -1 if none.

    Returns:
        The four outputs.
    """
    device, shape = points.device, (len(points),)
    _check_inputs(points, poses, est, gt)
    check_array("order", order, wp.int32, (None,), device)
    names = ("out_status", "out_pose", "out_est_voxel", "out_gt_voxel")
    given = (out_status, out_pose, out_est_voxel, out_gt_voxel)
    outs = tuple(_output(name, out, shape, device) for name, out in zip(names, given, strict=True))
    wp.launch(
        _associate_kernel,
        dim=shape,
        inputs=[points, poses, order, first_wins, view, est, gt, tolerance],
        outputs=list(outs),
        device=device,
    )
    return outs


def associate_all(
    points: wp.array,
    poses: PosePairs,
    view: View,
    est: Surface,
    gt: Surface,
    tolerance: float,
    *,
    out_status: wp.array | None = None,
    out_est_voxel: wp.array | None = None,
    out_gt_voxel: wp.array | None = None,
) -> tuple[wp.array, wp.array, wp.array]:
    """Transfer the ray of every predicted point from every pose; see `associate`.

    Returns:
        out_status, out_est_voxel, out_gt_voxel, each (N, P) int32.
    """
    device, shape = points.device, (len(points), len(poses.T_map_est))
    _check_inputs(points, poses, est, gt)
    names = ("out_status", "out_est_voxel", "out_gt_voxel")
    given = (out_status, out_est_voxel, out_gt_voxel)
    outs = tuple(_output(name, out, shape, device) for name, out in zip(names, given, strict=True))
    wp.launch(
        _associate_all_kernel,
        dim=shape,
        inputs=[points, poses, view, est, gt, tolerance],
        outputs=list(outs),
        device=device,
    )
    return outs


def _check_inputs(points: wp.array, poses: PosePairs, est: Surface, gt: Surface) -> None:
    device = points.device
    check_array("points", points, wp.vec3, (None,), device)
    check_array("poses.T_map_est", poses.T_map_est, wp.transformf, (None,), device)
    check_array("poses.T_map_gt", poses.T_map_gt, wp.transformf, (len(poses.T_map_est),), device)
    check_surface("est", est, device)
    check_surface("gt", gt, device)


def _output(name: str, out: wp.array | None, shape: tuple[int, ...], device: Any) -> wp.array:
    if out is None:
        return wp.empty(shape, dtype=wp.int32, device=device)
    check_array(name, out, wp.int32, shape, device)
    return out
