"""Back-projection in float64 against NumPy, at the faces of voxels too."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from oracle_gt_map import samples
from scenes import camera_pose

from maomaps_warp.errors import InputError
from maomaps_warp.kernels import ExactPinhole, ExactSampling, create_voxel_hash, integrate_depth_exact
from maomaps_warp.mapping.poses import heading_only
from maomaps_warp.mapping.voxel_map import DepthLimits, build_voxel_map
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.voxels import VoxelGrid, unpack_keys

CAMERA = Camera(64, 48, 40.0, 42.0, 31.0, 24.5)
USUAL = DepthLimits()
K = (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)


def grid(voxel_size=0.05, origin=(0, 0, 0), offset=0.0):
    return VoxelGrid(voxel_size, np.array(origin, dtype=np.int64), offset)


def stream(depths, colors=None, camera=CAMERA):
    def read(with_colors):
        for i, depth in enumerate(depths):
            yield Frame(i, None, depth, colors[i] if with_colors and colors else None)

    return FrameStream(camera, len(depths), read, "test frames")


def build(depth, T, lattice, device, camera=CAMERA, limits=USUAL):
    return build_voxel_map(
        stream([depth], camera=camera), lambda f: T, lattice, limits, arithmetic="float64", device=device
    )


def cells(voxels):
    return dict(zip(map(tuple, (voxels.ijk + voxels.grid.origin_ijk).tolist()), voxels.counts.tolist(), strict=True))


def counted(rows):
    unique, counts = np.unique(rows.astype(int), axis=0, return_counts=True)
    return dict(zip(map(tuple, unique.tolist()), counts.tolist(), strict=True))


@pytest.mark.parametrize("place", [(0.3, -0.2, 1.1), (458074.6, 5429380.15, 162.9)])
def test_every_sample_falls_into_the_voxel_of_numpy_wherever_the_world_lies(place, device):
    depth = np.random.default_rng(1).uniform(0.2, 4.0, size=(48, 64)).astype(np.float32)
    T = camera_pose(place, 0.4, 0.1)
    got = build(depth, T, VoxelGrid.around(np.array([place]), 0.05), device)
    assert cells(got.voxels) == counted(np.rint(samples(depth, K, T) / 0.05))


@pytest.mark.parametrize("origin", [(0, 0, 0), (6, -4, 1000)])
def test_samples_on_faces_round_to_even_cells_of_the_world(origin, device):
    # Quarters of a metre along the axis; voxels of half a metre: every second sample lies on a face, exactly.
    depth = (0.25 * np.arange(1, 33, dtype=np.float32))[None]
    camera = Camera(32, 1, 1e9, 1e9, 15.0, 0.0)
    T = np.eye(4)
    T[2, 3] = -4.0
    got = build(depth, T, grid(0.5, origin), device, camera)
    assert cells(got.voxels) == counted(np.rint(samples(depth, (1e9, 1e9, 15.0, 0.0), T) / 0.5))
    assert (0, 0, -1) in cells(got.voxels) and got.voxels.counts.max() == 3


def test_a_sample_is_divided_by_the_voxel_size_and_not_multiplied_by_its_inverse(device):
    camera = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)
    differ = np.zeros(3, dtype=int)
    for k in range(1, 200):
        T = np.eye(4)
        T[:3, 3] = (0.05 * k, -0.05 * k, 0.05 * k - 0.5)  # faces between voxels of a decimetre, but for rounding
        point = T[:3, 3] + [0.0, 0.0, 0.5]
        differ += np.rint(point / 0.1) != np.rint(point * (1.0 / 0.1))
        got = build(np.full((1, 1), 0.5, np.float32), T, grid(0.1), device, camera)
        assert list(cells(got.voxels)) == [tuple(np.rint(point / 0.1))]
    assert differ.all()


def test_floored_cells_start_at_multiples_of_the_voxel_size(device):
    depth = np.random.default_rng(2).uniform(0.2, 4.0, size=(48, 64)).astype(np.float32)
    T = camera_pose((-0.3, 0.2, 1.1), 2.4, -0.1)
    got = build(depth, T, grid(offset=0.5), device)
    assert cells(got.voxels) == counted(np.floor(samples(depth, K, T) / 0.05))


def test_range_limits_are_exclusive_in_double_precision(device):
    camera = Camera(3, 1, 1.0, 1.0, 0.0, 0.0)
    # At (1, 0) the distance is z * sqrt(2): the range of the middle pixel ends exactly at its distance.
    depth = np.array([[3.0, 1.0, 0.5]], np.float32)
    at_limit = build(depth, np.eye(4), grid(), device, camera, DepthLimits(0.01, float(np.sqrt(2.0))))
    above = build(depth, np.eye(4), grid(), device, camera, DepthLimits(0.01, float(np.nextafter(np.sqrt(2.0), 2.0))))
    assert (at_limit.pixels_used, above.pixels_used) == (1, 2)


def test_missing_depth_is_no_sample_and_points_beyond_the_grid_are_refused(device):
    depth = np.array([[np.nan, 0.0, -1.0, 2.0]], np.float32)
    camera = Camera(4, 1, 1.0, 1.0, 0.0, 0.0)
    assert build(depth, np.eye(4), grid(), device, camera).pixels_used == 1
    for far in (1e6, 1e300, np.inf):
        T = np.eye(4)
        T[0, 3] = far
        with pytest.raises(InputError, match="beyond the reach"):
            build(depth, T, grid(), device, camera)


def test_a_captured_integration_maps_what_its_arrays_hold_at_replay(device):
    sampling = ExactSampling()
    sampling.min_range, sampling.max_range, sampling.depth_scale = 0.01, 10.0, 1.0
    sampling.voxel_size, sampling.center_offset, sampling.stride = 0.05, 0.0, 1
    sampling.origin_ijk = wp.vec3l(0, 0, 0)
    camera = ExactPinhole()
    camera.fx, camera.fy, camera.cx, camera.cy = K
    table = create_voxel_hash(1 << 14, device)
    depth = wp.zeros((48, 64), dtype=wp.float32, device=device)
    pose = wp.zeros(1, dtype=wp.mat44d, device=device)
    with wp.ScopedCapture(device=device) as capture:
        integrate_depth_exact(depth, camera, pose, sampling, out_table=table)
    rng = np.random.default_rng(3)
    points = []
    for i in range(3):
        image, T = rng.uniform(0.5, 3.0, size=(48, 64)).astype(np.float32), camera_pose((0.3 * i, 0, 1), 0.7 * i)
        depth.assign(image)
        pose.assign(T[None])
        wp.capture_launch(capture.graph)
        points.append(samples(image, K, T))
    keys = table.keys.numpy()
    used = keys >= 0
    got = dict(zip(map(tuple, unpack_keys(keys[used]).tolist()), table.counts.numpy()[used].tolist(), strict=True))
    assert got == counted(np.rint(np.concatenate(points) / 0.05))


def test_a_wrong_array_is_refused_by_name(device):
    table = create_voxel_hash(16, device)
    depth = wp.zeros((2, 2), dtype=wp.float32, device=device)
    sampling = ExactSampling()
    sampling.stride = 1
    with pytest.raises(TypeError, match="T_world_camera"):
        integrate_depth_exact(
            depth, ExactPinhole(), wp.zeros(1, dtype=wp.mat44, device=device), sampling, out_table=table
        )
    pose = wp.zeros(1, dtype=wp.mat44d, device=device)
    with pytest.raises(ValueError, match="colors"):
        colors = wp.zeros((2, 2, 3), dtype=wp.uint8, device=device)
        integrate_depth_exact(depth, ExactPinhole(), pose, sampling, colors=colors, out_table=table)
    sampling.stride = 0
    with pytest.raises(ValueError, match="stride"):
        integrate_depth_exact(depth, ExactPinhole(), pose, sampling, out_table=table)


@pytest.mark.parametrize("arithmetic", ["float32", "float64"])
def test_truncated_colours_drop_the_fraction(arithmetic, device):
    depth = np.zeros((48, 64), np.float32)
    depth[10, 10:12] = 1.0
    colors = np.zeros((48, 64, 3), np.uint8)
    colors[10, 10], colors[10, 11] = (10, 0, 255), (13, 1, 255)
    narrow = Camera(64, 48, 4000.0, 4000.0, 10.5, 10.0)
    frames = stream([depth], [colors], narrow)
    made = build_voxel_map(
        frames, lambda f: np.eye(4), grid(), DepthLimits(), colors="truncated", arithmetic=arithmetic, device=device
    )
    assert made.voxels.colors.tolist() == [[11, 0, 255]]


def test_frames_without_colours_are_left_out_and_counted_where_colours_are_wanted(device):
    depths = [np.full((48, 64), z, np.float32) for z in (1.0, 2.0, 3.0)]
    shade = np.full((48, 64, 3), 7, np.uint8)
    frames = stream(depths, [shade, None, shade])

    def pose_of_frame(frame):
        return None if frame.index == 2 else np.eye(4)

    made = build_voxel_map(frames, pose_of_frame, grid(), DepthLimits(), colors="rounded", device=device)
    assert (made.frames, made.frames_without_pose, made.frames_without_color) == (3, 1, 1)
    assert made.counts["frames_without_color"] == 1
    assert made.voxels.points[:, 2].max() == 1.0
    plain = build_voxel_map(frames, pose_of_frame, grid(), DepthLimits(), device=device)
    assert "frames_without_color" not in plain.counts
    assert plain.voxels.points[:, 2].max() == 2.0


def test_a_heading_forgets_pitch_and_roll_and_keeps_the_place():
    tilted, level = camera_pose((1.0, -2.0, 3.0), 0.7, 0.4), camera_pose((1.0, -2.0, 3.0), 0.7)
    np.testing.assert_allclose(heading_only(tilted), level, rtol=0, atol=1e-15)
    np.testing.assert_allclose(heading_only(level), level, rtol=0, atol=1e-15)
