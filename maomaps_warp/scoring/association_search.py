"""Association with one thread for each element: on CUDA, with the mesh caster, and as the reference of the packets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.chunks import slices
from maomaps_warp.mapping.distance_field import VoxelField
from maomaps_warp.protocol import PoseChoice

if TYPE_CHECKING:
    from maomaps_warp.mapping.surface import SurfaceMesh
    from maomaps_warp.scoring.association import ViewRules

#: Elements of one kernel launch: long enough to hide its cost, short enough to report progress.
_CHUNK_POINTS = 1 << 12
#: Entries of one launch's (element, pose) table; bounds memory.
_CHUNK_PAIRS = 1 << 22


class Found(NamedTuple):
    """Correspondences, ascending in (element, pose): (M,) int32 each."""

    element: NDArray[np.int32]
    pose: NDArray[np.int32]
    est_voxel: NDArray[np.int32]
    gt_voxel: NDArray[np.int32]


class ElementSearch:
    """The arrays of one association on the device, and its launches chunk by chunk."""

    def __init__(
        self,
        elements: NDArray[np.float64],
        est: SurfaceMesh | VoxelField,
        gt: SurfaceMesh | VoxelField,
        T_est: NDArray[np.float64],
        T_gt: NDArray[np.float64],
        rules: ViewRules,
    ) -> None:
        import warp as wp

        grid = est.voxels.grid
        self.rules = rules
        self.est, self.gt = (s.field if isinstance(s, VoxelField) else s.surface for s in (est, gt))
        self.points = wp.array((elements - grid.origin).astype(np.float32), dtype=wp.vec3, device=est.device)
        self.poses = pose_pairs(grid.origin, T_est, T_gt, est.device)
        self.order = wp.array(_order(len(T_est), rules.pose_choice), dtype=wp.int32, device=est.device)
        self.view = view_of(rules)

    def chunks(self) -> list[slice]:
        """Elements of one launch each."""
        size = _CHUNK_POINTS
        if self.rules.pose_choice == "all":
            size = max(1, min(size, _CHUNK_PAIRS // max(1, len(self.order))))
        return slices(len(self.points), size)

    def run(self, rows: slice) -> tuple[NDArray[np.int32], Found]:
        """Best status (n,) of the elements in `rows`, and their correspondences."""
        return self._every_pose(rows) if self.rules.pose_choice == "all" else self._one_pose(rows)

    def _one_pose(self, rows: slice) -> tuple[NDArray[np.int32], Found]:
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
        return status, found_of(rows.start, pose, est_voxel, gt_voxel)

    def _every_pose(self, rows: slice) -> tuple[NDArray[np.int32], Found]:
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
        found = Found(element, pose.astype(np.int32), est_voxel[point, pose], gt_voxel[point, pose])
        return status.max(axis=1, initial=0), found


def found_of(first: int, pose: NDArray[np.int32], est_voxel: NDArray[np.int32], gt_voxel: NDArray[np.int32]) -> Found:
    """The correspondences of elements `first`, `first` + 1, ... with one pose each, (n,) each; -1: none."""
    hit = np.flatnonzero(gt_voxel >= 0)
    return Found((first + hit).astype(np.int32), pose[hit], est_voxel[hit], gt_voxel[hit])


def pose_pairs(origin: NDArray[np.float64], T_est: NDArray[np.float64], T_gt: NDArray[np.float64], device: str) -> Any:
    """Matched poses, (P, 4, 4) float64 each, as kernels take them: relative to `origin`, subtracted in float64."""
    import warp as wp

    from maomaps_warp.kernels.association_types import PosePairs

    poses = PosePairs()
    for side, T in (("est", T_est), ("gt", T_gt)):
        rotation = np.ascontiguousarray(T[:, :3, :3], dtype=np.float32)
        position = (T[:, :3, 3] - origin).astype(np.float32)
        setattr(poses, f"{side}_rotation", wp.array(rotation, dtype=wp.mat33, device=device))
        setattr(poses, f"{side}_position", wp.array(position, dtype=wp.vec3, device=device))
    return poses


def view_of(rules: ViewRules) -> Any:
    """The view as kernels take it."""
    from maomaps_warp.kernels.association_types import View

    view = View()
    view.x_min, view.x_max, view.y_min, view.y_max = rules.camera.tangent_bounds
    view.near, view.max_range, view.two_sided = rules.near, rules.max_range, rules.two_sided
    return view


def _order(poses: int, choice: PoseChoice) -> NDArray[np.int32]:
    """The order in which poses are tried. For the nearest a fixed random one: it casts fewest rays."""
    if choice == "nearest":
        return np.random.default_rng(0).permutation(poses).astype(np.int32)
    order = np.arange(poses, dtype=np.int32)
    return order[::-1].copy() if choice == "last" else order
