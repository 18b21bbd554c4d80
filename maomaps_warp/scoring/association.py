"""AME by association: predicted elements, the poses that see them, and what lies on the transferred rays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.chunks import each_in_order, slices
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.correspondences import Correspondences, ElementClass
from maomaps_warp.protocol import PoseChoice

if TYPE_CHECKING:
    from maomaps_warp.mapping.surface import SurfaceMesh

#: Elements of one kernel launch: long enough to hide its cost, short enough to report progress.
_CHUNK_POINTS = 1 << 12
#: Entries of one launch's (element, pose) table; bounds memory.
_CHUNK_PAIRS = 1 << 22


@dataclass(frozen=True)
class ViewRules:
    """When a camera sees an element, and which of several poses is chosen.

    Attributes:
        camera: the image; an element outside it is out of view.
        near: metres along the optical axis, exclusive.
        max_range: metres from the camera.
        two_sided: also the mirrored cone behind the camera (a defect of the original).
        occlusion_tolerance: metres from the element within which the first predicted voxel must lie, exclusive.
        pose_choice: nearest, first or last of the poses that see an element, or all of them.
    """

    camera: Camera
    near: float = 0.01
    max_range: float = float("inf")
    two_sided: bool = False
    occlusion_tolerance: float = 0.5
    pose_choice: PoseChoice = "nearest"


def associate_maps(
    elements: NDArray[np.float64],
    est: SurfaceMesh,
    gt: SurfaceMesh,
    T_world_camera_est: NDArray[np.float64],
    T_world_camera_gt: NDArray[np.float64],
    rules: ViewRules,
    *,
    first_surface_is_estimate: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Correspondences:
    """Associate every predicted element with the ground truth along the transferred ray.

    For an element c and a pose pair that sees it, the direction q = T_est^-1 c is shot from the ground-truth pose;
    the first ground-truth voxel on that ray is the match (paper, section III-C, with R_gt R_est^-1).

    Args:
        elements: (N, 3) float64, metres, aligned world.
        est, gt: surfaces of both maps, on one grid and one device.
        T_world_camera_est: (P, 4, 4) float64, aligned poses.
        T_world_camera_gt: (P, 4, 4) float64, the matched ground-truth poses.
        rules: visibility and choice of the pose.
        first_surface_is_estimate: the estimate's side of a correspondence is the first predicted voxel on the ray
            (what the camera sees); False: the element itself, as the paper prints it.
        progress: called with (elements done, elements in all).
    """
    if not np.array_equal(est.voxels.grid.origin_ijk, gt.voxels.grid.origin_ijk) or est.device != gt.device:
        raise ValueError("both surfaces must share one grid origin and one device")
    job = _Job(elements, est, gt, T_world_camera_est, T_world_camera_gt, rules)
    chunk = job.every_pose if rules.pose_choice == "all" else job.one_pose
    classes = np.empty(len(elements), dtype=np.uint8)
    found: list[_Found] = []
    chunks = slices(len(elements), job.chunk_size)
    for rows, (status, pairs) in zip(chunks, each_in_order(chunk, chunks, est.device), strict=True):
        classes[rows] = _classes(status, pairs.element - rows.start)
        found.append(pairs)
        if progress is not None:
            progress(rows.stop, len(elements))
    none = np.empty(0, dtype=np.int32)
    element, pose, est_voxel, gt_voxel = (
        np.concatenate([none, *(getattr(pairs, name) for pairs in found)]) for name in _Found._fields
    )
    return Correspondences(
        elements=elements,
        classes=classes,
        element=element,
        pose=pose,
        est_points=est.voxels.points if first_surface_is_estimate else elements,
        est_index=est_voxel if first_surface_is_estimate else element,
        gt_points=gt.voxels.points,
        gt_index=gt_voxel,
    )


class _Found(NamedTuple):
    """Correspondences of a chunk, ascending in (element, pose): (M,) int32 each."""

    element: NDArray[np.int32]
    pose: NDArray[np.int32]
    est_voxel: NDArray[np.int32]
    gt_voxel: NDArray[np.int32]


def _classes(status: NDArray[np.int32], associated: NDArray[np.int32]) -> NDArray[np.uint8]:
    """The class of each element of a chunk from its best status over the poses, and which have a correspondence."""
    from maomaps_warp.kernels.association import OCCLUDED, VISIBLE

    classes = np.full(len(status), ElementClass.OUT_OF_VIEW, dtype=np.uint8)
    classes[status == OCCLUDED] = ElementClass.OCCLUDED
    classes[status == VISIBLE] = ElementClass.NO_GROUND_TRUTH
    classes[associated] = ElementClass.ASSOCIATED
    return classes


class _Job:
    """The arrays of one association on the device, and its launches chunk by chunk."""

    def __init__(
        self,
        elements: NDArray[np.float64],
        est: SurfaceMesh,
        gt: SurfaceMesh,
        T_est: NDArray[np.float64],
        T_gt: NDArray[np.float64],
        rules: ViewRules,
    ) -> None:
        import warp as wp

        from maomaps_warp.kernels.association import PosePairs, View
        from maomaps_warp.mapping.poses import transforms_relative_to

        grid = est.voxels.grid
        self.rules, self.est, self.gt = rules, est.surface, gt.surface
        self.points = wp.array((elements - grid.origin).astype(np.float32), dtype=wp.vec3, device=est.device)
        self.poses = PosePairs()
        self.poses.T_map_est, self.poses.T_map_gt = (
            wp.array(transforms_relative_to(grid.origin, T), dtype=wp.transformf, device=est.device)
            for T in (T_est, T_gt)
        )
        self.order = wp.array(_order(len(T_est), rules.pose_choice), dtype=wp.int32, device=est.device)
        self.view = View()
        self.view.x_min, self.view.x_max, self.view.y_min, self.view.y_max = rules.camera.tangent_bounds
        self.view.near, self.view.max_range, self.view.two_sided = rules.near, rules.max_range, rules.two_sided
        self.chunk_size = _CHUNK_POINTS
        if rules.pose_choice == "all":
            self.chunk_size = max(1, min(_CHUNK_POINTS, _CHUNK_PAIRS // max(1, len(T_est))))

    def one_pose(self, rows: slice) -> tuple[NDArray[np.int32], _Found]:
        """Status (n,) of the elements in `rows`, and their correspondences: nearest, first or last."""
        from maomaps_warp.kernels.association import associate

        outs = associate(
            self.points[rows],
            self.poses,
            self.order,
            self.rules.pose_choice != "nearest",
            self.view,
            self.est,
            self.gt,
            self.rules.occlusion_tolerance,
        )
        status, pose, est_voxel, gt_voxel = (out.numpy() for out in outs)
        hit = np.flatnonzero(gt_voxel >= 0)
        element = (rows.start + hit).astype(np.int32)
        return status, _Found(element, pose[hit], est_voxel[hit], gt_voxel[hit])

    def every_pose(self, rows: slice) -> tuple[NDArray[np.int32], _Found]:
        """Best status (n,) of the elements in `rows`, and their correspondences with every pose."""
        from maomaps_warp.kernels.association import associate_all

        outs = associate_all(
            self.points[rows],
            self.poses,
            self.view,
            self.est,
            self.gt,
            self.rules.occlusion_tolerance,
        )
        status, est_voxel, gt_voxel = (out.numpy() for out in outs)
        point, pose = np.nonzero(gt_voxel >= 0)
        element = (rows.start + point).astype(np.int32)
        found = _Found(element, pose.astype(np.int32), est_voxel[point, pose], gt_voxel[point, pose])
        return status.max(axis=1, initial=0), found


def _order(poses: int, choice: PoseChoice) -> NDArray[np.int32]:
    """The order in which poses are tried. For the nearest a fixed random one: it casts fewest rays."""
    if choice == "nearest":
        return np.random.default_rng(0).permutation(poses).astype(np.int32)
    order = np.arange(poses, dtype=np.int32)
    return order[::-1].copy() if choice == "last" else order
