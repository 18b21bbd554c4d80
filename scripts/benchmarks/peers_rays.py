"""Rays through the exposed faces of voxels: the mesh in NumPy, and Embree through Open3D and through embreex."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
#: Casts rays (origins, directions) and returns the triangle that each hits, -1 or 2^32 - 1 where none.
Cast = Callable[[F32, F32], NDArray[np.integer]]


@dataclass(frozen=True, eq=False)
class VoxelMesh:
    """Exposed faces.

    Attributes:
        vertices: (4 F, 3) float32, metres from the grid's origin.
        triangles: (2 F, 3) uint32.
        voxel: (2 F,) int32, whose face a triangle is.
    """

    vertices: F32
    triangles: NDArray[np.uint32]
    voxel: NDArray[np.int32]


def voxel_mesh(ijk: NDArray[np.int32], voxel_size: float) -> VoxelMesh:
    """Two triangles for each face of a voxel (centred on ijk * voxel_size) that no other voxel covers."""
    low = np.array([column.min() for column in ijk.T]) - 1
    cells = ijk - low
    occupied = np.zeros([int(column.max()) + 2 for column in cells.T], dtype=bool)
    occupied[tuple(cells.T)] = True
    corners, voxels = [], []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for side in (-1, 1):
            neighbour = cells.copy()
            neighbour[:, axis] += side
            exposed = np.flatnonzero(~occupied[tuple(neighbour.T)])
            square = np.repeat(ijk[exposed, None].astype(np.float32), 4, axis=1)
            square[:, :, axis] += 0.5 * side
            square[:, :, a] += np.array([-0.5, 0.5, 0.5, -0.5], dtype=np.float32)
            square[:, :, b] += np.array([-0.5, -0.5, 0.5, 0.5], dtype=np.float32)
            corners.append(square)
            voxels.append(exposed.astype(np.int32))
    vertices = np.concatenate(corners).reshape(-1, 3) * np.float32(voxel_size)
    first = 4 * np.arange(len(vertices) // 4, dtype=np.uint32)[:, None, None]
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)).reshape(-1, 3)
    return VoxelMesh(vertices, triangles, np.repeat(np.concatenate(voxels), 2))


def open3d_caster(mesh: VoxelMesh, threads: int) -> Cast:
    """Open3D's RaycastingScene, built when this returns."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
    scene.add_triangles(o3d.core.Tensor(mesh.vertices), o3d.core.Tensor(mesh.triangles))

    def cast(origins: F32, directions: F32) -> NDArray[np.integer]:
        rays = o3d.core.Tensor(np.concatenate([origins, directions], axis=1))
        return np.asarray(scene.cast_rays(rays, nthreads=threads)["primitive_ids"].numpy())

    cast(*_one_ray())
    return cast


def embreex_caster(mesh: VoxelMesh, threads: int) -> Cast:
    """Embree through embreex, built when this returns; it casts on one thread."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, mesh.vertices, mesh.triangles.astype(np.int32))

    def cast(origins: F32, directions: F32) -> NDArray[np.integer]:
        return np.asarray(scene.run(origins, directions))

    cast(*_one_ray())
    return cast


def _one_ray() -> tuple[F32, F32]:
    # Embree builds its tree when the first ray is cast.
    return np.zeros((1, 3), dtype=np.float32), np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
