"""The merging baselines against parts of a furnished flat, moved by known transforms."""

from __future__ import annotations

import builtins
import functools

import numpy as np
import pytest
import tum_sample
from merging_scenes import VOXEL, difference, flat, on_lattice, pose, seen_from
from scenes import cluttered_room
from scipy.spatial.transform import Rotation, Slerp
from tum_sample import read_tum

from maomaps_warp.errors import InputError
from maomaps_warp.merging.correlation_2d import place_by_correlation
from maomaps_warp.merging.point_features import BINS, describe, most_distinct
from maomaps_warp.merging.registration_3d import place_by_registration
from maomaps_warp.merging.start_poses import place_by_start_poses

#: Asked of the baselines: degrees, and voxels at the source's zero.
PLANE_DEGREES, PLANE_VOXELS = 1.0, 1.5
SPACE_DEGREES, SPACE_VOXELS = 0.5, 1.0
PLANAR = pose((133.0, 0.0, 0.0), (3.2, -1.1, 0.4))
TILTED = pose((133.0, 4.0, -3.0), (3.2, -1.1, 0.4))

METHODS = pytest.mark.parametrize("place", [place_by_correlation, place_by_registration])


@pytest.fixture(scope="module")
def halves():
    """Two parts of a flat of 8 x 7 m that share a strip of 2.4 m."""
    _, points = whole(0)
    middle = points[:, 0].mean()
    return points[points[:, 0] < middle + 1.2], points[points[:, 0] > middle - 1.2]


@functools.cache
def whole(seed):
    return flat(seed)


def room_of(seed, name):
    scene, points = whole(seed)
    room = next(room for room in scene.rooms if room.name == name)
    x, y = points[:, 0], points[:, 1]
    return points[(x > room.x_min - 0.1) & (x < room.x_max + 0.1) & (y > room.y_min - 0.1) & (y < room.y_max + 0.1)]


def test_start_poses_place_each_source_as_its_run_began():
    T_world = [pose((30.0, 0.0, 0.0), (1.0, 2.0, 0.5)), TILTED, PLANAR]
    placements = place_by_start_poses(T_world)
    np.testing.assert_allclose(placements[0].T_merged_source, np.eye(4), rtol=0, atol=1e-12)
    for T, placement in zip(T_world, placements, strict=True):
        np.testing.assert_allclose(T_world[0] @ placement.T_merged_source, T, rtol=0, atol=1e-12)
        assert placement.confidence is None


@pytest.mark.parametrize("yaw", [0.0, 1.3, 91.0, 179.0, 243.7])
def test_correlation_finds_yaw_and_shift_of_a_part_that_overlaps(halves, yaw):
    T = pose((yaw, 0.0, 0.0), (3.2, -1.1, 0.4))
    placement = place_by_correlation(halves[0], seen_from(T, halves[1]), VOXEL)
    degrees, metres = difference(placement.T_merged_source, T)
    assert degrees < PLANE_DEGREES and metres < PLANE_VOXELS * VOXEL
    assert 0.8 < placement.confidence <= 1.0


@pytest.mark.slow
def test_correlation_finds_a_small_map_in_a_large_one_and_the_other_way_round():
    large, small = whole(1)[1], room_of(1, "kitchen")
    T = pose((200.0, 0.0, 0.0), (-2.0, 1.0, -0.3))
    for target, source in ((large, seen_from(T, small)), (small, seen_from(T, large))):
        degrees, metres = difference(place_by_correlation(target, source, VOXEL).T_merged_source, T)
        assert degrees < PLANE_DEGREES and metres < PLANE_VOXELS * VOXEL


def test_correlation_does_not_merge_where_several_places_fit():
    # A corridor of 8 m with equal pilasters and nothing else.
    x, y, z = np.meshgrid(np.arange(160), np.arange(40), np.arange(30), indexing="ij")
    walls = (z == 0) | (y == 0) | (y == 39) | ((x % 40 < 4) & (y < 6))
    corridor = np.argwhere(walls) * VOXEL
    part = corridor[(corridor[:, 0] > 2.0) & (corridor[:, 0] < 5.0)]
    placement = place_by_correlation(corridor, part, VOXEL)
    assert placement.T_merged_source is None
    assert "another place fits as well" in placement.reason


@pytest.mark.slow
def test_registration_finds_all_six_degrees_of_freedom(halves):
    pytest.importorskip("small_gicp")
    placement = place_by_registration(halves[0], seen_from(TILTED, halves[1]), VOXEL)
    degrees, metres = difference(placement.T_merged_source, TILTED)
    assert degrees < SPACE_DEGREES and metres < SPACE_VOXELS * VOXEL
    assert 0.8 < placement.confidence <= 1.0


@pytest.mark.slow
def test_registration_gives_the_same_bits_again_and_works_far_from_zero():
    pytest.importorskip("small_gicp")
    room = room_of(1, "kitchen")
    near = place_by_registration(room, seen_from(TILTED, room), VOXEL)
    degrees, metres = difference(near.T_merged_source, TILTED)
    assert degrees < SPACE_DEGREES and metres < SPACE_VOXELS * VOXEL
    again = place_by_registration(room, seen_from(TILTED, room), VOXEL)
    np.testing.assert_array_equal(near.T_merged_source, again.T_merged_source)
    assert near.confidence == again.confidence
    # 100 km: a whole number of voxels, so that the lattice is the same.
    far = np.array([1e5, -1e5, 0.0])
    moved = place_by_registration(room + far, seen_from(TILTED, room), VOXEL).T_merged_source
    expected = TILTED.copy()
    expected[:3, 3] += far
    degrees, metres = difference(moved, expected)
    assert degrees < SPACE_DEGREES and metres < SPACE_VOXELS * VOXEL


