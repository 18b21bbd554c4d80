"""Maps from frames and from points, against the NumPy twin."""

from __future__ import annotations

import numpy as np
import pytest
from oracle import back_project, voxels_of
from scenes import camera_pose, rendered_depth

from maomaps_warp.errors import InputError
from maomaps_warp.kernels import voxel_hash
from maomaps_warp.kernels.voxel_hash import rehash
from maomaps_warp.mapping import hash_map
from maomaps_warp.mapping.cloud_map import check_extent, octomap_leaves, voxelise
from maomaps_warp.mapping.voxel_map import DepthLimits, build_voxel_map
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.voxels import VoxelGrid

CAMERA = Camera(64, 48, 40.0, 42.0, 31.0, 24.5)
K = (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
#: Share of voxels that float32 may put across a cell's face against float64.
FLOAT32_FLIPS = 1e-3


def _stream(depths, colors=None, camera=CAMERA):
    def read(with_colors):
        for i, depth in enumerate(depths):
            yield Frame(i, None, depth, colors[i] if with_colors else None)

    return FrameStream(camera, len(depths), read, "test frames")


def _grid(origin=(0, 0, 0), offset=0.0):
    return VoxelGrid(0.05, np.array(origin, dtype=np.int64), offset)


def _random_depths(count, seed=0):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.2, 4.0, size=(count, 48, 64)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = 0.0
    return depth


def _world(voxels):
    return set(map(tuple, (voxels.ijk + voxels.grid.origin_ijk).tolist()))


POSES = [camera_pose((0.3, -0.2, 1.1), 0.4, 0.1), camera_pose((0.5, 0.1, 1.0), -1.2, -0.2)]


def test_frames_fall_into_the_voxels_of_the_twin(device):
    depths = _random_depths(2)
    build = build_voxel_map(
        _stream(depths), lambda f: POSES[f.index], _grid((10, -4, 20)), DepthLimits(), device=device
    )
    expected = voxels_of(np.concatenate([back_project(d, K, T) for d, T in zip(depths, POSES, strict=True)]))
    got = _world(build.voxels)
    assert len(got ^ expected) <= FLOAT32_FLIPS * len(expected)
    assert build.voxels.counts.sum() == build.pixels_used == np.count_nonzero(depths)


def test_range_limits_are_exclusive_and_count(device):
    depth = np.zeros((48, 64), np.float32)
    centre = Camera(64, 48, 40.0, 40.0, 10.0, 10.0)
    depth[10, 10], depth[10, 11], depth[11, 10] = 10.0, 0.009, 9.9
    depth[40, 60] = 9.9  # in the corner: nearer than 10 m along the axis, but not from the camera
    build = build_voxel_map(
        _stream([depth], camera=centre), lambda f: np.eye(4), _grid(), DepthLimits(0.01, 10.0), device=device
    )
    assert (build.pixels, build.pixels_used) == (48 * 64, 1)


def test_a_plane_far_from_the_worlds_zero_keeps_its_voxels(device):
    far = np.array([458074.6, 5429380.15, 162.9])
    T = camera_pose(tuple(far), 0.0)
    depth = rendered_depth(far[0] + 2.0, (64, 48, *K), T)
    grid = VoxelGrid.around(far[None], 0.05)
    build = build_voxel_map(_stream([depth]), lambda f: T, grid, DepthLimits(), device=device)
    x = build.voxels.points[:, 0] - far[0]
    assert np.all(np.abs(x - 2.0) <= 0.5 * 0.05 + 1e-3)


def test_colours_are_rounded_means(device):
    depth = np.zeros((48, 64), np.float32)
    depth[10, 10:12] = 1.0
    colors = np.zeros((48, 64, 3), np.uint8)
    colors[10, 10], colors[10, 11] = (10, 0, 255), (13, 1, 255)
    narrow = Camera(64, 48, 4000.0, 4000.0, 10.5, 10.0)
    build = build_voxel_map(
        _stream([depth], [colors], narrow),
        lambda f: np.eye(4),
        _grid(),
        DepthLimits(),
        colors="rounded",
        device=device,
    )
    assert build.voxels.counts.tolist() == [2]
    assert build.voxels.colors.tolist() == [[12, 1, 255]]  # 11.5 and 0.5 round up


def test_the_table_grows_and_drops_nothing(device, monkeypatch):
    depths = _random_depths(12, seed=5) * 1.5
    poses = [camera_pose((3.0 * i, 0, 1), 0.5 * i) for i in range(12)]
    colors = np.random.default_rng(6).integers(0, 256, size=(12, 48, 64, 3), dtype=np.uint8)

    def build():
        table = hash_map.HashMap(CAMERA, _grid(), DepthLimits(), with_colors=True, device=device)
        for depth, color, pose in zip(depths, colors, poses, strict=True):
            table.add(depth, color, pose)
        return table.finish("test frames", "rounded")

    at_once = build()
    moves = []
    monkeypatch.setattr(hash_map, "_FIRST_CAPACITY", 1 << 10)
    monkeypatch.setattr(voxel_hash, "rehash", lambda a, b: (moves.append(a.keys.shape[0]), rehash(a, b)))
    grown = build()
    assert len(moves) >= 3
    np.testing.assert_array_equal(grown.ijk, at_once.ijk)
    np.testing.assert_array_equal(grown.counts, at_once.counts)
    np.testing.assert_array_equal(grown.colors, at_once.colors)
    assert grown.counts.sum() == np.count_nonzero(depths)


def test_frames_without_a_pose_are_counted_and_left_out(device):
    depths = _random_depths(3)
    build = build_voxel_map(
        _stream(depths), lambda f: POSES[0] if f.index == 1 else None, _grid(), DepthLimits(), device=device
    )
    alone = build_voxel_map(_stream(depths[1:2]), lambda f: POSES[0], _grid(), DepthLimits(), device=device)
    assert (build.frames, build.frames_without_pose) == (3, 2)
    np.testing.assert_array_equal(build.voxels.ijk, alone.voxels.ijk)


def test_the_order_of_frames_does_not_change_the_map(device):
    depths = _random_depths(2)
    forward = build_voxel_map(_stream(depths), lambda f: POSES[f.index], _grid(), DepthLimits(), device=device)
    backward = build_voxel_map(
        _stream(depths[::-1]), lambda f: POSES[1 - f.index], _grid(), DepthLimits(), device=device
    )
    np.testing.assert_array_equal(forward.voxels.ijk, backward.voxels.ijk)
    np.testing.assert_array_equal(forward.voxels.counts, backward.voxels.counts)


def test_a_stride_takes_every_nth_pixel_from_pixel_zero(device):
    depths = _random_depths(1)
    strided = np.zeros_like(depths)
    strided[:, ::3, ::3] = depths[:, ::3, ::3]
    a = build_voxel_map(_stream(depths), lambda f: POSES[0], _grid(), DepthLimits(pixel_stride=3), device=device)
    b = build_voxel_map(_stream(strided), lambda f: POSES[0], _grid(), DepthLimits(), device=device)
    np.testing.assert_array_equal(a.voxels.ijk, b.voxels.ijk)
    assert a.pixels == 16 * 22


def test_a_depth_image_of_another_size_is_refused_with_its_frame(device):
    wrong = [np.ones((10, 10), np.float32)]
    with pytest.raises(InputError, match=r"frame 0.*10x10"):
        build_voxel_map(_stream(wrong), lambda f: np.eye(4), _grid(), DepthLimits(), device=device)


def test_a_pose_that_jumps_out_of_the_grid_is_refused(device):
    away = camera_pose((1e6, 0, 0), 0.0)
    with pytest.raises(InputError, match="beyond the reach"):
        build_voxel_map(_stream(_random_depths(1)), lambda f: away, _grid(), DepthLimits(), device=device)


def test_points_on_multiples_of_the_voxel_size_fall_into_the_voxel_they_name():
    k = np.arange(-4000, 4000)
    points = np.stack([k * 0.05, (k + 7) * 0.05, np.round((k - 3) * 0.05, 2)], axis=1)
    named = np.stack([k, k + 7, k - 3], axis=1)
    for values in (points, points.astype(np.float32).astype(np.float64)):
        np.testing.assert_array_equal(_grid().ijk_of(values), named)
        np.testing.assert_array_equal(_grid((6, 6, 6)).ijk_of(values), named - 6)


def test_points_of_one_voxel_share_it_with_their_mean_colour():
    points = np.array([[0.01, 0, 0], [-0.02, 0.02, 0], [0.05, 0, 0]])
    colors = np.array([[0, 10, 255], [1, 10, 255], [7, 8, 9]], dtype=np.uint8)
    voxels = voxelise(points, _grid(), colors)
    assert voxels.ijk.tolist() == [[0, 0, 0], [1, 0, 0]]
    assert voxels.counts.tolist() == [2, 1]
    assert voxels.colors.tolist() == [[1, 10, 255], [7, 8, 9]]


def test_a_cloud_too_far_from_the_ground_truth_is_refused():
    with pytest.raises(InputError, match="point 2"):
        check_extent(np.array([[0, 0, 0], [0, 1e7, 0.0]]), _grid(), "est.ply")


def test_a_full_block_of_eight_becomes_one_leaf_and_a_block_of_64_too():
    cells = np.argwhere(np.ones((2, 2, 2))) + [4, 4, 4]
    single = np.array([[0, 0, 0]])
    points = (np.concatenate([cells, single]) + 0.5) * 0.05
    leaves = octomap_leaves(voxelise(points, _grid((3, 1, 0), 0.5)))
    np.testing.assert_allclose(leaves, [[0.025] * 3, [0.25] * 3], rtol=0, atol=1e-12)
    block = (np.argwhere(np.ones((4, 4, 4))) - 4 + 0.5) * 0.05
    np.testing.assert_allclose(octomap_leaves(voxelise(block, _grid(offset=0.5))), [[-0.1] * 3], rtol=0, atol=1e-12)


def test_a_block_that_straddles_octree_parents_is_not_pruned():
    cells = np.argwhere(np.ones((2, 2, 2))) + [1, 0, 0]
    assert len(octomap_leaves(voxelise((cells + 0.5) * 0.05, _grid(offset=0.5)))) == 8


@pytest.mark.parametrize("count", [1, 2, 3, 10, 4097])
def test_a_grid_lies_around_the_median_of_its_points(count):
    points = np.random.default_rng(count).normal(scale=30.0, size=(count, 3))
    origin = VoxelGrid.around(points, 0.05).origin_ijk
    np.testing.assert_array_equal(origin, 2 * np.rint(np.median(points, axis=0) / 0.1))


@pytest.mark.parametrize("order", ["sorted", "each twice", "all twice", "shuffled", "with colours", "none"])
def test_points_in_any_order_give_the_same_voxels(order):
    rng = np.random.default_rng(0)
    cells = np.unique(rng.integers(-40, 40, size=(0 if order == "none" else 40_000, 3)), axis=0)
    orders = {
        "sorted": cells,
        "each twice": np.repeat(cells, 2, axis=0),
        "all twice": np.concatenate([cells, cells]),
        "none": cells,
    }
    points = 0.05 * orders.get(order, rng.permutation(np.repeat(cells, 3, axis=0)))
    colors = np.full(points.shape, 7, np.uint8) if order == "with colours" else None
    voxels = voxelise(points, VoxelGrid(0.05, np.array([4, -6, 2])), colors)
    np.testing.assert_array_equal(voxels.ijk, cells - [4, -6, 2])
    assert np.all(voxels.counts * len(cells) == len(points))
    np.testing.assert_array_equal(voxels.points, 0.05 * cells)
