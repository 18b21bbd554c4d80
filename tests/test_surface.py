"""The surface mesh and the first surface on a ray."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from oracle import robust_first_voxel
from scenes import VOXEL, cluttered_room

from maomaps_warp.kernels.surface import cast_rays
from maomaps_warp.mapping.cloud_map import voxelise
from maomaps_warp.mapping.surface import build_surface
from maomaps_warp.model.voxels import VoxelGrid

#: Rays whose hit changes when shifted by this much graze an edge: float32 may decide them either way, metres.
GRAZING_BAND = 2e-5


def _map(points, origin=(4, -2, 2), offset=0.0):
    return voxelise(np.asarray(points, dtype=float), VoxelGrid(VOXEL, np.array(origin, dtype=np.int64), offset))


def _as_trimesh(surface):
    return trimesh.Trimesh(surface.mesh.points.numpy(), surface.mesh.indices.numpy().reshape(-1, 3), process=True)


def _cast(surface, origins, directions, device, **options):
    def put(a):
        return wp.array(np.asarray(a, dtype=np.float32), dtype=wp.vec3, device=device)

    return cast_rays(surface.surface, put(origins), put(directions), **options).numpy()


def test_a_single_voxel_is_a_closed_cube_with_its_faces_outwards(device):
    surface = build_surface(_map([[0.5, 0.25, 0.1]]), device)
    cube = _as_trimesh(surface)
    assert surface.faces == 6
    assert cube.is_watertight and cube.is_winding_consistent
    assert cube.volume == pytest.approx(VOXEL**3, rel=1e-4)
    np.testing.assert_allclose(cube.centroid + surface.voxels.grid.origin, [0.5, 0.25, 0.1], rtol=0, atol=1e-6)


def test_faces_between_neighbours_are_left_out(device):
    surface = build_surface(_map(np.argwhere(np.ones((3, 3, 3))) * VOXEL), device)
    assert surface.faces == 6 * 9
    assert _as_trimesh(surface).volume == pytest.approx((3 * VOXEL) ** 3, rel=1e-4)


def test_every_triangle_knows_its_voxel(device):
    surface = build_surface(_map(cluttered_room(0)), device)
    corners = surface.mesh.points.numpy()[surface.mesh.indices.numpy().reshape(-1, 3)]
    voxel = surface.surface.face_voxel.numpy()
    centers = surface.surface.centers.numpy()[voxel]
    reach = np.abs(corners - centers[:, None]).max(axis=(1, 2))
    np.testing.assert_allclose(reach, 0.5 * VOXEL, rtol=0, atol=1e-5)


def test_floored_cells_have_their_centres_half_a_voxel_on(device):
    surface = build_surface(_map([[0.01, 0.01, 0.01]], offset=0.5), device)
    middle = surface.surface.centers.numpy()[0] + surface.voxels.grid.origin
    np.testing.assert_allclose(middle, [0.025] * 3, rtol=0, atol=1e-6)
    assert _cast(surface, [middle - surface.voxels.grid.origin - [1, 0, 0]], [[1, 0, 0]], device)[0] == 0


def test_rays_hit_what_the_walk_through_the_grid_hits(device):
    rng = np.random.default_rng(1)
    points = cluttered_room(1)
    surface = build_surface(_map(points), device)
    origins = rng.uniform([0.2, 0.2, 0.2], [2.8, 2.3, 1.3], size=(400, 3))
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    got = _cast(surface, origins - surface.voxels.grid.origin, directions, device)
    occupied = set(map(tuple, np.rint(points / VOXEL).astype(int).tolist()))
    cells = surface.voxels.ijk + surface.voxels.grid.origin_ijk
    compared = 0
    for o, d, hit in zip(origins, directions, got, strict=True):
        expected, safe = robust_first_voxel(occupied, o, d, VOXEL, GRAZING_BAND)
        if safe:
            compared += 1
            assert tuple(cells[hit].tolist()) == expected
    assert compared > 380


def test_a_ray_that_meets_nothing_says_so(device):
    surface = build_surface(_map([[0.0, 0.0, 0.0]], origin=(0, 0, 0)), device)
    origins = [[1, 0, 0], [1, 0, 0], [-2, 0, 0]]
    directions = [[1, 0, 0], [-1, 0, 0], [1, 0, 0]]
    assert _cast(surface, origins, directions, device).tolist() == [-1, 0, 0]
    assert _cast(surface, origins, directions, device, max_distance=1.5).tolist() == [-1, 0, -1]


def test_a_camera_inside_an_occupied_voxel_sees_that_voxel(device):
    row = [[0.05 * i, 0, 0] for i in range(5)]
    surface = build_surface(_map(row, origin=(0, 0, 0)), device)
    assert _cast(surface, [[0.1, 0.01, 0.0]], [[1, 0, 0]], device)[0] == 2


def test_no_rays_give_no_hits(device):
    surface = build_surface(_map([[0.0, 0.0, 0.0]]), device)
    assert _cast(surface, np.empty((0, 3)), np.empty((0, 3)), device).shape == (0,)
