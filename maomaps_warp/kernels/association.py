"""Association along transferred camera rays: what each predicted voxel should have been.

Paper, section III-C: a predicted point that the camera sees from its estimated pose is matched with what the camera
should have seen along the same camera-frame direction from its ground-truth pose.

The kernels here take one thread for each element (and pose). They run on every device and on both kinds of map that
rays can be cast into: a `Surface` (mesh) and a `DistanceField`. For a CPU `association_packets` gives the same bits in
a fraction of the time; whatever decides an answer is one function for both, or the same operations in the same order.
"""

from typing import Any

import warp as wp

from maomaps_warp.kernels.association_rules import (
    direction_of,
    in_view,
    is_camera_inside,
    is_near,
    square_length,
    to_camera,
    to_map,
)
from maomaps_warp.kernels.association_types import NO_POSE, OCCLUDED, OUT_OF_VIEW, VISIBLE, PosePairs, View, check_poses
from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.distance_field import DistanceField, check_field
from maomaps_warp.kernels.field_cells import cell_center, ray_origin, voxel_at
from maomaps_warp.kernels.ray_cast import cast_ray
from maomaps_warp.kernels.surface import Surface, check_surface, first_surface

# No fused multiply-adds: CPU and CUDA must agree on the rays that pass an edge.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

FAR = wp.constant(wp.float32(1.0e6))  # metres; beyond every map that fits into the packed keys


@wp.func
def surface_on_ray(surface: Surface, position: wp.vec3, direction: wp.vec3):
    """(voxel or -1, its centre) that a camera at `position` sees along `direction` (any length, map frame)."""
    voxel = first_surface(surface, position, wp.normalize(direction), FAR)
    center = wp.vec3(0.0, 0.0, 0.0)
    if voxel >= 0:
        center = surface.centers[voxel]
    return voxel, center


@wp.func
def surface_on_ray(field: DistanceField, position: wp.vec3, direction: wp.vec3):
    """The same in a distance field."""
    cell = cast_ray(field, ray_origin(field, position), direction)
    voxel = voxel_at(field, cell[0], cell[1], cell[2])
    center = cell_center(field, wp.float32(cell[0]), wp.float32(cell[1]), wp.float32(cell[2]))
    return voxel, center


@wp.func
def look(
    point: wp.vec3,
    rotation: wp.mat33,
    position: wp.vec3,
    view: View,
    est: Any,
    tolerance: wp.float32,
):
    """What the camera of an estimated pose sees of `point`: (status, predicted voxel or -1, camera-frame direction)."""
    offset = point - position
    square_distance = square_length(offset)
    p_camera = to_camera(rotation, offset)
    direction = direction_of(p_camera, square_distance)
    status = int(OUT_OF_VIEW)
    voxel = int(-1)
    inside = is_camera_inside(view, offset[0], offset[1], offset[2], est.inv_voxel_size)
    if in_view(view, p_camera, square_distance) or inside != 0:
        # The ray starts from camera coordinates, as the transferred one does: with equal poses and maps both rays are
        # the same bits, and a map scored against itself gives exactly zero.
        voxel, center = surface_on_ray(est, position, to_map(rotation, direction))
        status = int(VISIBLE)
        gap = center - point
        if voxel < 0 or is_near(tolerance, gap[0], gap[1], gap[2]) == 0:
            status = int(OCCLUDED)
            voxel = int(-1)
    return status, voxel, direction


@wp.kernel
def _associate_kernel(
    # In:
    points: wp.array(dtype=wp.vec3),
    poses: PosePairs,
    order: wp.array(dtype=wp.int32),
    first_wins: wp.bool,
    view: View,
    est: Any,
    gt: Any,
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
        square_distance = square_length(point - poses.est_position[pose])
        # Only a pose that would win casts a ray; of equally near ones the lower index wins, in whatever order.
        if first_wins or square_distance < best or (square_distance == best and pose < best_pose):
            seen, voxel, direction = look(
                point, poses.est_rotation[pose], poses.est_position[pose], view, est, tolerance
            )
            status = wp.max(status, seen)
            if seen == VISIBLE:
                best = square_distance
                best_pose = pose
                best_voxel = voxel
                best_direction = direction
                if first_wins:
                    break
    gt_voxel = int(-1)
    if best_pose >= 0:
        ray = to_map(poses.gt_rotation[best_pose], best_direction)
        gt_voxel, _center = surface_on_ray(gt, poses.gt_position[best_pose], ray)
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
    est: Any,
    gt: Any,
    tolerance: wp.float32,
    # Out:
    out_status: wp.array2d(dtype=wp.int32),
    out_est_voxel: wp.array2d(dtype=wp.int32),
    out_gt_voxel: wp.array2d(dtype=wp.int32),
):
    i, pose = wp.tid()
    status, voxel, direction = look(points[i], poses.est_rotation[pose], poses.est_position[pose], view, est, tolerance)
    gt_voxel = int(-1)
    if status == VISIBLE:
        ray = to_map(poses.gt_rotation[pose], direction)
        gt_voxel, _center = surface_on_ray(gt, poses.gt_position[pose], ray)
    out_status[i, pose] = status
    out_est_voxel[i, pose] = voxel
    out_gt_voxel[i, pose] = gt_voxel


def associate(
    points: wp.array,
    poses: PosePairs,
    order: wp.array,
    first_wins: bool,
    view: View,
    est: "Surface | DistanceField",
    gt: "Surface | DistanceField",
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
        est, gt: both maps, of one kind.
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
    est: "Surface | DistanceField",
    gt: "Surface | DistanceField",
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
    device, shape = points.device, (len(points), len(poses.est_position))
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


def _check_inputs(points: wp.array, poses: PosePairs, est: Any, gt: Any) -> None:
    device = points.device
    check_array("points", points, wp.vec3, (None,), device)
    check_poses(poses, device)
    for name, surface in (("est", est), ("gt", gt)):
        if hasattr(surface, "centers"):
            check_surface(name, surface, device)
        else:
            check_field(name, surface, device)


def _output(name: str, out: wp.array | None, shape: tuple[int, ...], device: Any) -> wp.array:
    if out is None:
        return wp.empty(shape, dtype=wp.int32, device=device)
    check_array(name, out, wp.int32, shape, device)
    return out
