"""Warp kernels and functions; public, so that other Warp programs embed them.

Each module holds `@wp.struct`s, `@wp.func`s to call from your own kernels, and launchers. Launchers run on the device
of their arrays, check them, take their outputs as `out_*` or allocate them, and never synchronise; `build_surface`
alone reads two numbers back.
"""

from maomaps_warp.kernels.association import PosePairs, View, associate, associate_all, in_view, to_camera
from maomaps_warp.kernels.back_projection import DepthSampling, Pinhole, back_project, integrate_depth
from maomaps_warp.kernels.back_projection_exact import (
    ExactPinhole,
    ExactSampling,
    back_project_exact,
    cell_of_exact,
    integrate_depth_exact,
)
from maomaps_warp.kernels.nearest import PointTree, find_nearest, nearest_point
from maomaps_warp.kernels.render import render_mesh
from maomaps_warp.kernels.surface import Surface, build_surface, cast_rays, first_surface
from maomaps_warp.kernels.voxel_hash import (
    VoxelHash,
    add_sample,
    build_voxel_index,
    cell_of,
    claim_slot,
    create_voxel_hash,
    find_slot,
    pack_key,
    rehash,
)

__all__ = [
    "DepthSampling",
    "ExactPinhole",
    "ExactSampling",
    "Pinhole",
    "PointTree",
    "PosePairs",
    "Surface",
    "View",
    "VoxelHash",
    "add_sample",
    "associate",
    "associate_all",
    "back_project",
    "back_project_exact",
    "build_surface",
    "build_voxel_index",
    "cast_rays",
    "cell_of",
    "cell_of_exact",
    "claim_slot",
    "create_voxel_hash",
    "find_nearest",
    "find_slot",
    "first_surface",
    "in_view",
    "integrate_depth",
    "integrate_depth_exact",
    "nearest_point",
    "pack_key",
    "rehash",
    "render_mesh",
    "to_camera",
]