@pytest.mark.parametrize("seeds", [(0, 1), (1, 0)])
def test_correlation_does_not_merge_rooms_of_different_flats(seeds):
    target, source = room_of(seeds[0], "kitchen"), room_of(seeds[1], "study")
    placement = place_by_correlation(target, seen_from(PLANAR, source), VOXEL)
    assert placement.T_merged_source is None
    assert placement.confidence < 0.8 and "correlation" in placement.reason


@pytest.mark.slow
@pytest.mark.parametrize("rooms", [("kitchen", "study"), ("bedroom", "living room"), ("study", "living room")])
def test_registration_does_not_merge_rooms_of_different_flats(rooms):
    pytest.importorskip("small_gicp")
    target, source = room_of(1, rooms[0]), room_of(0, rooms[1])
    placement = place_by_registration(target, seen_from(TILTED, source), VOXEL)
    assert placement.T_merged_source is None and placement.reason


@METHODS
@pytest.mark.parametrize("count", [0, 1, 4])
def test_tiny_maps_are_not_merged(place, count):
    if place is place_by_registration:
        pytest.importorskip("small_gicp")
    tiny, room = cluttered_room(1)[:count], cluttered_room(1)
    for target, source in ((tiny, room), (room, tiny), (tiny, tiny)):
        placement = place(target, source, VOXEL)
        assert placement.T_merged_source is None and placement.confidence is None and placement.reason


@METHODS
def test_a_bare_floor_is_not_merged(place):
    if place is place_by_registration:
        pytest.importorskip("small_gicp")
    floor = np.argwhere(np.ones((60, 60, 1), dtype=bool)) * VOXEL
    placement = place(floor, floor + (0.5, 0.0, 0.0), VOXEL)
    assert placement.T_merged_source is None and placement.reason


def test_registration_without_its_library_says_how_to_install_it(monkeypatch):
    real = builtins.__import__

    def without(name, *arguments, **options):
        if name == "small_gicp":
            raise ImportError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"pip install 'maomaps-warp\[merge\]'"):
        place_by_registration(cluttered_room(1), cluttered_room(1), VOXEL)


def test_descriptors_do_not_change_with_the_pose_or_the_sides_of_normals():
    rng = np.random.default_rng(4)
    points = rng.random((300, 3))
    normals = rng.normal(size=(300, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    here = describe(points, normals, 0.3)
    assert here.shape == (300, 3 * BINS)
    R = TILTED[:3, :3]
    flipped = normals * rng.choice([-1.0, 1.0], 300)[:, None]
    there = describe(points @ R.T + (5.0, -3.0, 1.0), flipped @ R.T, 0.3)
    # Rounding moves a cosine at a bin's edge into the next one now and then.
    assert (np.abs(here - there).max(axis=1) > 1e-9).mean() < 0.01


def test_the_most_distinct_points_of_a_room_are_not_those_of_its_bare_walls():
    wall = np.argwhere(np.ones((1, 40, 40), dtype=bool)) * 0.1
    post = np.argwhere(np.ones((5, 1, 1), dtype=bool)) * 0.1 + (0.1, 2.0, 2.0)
    points = np.concatenate([wall, post])
    normals = np.zeros((len(points), 3))
    normals[: len(wall), 0] = normals[len(wall) :, 1] = 1.0
    chosen = most_distinct(describe(points, normals, 0.35), 5)
    assert np.linalg.norm(points[chosen] - (0.1, 2.0, 2.0), axis=1).max() < 0.6


def test_a_map_on_a_lattice_of_its_own_is_placed_as_well(halves):
    # The source is cut out of the world before it is voxelised, so no voxel of it is one of the target's.
    source = on_lattice(halves[1] @ pose((45.0, 0.0, 0.0), (0.0, 0.0, 0.0))[:3, :3])
    T = pose((45.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    degrees, metres = difference(place_by_correlation(halves[0], source, VOXEL).T_merged_source, T)
    assert degrees < PLANE_DEGREES and metres < PLANE_VOXELS * VOXEL


@pytest.mark.slow
def test_registration_merges_two_halves_of_a_real_recording():
    pytest.importorskip("small_gicp")
    frames = read_tum(stride=2)
    first, second = (tum_map(frames, *tum_sample.RUNS[run]) for run in ("first", "second"))
    T = pose((50.0, 0.0, 0.0), (1.0, -0.5, 0.3))
    degrees, metres = difference(place_by_registration(first, seen_from(T, second), VOXEL).T_merged_source, T)
    # The halves are maps of a real depth camera: their surfaces differ by its noise.
    assert degrees < 2 * SPACE_DEGREES and metres < SPACE_VOXELS * VOXEL


def tum_map(frames, first, end):
    """Voxels of frames of the TUM recording, from 0.3 to 4 m, through the motion capture's poses."""
    v, u = np.mgrid[0:240, 0:320]
    rays = np.stack([(u - 319.5 / 2) / 262.5, (v - 239.5 / 2) / 262.5, np.ones(u.shape)], axis=-1)
    stamps = frames.pose_stamps_ns.astype(np.float64)
    turns = Slerp(stamps, Rotation.from_matrix(frames.T_world_camera[:, :3, :3]))
    points = []
    for stamp, depth in zip(frames.stamps_ns[first:end], frames.depth[first:end], strict=True):
        near = (depth > 0.3) & (depth < 4.0)
        shift = [np.interp(float(stamp), stamps, frames.T_world_camera[:, axis, 3]) for axis in range(3)]
        points.append(on_lattice(turns(float(stamp)).apply(rays[near] * depth[near][:, None]) + shift))
    return on_lattice(np.concatenate(points))
