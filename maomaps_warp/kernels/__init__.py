"""Warp kernels and functions; public, so that other Warp programs embed them.

Each module holds `@wp.struct`s, `@wp.func`s to call from your own kernels, and launchers. Launchers run on the device
of their arrays, check them, take their outputs as `out_*` or allocate them, and never synchronise; `build_surface`
and `build_triangle_tree` alone read a number or two back.

Registering a kernel takes Warp milliseconds, so each file is loaded when a name of it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

#: The public names, by the file that holds them.
_NAMES = {
    "association": ("associate", "associate_all"),
    "association_rules": ("in_view", "to_camera"),
    "association_types": ("PosePairs", "View"),
    "back_projection": ("DepthSampling", "Pinhole", "integrate_depth"),
    "back_projection_exact": (
        "ExactPinhole",
        "ExactSampling",
        "back_project_exact",
        "cell_of_exact",
        "integrate_depth_exact",
    ),
    "distance_field": ("DistanceField",),
    "distance_field_building": ("build_distance_field",),
    "field_cells": ("cell_center", "clearance_at", "ray_origin", "voxel_at"),
    "nearest": ("PointTree", "find_nearest", "nearest_point"),
    "pair_errors": ("Pairs", "pair_errors"),
    "pixels": ("view_from",),
    "ray_cast": ("cast_ray",),
    "ray_packets": ("Packet", "cast_packets"),
    "render": ("Images", "MeshScene", "render_scene"),
    "surface": ("Surface", "build_surface", "cast_rays", "first_surface"),
    "triangle_tree": ("TriangleTree", "build_triangle_tree"),
    "voxel_hash": (
        "VoxelHash",
        "add_sample",
        "build_voxel_index",
        "cell_of",
        "claim_slot",
        "create_voxel_hash",
        "rehash",
    ),
    "voxel_keys": ("find_slot", "pack_key"),
    "voxel_rays": ("cast_voxel_rays",),
}
_HOME = {name: file for file, names in _NAMES.items() for name in names}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'maomaps_warp.kernels' has no attribute {name!r}")
    return getattr(import_module(f"maomaps_warp.kernels.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
