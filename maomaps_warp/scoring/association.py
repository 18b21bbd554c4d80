"""AME by association: predicted elements, the poses that see them, and what lies on the transferred rays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.chunks import each_in_order
from maomaps_warp.mapping.distance_field import VoxelField
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.correspondences import Correspondences, ElementClass
from maomaps_warp.protocol import PoseChoice
from maomaps_warp.scoring.association_packets import PacketSearch
from maomaps_warp.scoring.association_search import ElementSearch, Found
from maomaps_warp.threads import side_by_side

if TYPE_CHECKING:
    from maomaps_warp.mapping.surface import SurfaceMesh


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
    est: SurfaceMesh | VoxelField,
    gt: SurfaceMesh | VoxelField,
    T_world_camera_est: NDArray[np.float64],
    T_world_camera_gt: NDArray[np.float64],
    rules: ViewRules,
    *,
    first_surface_is_estimate: bool = True,
    packets: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Correspondences:
    """Associate every predicted element with the ground truth along the transferred ray.

    For an element c and a pose pair that sees it, the direction q = T_est^-1 c is shot from the ground-truth pose;
    the first ground-truth voxel on that ray is the match (paper, section III-C, with R_gt R_est^-1).

    Args:
        elements: (N, 3) float64, metres, aligned world.
        est, gt: both maps for rays, of one kind, on one grid and one device.
        T_world_camera_est: (P, 4, 4) float64, aligned poses.
        T_world_camera_gt: (P, 4, 4) float64, the matched ground-truth poses.
        rules: visibility and choice of the pose.
        first_surface_is_estimate: the estimate's side of a correspondence is the first predicted voxel on the ray
            (what the camera sees); False: the element itself, as the paper prints it.
        packets: take sixteen elements at a time where both maps are distance fields on a CPU. The answer is the same
            without, to the last bit.
        progress: called with (elements done, elements in all).
    """
    if not np.array_equal(est.voxels.grid.origin_ijk, gt.voxels.grid.origin_ijk) or est.device != gt.device:
        raise ValueError("both maps must share one grid origin and one device")
    if isinstance(est, VoxelField) != isinstance(gt, VoxelField):
        raise ValueError("both maps must be of one kind: surface meshes or distance fields")
    poses = (T_world_camera_est, T_world_camera_gt)
    search: PacketSearch | ElementSearch
    if isinstance(est, VoxelField) and isinstance(gt, VoxelField) and est.device == "cpu" and packets:
        search = PacketSearch(elements, est, gt, *poses, rules)
    else:
        search = ElementSearch(elements, est, gt, *poses, rules)
    statuses: list[NDArray[np.int32]] = []
    found: list[Found] = []
    chunks = search.chunks()
    for rows, (status, pairs) in zip(chunks, each_in_order(search.run, chunks, est.device), strict=True):
        statuses.append(status)
        found.append(pairs)
        if progress is not None:
            progress(rows.stop, len(elements))
    pairs = _joined(found, est.device)
    return Correspondences(
        elements=elements,
        classes=_classes(statuses, pairs.element),
        element=pairs.element,
        pose=pairs.pose,
        est_points=est.voxels.points if first_surface_is_estimate else elements,
        est_index=pairs.est_voxel if first_surface_is_estimate else pairs.element,
        gt_points=gt.voxels.points,
        gt_index=pairs.gt_voxel,
    )


def _joined(found: list[Found], device: str) -> Found:
    none = np.empty(0, dtype=np.int32)
    # Side by side, because `all` finds some hundred megabytes.
    columns = ([none, *(getattr(f, name) for f in found)] for name in Found._fields)
    return Found(*side_by_side(*(partial(np.concatenate, column) for column in columns), device=device))


def _classes(statuses: list[NDArray[np.int32]], associated: NDArray[np.int32]) -> NDArray[np.uint8]:
    """The class of each element from its best status over the poses, and which have a correspondence."""
    from maomaps_warp.kernels.association_types import OCCLUDED, OUT_OF_VIEW, VISIBLE

    class_of = np.empty(3, dtype=np.uint8)
    class_of[[int(OUT_OF_VIEW), int(OCCLUDED), int(VISIBLE)]] = (
        ElementClass.OUT_OF_VIEW,
        ElementClass.OCCLUDED,
        ElementClass.NO_GROUND_TRUTH,
    )
    classes: NDArray[np.uint8] = class_of[np.concatenate([np.empty(0, dtype=np.int32), *statuses])]
    classes[associated] = ElementClass.ASSOCIATED
    return classes
