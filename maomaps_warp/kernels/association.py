"""Association along transferred camera rays: what each predicted voxel should have been.

Paper, section III-C: a predicted point that the camera sees from its estimated pose is matched with what the camera
should have seen along the same camera-frame direction from its ground-truth pose.
"""

from __future__ import annotations

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.surface import Surface, first_surface

wp.set_module_options({"enable_backward": False})

NO_POSE = wp.constant(wp.int32(-1))
# What became of a (voxel, pose) pair; a voxel keeps the largest of its pairs.
OUT_OF_VIEW = wp.constant(wp.int32(0))
OCCLUDED = wp.constant(wp.int32(1))
VISIBLE = wp.constant(wp.int32(2))

FAR = wp.constant(wp.float32(1.0e6))  # metres; beyond every map that fits into the packed keys


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
def transferred_hit(surface: Surface, T_map_camera: wp.transformf, direction: wp.vec3) -> wp.int32:
    """First voxel that a camera at `T_map_camera` sees along a camera-frame unit `direction`, or -1."""
    origin = wp.transform_get_translation(T_map_camera)
    return first_surface(surface, origin, wp.transform_vector(T_map_camera, direction), FAR)


@wp.func
def visible_surface(
    est: Surface, T_map_est: wp.transformf, point: wp.vec3, p_camera: wp.vec3, tolerance: wp.float32
) -> wp.int32:
    """First predicted voxel on the ray to `point`, if it lies nearer to it than `tolerance`; else -1."""
    # The ray starts from camera coordinates, as the transferred one does: with equal poses and maps both rays are
    # the same bits, and a map scored against itself gives exactly zero.
    hit = transferred_hit(est, T_map_est, wp.normalize(p_camera))
    if hit >= 0:
        if wp.length(est.centers[hit] - point) >= tolerance:
            hit = int(-1)
    return hit


@wp.kernel
def _associate_kernel(
    # In:
    points: wp.array(dtype=wp.vec3),
    group_of: wp.array(dtype=wp.int32),
    order: wp.array2d(dtype=wp.int32),
    at_least: wp.array2d(dtype=wp.float32),
    poses: PosePairs,
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
    group = group_of[i]
    status = OUT_OF_VIEW
    best = wp.float32(wp.inf)
    best_pose = NO_POSE
    best_voxel = int(-1)
    rank = int(0)
    while rank < order.shape[1]:
        pose = order[group, rank]
        # at_least ascends: no later pose can be nearer. (Ties are looked at: the lower pose index wins them.)
        if at_least[group, rank] > best:
            rank = order.shape[1]
        else:
            rank += 1
            p_camera = wp.transform_point(wp.transform_inverse(poses.T_map_est[pose]), point)
            distance = wp.length(p_camera)
            if distance < best or (distance == best and pose < best_pose):
                if in_view(view, p_camera):
                    voxel = visible_surface(est, poses.T_map_est[pose], point, p_camera, tolerance)
                    if voxel < 0:
                        status = wp.max(status, OCCLUDED)
                    else:
                        status = VISIBLE
                        best = distance
                        best_pose = pose
                        best_voxel = voxel
                        if at_least[group, 0] < 0.0:
                            # A negative bound marks an order by time: the first that sees the voxel is the choice.
                            rank = order.shape[1]
    gt_voxel = int(-1)
    if best_pose >= 0:
        p_camera = wp.transform_point(wp.transform_inverse(poses.T_map_est[best_pose]), point)
        gt_voxel = transferred_hit(gt, poses.T_map_gt[best_pose], wp.normalize(p_camera))
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
    p_camera = wp.transform_point(wp.transform_inverse(poses.T_map_est[pose]), point)
    status = OUT_OF_VIEW
    voxel = int(-1)
    gt_voxel = int(-1)
    if in_view(view, p_camera):
        voxel = visible_surface(est, poses.T_map_est[pose], point, p_camera, tolerance)
        if voxel < 0:
            status = OCCLUDED
        else:
            status = VISIBLE
            gt_voxel = transferred_hit(gt, poses.T_map_gt[pose], wp.normalize(p_camera))
    out_status[i, pose] = status
    out_est_voxel[i, pose] = voxel
    out_gt_voxel[i, pose] = gt_voxel


def associate(
    points: wp.array,
    poses: PosePairs,
    view: View,
    est: Surface,
    gt: Surface,
    tolerance: float,
    *,
    group_of: wp.array,
    order: wp.array,
    at_least: wp.array,
    out_status: wp.array,
    out_pose: wp.array,
    out_est_voxel: wp.array,
    out_gt_voxel: wp.array,
) -> None:
    """Choose one pose for each predicted point and transfer its ray.

    Args:
        points: (N,) vec3, predicted points, metres relative to the grid's origin.
        poses: P matched pose pairs.
        view: what an image shows.
        est, gt: surfaces of both maps.
        tolerance: metres; the first predicted voxel on the ray must lie nearer to the point than this.
        group_of: (N,) int32, the row of `order` for each point.
        order: (G, P) int32, poses in the order to try.
        at_least: (G, P) float32, ascending lower bounds of the distance from the poses of `order` to every point of the
            group, metres: the nearest pose wins. All -1: the first pose of `order` that sees the point wins.
        out_status: (N,) int32, OUT_OF_VIEW, OCCLUDED or VISIBLE.
        out_pose: (N,) int32, the chosen pose; -1 if none sees the point.
        out_est_voxel: (N,) int32, first predicted voxel on the ray; -1 if none.
        out_gt_voxel: (N,) int32, first ground-truth voxel on the transferred ray; -1 if none.
    """
    device, n = points.device, len(points)
    check_array("points", points, wp.vec3, (n,), device)
    check_array("group_of", group_of, wp.int32, (n,), device)
    check_array("order", order, wp.int32, (None, len(poses.T_map_est)), device)
    check_array("at_least", at_least, wp.float32, tuple(order.shape), device)
    for name, out in (
        ("out_status", out_status),
        ("out_pose", out_pose),
        ("out_est_voxel", out_est_voxel),
        ("out_gt_voxel", out_gt_voxel),
    ):
        check_array(name, out, wp.int32, (n,), device)
    wp.launch(
        _associate_kernel,
        dim=n,
        inputs=[points, group_of, order, at_least, poses, view, est, gt, tolerance],
        outputs=[out_status, out_pose, out_est_voxel, out_gt_voxel],
        device=device,
    )


def associate_all(
    points: wp.array,
    poses: PosePairs,
    view: View,
    est: Surface,
    gt: Surface,
    tolerance: float,
    *,
    out_status: wp.array,
    out_est_voxel: wp.array,
    out_gt_voxel: wp.array,
) -> None:
    """Transfer the ray of every predicted point from every pose; see `associate`. Outputs are (N, P) int32."""
    device = points.device
    shape = (len(points), len(poses.T_map_est))
    check_array("points", points, wp.vec3, (None,), device)
    for name, out in (
        ("out_status", out_status),
        ("out_est_voxel", out_est_voxel),
        ("out_gt_voxel", out_gt_voxel),
    ):
        check_array(name, out, wp.int32, shape, device)
    wp.launch(
        _associate_all_kernel,
        dim=shape,
        inputs=[points, poses, view, est, gt, tolerance],
        outputs=[out_status, out_est_voxel, out_gt_voxel],
        device=device,
    )
