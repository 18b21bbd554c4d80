"""The surface mesh of a voxel map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from maomaps_warp.model.voxels import VoxelMap


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """Exposed faces of the occupied voxels, ready for rays.

    Attributes:
        voxels: the map it was built from; hits are positions in it.
        mesh: wp.Mesh of the faces, metres relative to `voxels.grid.origin`; two triangles a face.
        surface: kernels.surface.Surface, what kernels take.
        faces: number of square faces.
        device: Warp device.
    """

    voxels: VoxelMap
    mesh: Any
    surface: Any
    faces: int
    device: str


def build_surface(voxels: VoxelMap, device: str = "cpu") -> SurfaceMesh:
    """Build the surface of a map.

    Raises:
        ValueError: the map is empty.
    """
    import warp as wp

    from maomaps_warp.kernels import surface as kernels
    from maomaps_warp.kernels.voxel_hash import build_voxel_index

    if not len(voxels):
        raise ValueError("a surface needs at least one voxel")
    grid = voxels.grid
    ijk = wp.array(voxels.ijk, dtype=wp.vec3i, device=device)
    keys, values = build_voxel_index(ijk)
    face_counts = kernels.count_faces(ijk, keys)
    first_face = wp.empty_like(face_counts)
    wp.utils.array_scan(face_counts, first_face, inclusive=False)
    faces = int(face_counts.numpy().sum(dtype=np.int64))
    vertices = wp.empty(4 * faces, dtype=wp.vec3, device=device)
    indices = wp.empty(6 * faces, dtype=wp.int32, device=device)
    face_voxel = wp.empty(2 * faces, dtype=wp.int32, device=device)
    kernels.write_faces(
        ijk,
        keys,
        first_face,
        grid.voxel_size,
        grid.center_offset,
        out_vertices=vertices,
        out_indices=indices,
        out_face_voxel=face_voxel,
    )
    mesh = wp.Mesh(points=vertices, indices=indices)

    surface = kernels.Surface()
    surface.mesh = mesh.id
    surface.face_voxel = face_voxel
    surface.centers = wp.array(
        ((voxels.ijk + grid.center_offset) * grid.voxel_size).astype(np.float32), dtype=wp.vec3, device=device
    )
    surface.keys, surface.values = keys, values
    surface.inv_voxel_size, surface.center_offset = 1.0 / grid.voxel_size, grid.center_offset
    return SurfaceMesh(voxels, mesh, surface, faces, device)
