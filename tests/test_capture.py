"""Launchers inside a captured graph: a replay works on what their arrays then hold."""

from __future__ import annotations

import numpy as np
import warp as wp
from scenes import camera_pose, cluttered_room

from maomaps_warp.kernels import (
    DepthSampling,
    Pinhole,
    cast_rays,
    create_voxel_hash,
    find_nearest,
    integrate_depth,
)
from maomaps_warp.mapping.cloud_map import voxelise
from maomaps_warp.mapping.depth_samples import cells_from_camera
from maomaps_warp.mapping.surface import build_surface
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.scoring.nearest import build_point_tree

GRID = VoxelGrid(0.05, np.zeros(3, dtype=np.int64))


def _sampling():
    sampling = DepthSampling()
    sampling.min_range, sampling.max_range, sampling.center_offset, sampling.stride = 0.01, 10.0, 0.0, 1
    return sampling


def _pinhole():
    camera = Pinhole()
    camera.fx, camera.fy, camera.cx, camera.cy = 20.0, 20.0, 9.5, 9.5
    return camera


def _content(table):
    keys = table.keys.numpy()
    used = keys >= 0
    return dict(zip(keys[used].tolist(), table.counts.numpy()[used].tolist(), strict=True))


def test_a_captured_integration_maps_the_frame_and_pose_that_its_arrays_hold_at_replay(device):
    rng = np.random.default_rng(0)
    depths = rng.uniform(0.5, 3.0, size=(3, 20, 20)).astype(np.float32)
    poses = np.stack([camera_pose((0.3 * i, 0, 1), 0.7 * i) for i in range(3)])
    transforms = cells_from_camera(poses, GRID)
    expected = create_voxel_hash(1 << 13, device)
    for depth, transform in zip(depths, transforms, strict=True):
        put = wp.array(transform[None], dtype=wp.mat44, device=device)
        frame = wp.array(depth, dtype=wp.float32, device=device)
        integrate_depth(frame, _pinhole(), put, _sampling(), out_table=expected)

    table = create_voxel_hash(1 << 13, device)
    depth = wp.zeros((20, 20), dtype=wp.float32, device=device)
    pose = wp.zeros(1, dtype=wp.mat44, device=device)
    with wp.ScopedCapture(device=device) as capture:
        integrate_depth(depth, _pinhole(), pose, _sampling(), out_table=table)
    for frame, transform in zip(depths, transforms, strict=True):
        depth.assign(frame)
        pose.assign(transform[None])
        wp.capture_launch(capture.graph)
    assert _content(table) == _content(expected)
    assert len(_content(table)) > 500


def test_captured_rays_and_neighbours_answer_for_new_queries(device):
    room = cluttered_room(0)
    surface = build_surface(voxelise(room, GRID), device)
    tree = build_point_tree(room, device)
    rng = np.random.default_rng(1)
    origins = wp.array(rng.uniform(0.3, 1.2, size=(50, 3)).astype(np.float32), dtype=wp.vec3, device=device)
    directions = wp.zeros(50, dtype=wp.vec3, device=device)
    queries = wp.zeros(50, dtype=wp.vec3d, device=device)
    hits, nearest = (wp.zeros(50, dtype=wp.int32, device=device) for _ in range(2))
    with wp.ScopedCapture(device=device) as capture:
        cast_rays(surface.surface, origins, directions, out_voxel=hits)
        find_nearest(tree, queries, out_index=nearest)
    for _ in range(2):
        d = rng.normal(size=(50, 3))
        directions.assign((d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32))
        queries.assign(rng.uniform(0, 2, size=(50, 3)))
        wp.capture_launch(capture.graph)
        np.testing.assert_array_equal(hits.numpy(), cast_rays(surface.surface, origins, directions).numpy())
        np.testing.assert_array_equal(nearest.numpy(), find_nearest(tree, queries).numpy())
