"""The surface mesh of a voxel map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from maomaps_warp.errors import CapacityError
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


#: Faces of a voxel; triangle corners are int32 in Warp.
_MAX_VOXELS = (2**31 - 1) // (6 * 6)


def build_surface(voxels: VoxelMap, device: str = "cpu") -> SurfaceMesh:
    """Build the surface of a map.

    Raises:
        ValueError: the map is empty.
        CapacityError: the map has more faces than a mesh can index.
    """
    import warp as wp

    from maomaps_warp.kernels import surface as kernels

    if not len(voxels):
        raise ValueError("a surface needs at least one voxel")
    if len(voxels) > _MAX_VOXELS:
        raise CapacityError(f"{len(voxels)} voxels may have more faces than a mesh indexes: raise --voxel-size")
    ijk = wp.array(voxels.ijk, dtype=wp.vec3i, device=device)
    mesh, surface = kernels.build_surface(ijk, voxels.grid.voxel_size, voxels.grid.center_offset)
    return SurfaceMesh(voxels, mesh, surface, len(surface.face_voxel) // 2, device)
