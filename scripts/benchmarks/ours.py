"""What is measured of ours, by the calls that the jobs make; each returns when the device is done."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.flats import Flat
from maomaps_warp.mapping.voxel_map import DepthLimits, build_voxel_map
from maomaps_warp.model.correspondences import Correspondences
from maomaps_warp.model.frame import FrameStream
from maomaps_warp.model.voxels import VoxelMap
from maomaps_warp.protocol import PoseChoice


def map_of_frames(stream: FrameStream, flat: Flat, device: str) -> VoxelMap:
    """The map of frames in memory under the ground truth's poses, colours averaged."""
    poses = flat.gt.T_world_camera
    return build_voxel_map(
        stream,
        lambda frame: poses[frame.index],
        flat.gt_map.grid,
        DepthLimits(),
        colors="truncated",
        device=device,
    ).voxels


def ray_field(voxels: VoxelMap, device: str) -> Any:
    """What rays are cast into by default."""
    from maomaps_warp.mapping.distance_field import build_voxel_field

    field = build_voxel_field(voxels, device)
    finish(device)
    return field


def mesh_surface(voxels: VoxelMap, device: str) -> Any:
    """The same for the plain kernels: faces of the voxels in a wp.Mesh."""
    from maomaps_warp.mapping.surface import build_surface

    surface = build_surface(voxels, device)
    finish(device)
    return surface


def cast(field: Any, origins: Any, directions: Any, threads: int) -> NDArray[np.int32]:
    """First voxel on each ray, -1 for none; rays are Warp arrays on the field's device."""
    from maomaps_warp.kernels.voxel_rays import cast_voxel_rays

    return np.asarray(cast_voxel_rays(field.field, origins, directions, threads=threads).numpy())


def distances(
    queries: NDArray[np.float64], points: NDArray[np.float64], device: str, voxel_size: float | None = None
) -> NDArray[np.float64]:
    """To the nearest point, of each query; `voxel_size` where both clouds lie on one lattice."""
    from maomaps_warp.scoring.nearest import nearest_distances

    return nearest_distances(queries, points, device, voxel_size)


def structures(flat: Flat, device: str, *, plain: bool = False) -> tuple[Any, Any]:
    """What the rays of association are cast into, estimate and ground truth; `plain`: meshes for the plain kernels."""
    if plain:
        return mesh_surface(flat.est_map, device), mesh_surface(flat.gt_map, device)
    from maomaps_warp.mapping.distance_field import build_voxel_fields

    fields = build_voxel_fields(flat.est_map, flat.gt_map, device)
    finish(device)
    return fields


def associate(
    flat: Flat, choice: PoseChoice, both: tuple[Any, Any], elements: NDArray[np.float64] | None = None
) -> Correspondences:
    """Association of the maps of a flat, whose `structures` are given; `elements` (None: all of the estimate's)."""
    from maomaps_warp.scoring.association import ViewRules, associate_maps

    return associate_maps(
        flat.est_map.points if elements is None else elements,
        *both,
        flat.est.T_world_camera,
        flat.gt.T_world_camera,
        ViewRules(flat.camera, pose_choice=choice),
    )


def build_and_associate(flat: Flat, choice: PoseChoice, device: str, *, plain: bool = False) -> Correspondences:
    """The same from maps and poses alone."""
    return associate(flat, choice, structures(flat, device, plain=plain))


def finish(device: str) -> None:
    """Wait for a GPU; a CPU is done when a launch returns."""
    if device != "cpu":
        import warp as wp

        wp.synchronize_device(device)
