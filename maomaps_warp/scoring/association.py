"""AME by association: predicted elements, the poses that see them, and what lies on the transferred rays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.camera import Camera
from maomaps_warp.model.correspondences import Correspondences, ElementClass

if TYPE_CHECKING:
    from maomaps_warp.mapping.surface import SurfaceMesh

PoseChoice = Literal["nearest", "first", "last", "all"]

#: Elements of one kernel launch: long enough to hide its cost, short enough to report progress.
_CHUNK_POINTS = 1 << 15
#: Entries of one launch's pose lists, or of its (element, pose) table; bounds memory.
_CHUNK_PAIRS = 1 << 22
#: Elements are grouped by cubes of this many voxels; a group shares one list of poses sorted by distance.
_GROUP_VOXELS = 8
#: Slack of a group's distance bound over float32 rounding, metres.
_BOUND_SLACK = 1e-3


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
    launch = _Launch(elements, est, gt, T_world_camera_est, T_world_camera_gt, rules)
    classes = np.empty(len(elements), dtype=np.uint8)
    parts: list[tuple[NDArray[np.int32], ...]] = []
    done = 0
    chunks = launch.every_pose() if rules.pose_choice == "all" else launch.one_pose()
    for rows, status, pairs in chunks:
        seen, occluded = status == 2, status == 1
        with_gt = np.isin(rows, pairs[0])
        classes[rows] = np.select(
            [with_gt, seen, occluded],
            [ElementClass.ASSOCIATED, ElementClass.NO_GROUND_TRUTH, ElementClass.OCCLUDED],
            ElementClass.OUT_OF_VIEW,
        )
        parts.append(pairs)
        done += len(rows)
        if progress is not None:
            progress(done, len(elements))
    element, pose, est_voxel, gt_voxel = _joined(parts)
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


def _joined(parts: list[tuple[NDArray[np.int32], ...]]) -> list[NDArray[np.int32]]:
    """Correspondences of all chunks in the order of (element, pose)."""
    columns = [np.concatenate([part[c] for part in parts] or [np.empty(0, np.int32)]) for c in range(4)]
    order = np.lexsort((columns[1], columns[0]))
    return [column[order] for column in columns]


class _Launch:
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
        self.device, self.rules = est.device, rules
        self.est, self.gt = est.surface, gt.surface
        self.points = (elements - grid.origin).astype(np.float32)
        self.positions = (T_est[:, :3, 3] - grid.origin).astype(np.float32)
        self.group_size = _GROUP_VOXELS * grid.voxel_size
        self.poses = PosePairs()
        self.poses.T_map_est = wp.array(
            transforms_relative_to(grid.origin, T_est), dtype=wp.transformf, device=self.device
        )
        self.poses.T_map_gt = wp.array(
            transforms_relative_to(grid.origin, T_gt), dtype=wp.transformf, device=self.device
        )
        self.view = View()
        bounds = rules.camera.tangent_bounds
        self.view.x_min, self.view.x_max, self.view.y_min, self.view.y_max = bounds
        self.view.near, self.view.max_range = rules.near, rules.max_range
        self.view.two_sided = rules.two_sided

    def one_pose(
        self,
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int32], tuple[NDArray[np.int32], ...]]]:
        """Chunks of (elements, their status, correspondences) for nearest, first and last."""
        import warp as wp

        from maomaps_warp.kernels.association import associate

        for rows, group_of, order, at_least in self._pose_orders():
            outs = [wp.empty(len(rows), dtype=wp.int32, device=self.device) for _ in range(4)]
            associate(
                wp.array(self.points[rows], dtype=wp.vec3, device=self.device),
                self.poses,
                self.view,
                self.est,
                self.gt,
                self.rules.occlusion_tolerance,
                group_of=wp.array(group_of, dtype=wp.int32, device=self.device),
                order=wp.array(order, dtype=wp.int32, device=self.device),
                at_least=wp.array(at_least, dtype=wp.float32, device=self.device),
                out_status=outs[0],
                out_pose=outs[1],
                out_est_voxel=outs[2],
                out_gt_voxel=outs[3],
            )
            status, pose, est_voxel, gt_voxel = (out.numpy() for out in outs)
            hit = gt_voxel >= 0
            yield rows, status, (rows[hit].astype(np.int32), pose[hit], est_voxel[hit], gt_voxel[hit])

    def every_pose(
        self,
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int32], tuple[NDArray[np.int32], ...]]]:
        """Chunks of (elements, their best status, correspondences) for all."""
        import warp as wp

        from maomaps_warp.kernels.association import associate_all

        poses = len(self.positions)
        chunk = max(1, min(_CHUNK_POINTS, _CHUNK_PAIRS // max(1, poses)))
        for start in range(0, len(self.points), chunk):
            rows = np.arange(start, min(start + chunk, len(self.points)))
            outs = [wp.empty((len(rows), poses), dtype=wp.int32, device=self.device) for _ in range(3)]
            associate_all(
                wp.array(self.points[rows], dtype=wp.vec3, device=self.device),
                self.poses,
                self.view,
                self.est,
                self.gt,
                self.rules.occlusion_tolerance,
                out_status=outs[0],
                out_est_voxel=outs[1],
                out_gt_voxel=outs[2],
            )
            status, est_voxel, gt_voxel = (out.numpy() for out in outs)
            point, pose = np.nonzero(gt_voxel >= 0)
            pairs = (rows[point].astype(np.int32), pose.astype(np.int32))
            yield rows, status.max(axis=1), (*pairs, est_voxel[point, pose], gt_voxel[point, pose])

    def _pose_orders(self) -> Iterator[tuple[NDArray[np.int64], Any, Any, Any]]:
        """Chunks of (elements, group of each, pose order of each group, lower bounds of the distances)."""
        poses = len(self.positions)
        if self.rules.pose_choice != "nearest":
            order = np.arange(poses, dtype=np.int32)[None]
            if self.rules.pose_choice == "last":
                order = order[:, ::-1].copy()
            for start in range(0, len(self.points), _CHUNK_POINTS):
                rows = np.arange(start, min(start + _CHUNK_POINTS, len(self.points)))
                yield rows, np.zeros(len(rows), np.int32), order, np.full(order.shape, -1.0, np.float32)
            return
        cubes = np.floor(self.points / self.group_size).astype(np.int64)
        unique, group = np.unique(cubes, axis=0, return_inverse=True)
        by_group = np.argsort(group.reshape(-1), kind="stable")
        sorted_group = group.reshape(-1)[by_group]
        centers = (unique + 0.5) * self.group_size
        radius = 0.5 * np.sqrt(3.0) * self.group_size + _BOUND_SLACK
        groups_per_chunk = max(1, min(_CHUNK_PAIRS // max(1, poses), len(unique)))
        start = 0
        while start < len(by_group):
            first = sorted_group[start]
            stop = min(int(np.searchsorted(sorted_group, first + groups_per_chunk)), start + _CHUNK_POINTS)
            rows = by_group[start:stop]
            local = sorted_group[start:stop] - first
            here = centers[first : first + local[-1] + 1]
            distance = np.linalg.norm(here[:, None] - self.positions[None], axis=2)
            ranks = np.argsort(distance, axis=1, kind="stable")
            bound = np.maximum(np.take_along_axis(distance, ranks, axis=1) - radius, 0.0)
            yield rows, local.astype(np.int32), ranks.astype(np.int32), bound.astype(np.float32)
            start = stop
