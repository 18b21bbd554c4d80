"""Packets of elements answer what one thread for each element does, bit for bit, in whatever company."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import VOXEL, camera_pose, cluttered_room

from maomaps_warp.mapping.cloud_map import voxelise
from maomaps_warp.mapping.distance_field import build_voxel_field
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.scoring.association import ViewRules, associate_maps
from maomaps_warp.scoring.element_bricks import sort_into_bricks

#: Its principal point lies off the middle: the four borders of the view differ.
CAMERA = Camera(64, 48, 40.0, 30.0, 20.0, 30.0)
CHOICES = ["nearest", "first", "last", "all"]
RULES = {
    "plain": {},
    "two-sided": {"two_sided": True},
    "short-sighted": {"near": 0.4, "max_range": 1.2},
    "strict": {"occlusion_tolerance": 0.06},
    "no tolerance": {"occlusion_tolerance": 0.0},
    "all-seeing": {"occlusion_tolerance": 50.0},
}


def _field(points, origin=(0, 0, 0), dense_bytes=1 << 28):
    voxels = voxelise(np.asarray(points, dtype=float), VoxelGrid(VOXEL, np.array(origin)))
    return build_voxel_field(voxels, dense_bytes=dense_bytes)


def _poses(count, seed, low=(-0.5, -0.5, 0.2), high=(3.5, 3.0, 1.3)):
    rng = np.random.default_rng(seed)
    return np.stack(
        [camera_pose(tuple(rng.uniform(low, high)), *rng.uniform(-1.5, 1.5, size=2)) for _ in range(count)]
    ).reshape(-1, 4, 4)


def _drifted(T, seed):
    moved = T.copy()
    moved[:, :3, 3] += np.random.default_rng(seed).normal(scale=0.05, size=(len(T), 3))
    return moved


def _answers(c):
    return c.classes, c.element, c.pose, c.est_index, c.gt_index


def _assert_same(a, b):
    for ours, theirs in zip(_answers(a), _answers(b), strict=True):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)


def _both(elements, est, gt, T_est, T_gt, **rules):
    rules = ViewRules(CAMERA, **rules)
    fast = associate_maps(elements, est, gt, T_est, T_gt, rules)
    _assert_same(fast, associate_maps(elements, est, gt, T_est, T_gt, rules, packets=False))
    return fast


@pytest.mark.parametrize("rules", RULES)
@pytest.mark.parametrize("choice", CHOICES)
def test_packets_give_the_bits_of_single_elements(choice, rules):
    est, gt = _field(cluttered_room(1)), _field(cluttered_room(2))
    T_gt = _poses(37, seed=3)
    c = _both(est.voxels.points[::3], est, gt, _drifted(T_gt, 4), T_gt, pose_choice=choice, **RULES[rules])
    if rules not in ("no tolerance",):
        assert len(c) > 100


@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize(("est_bytes", "gt_bytes"), [(0, 0), (0, 1 << 28), (1 << 28, 0)])
def test_fields_of_bricks(choice, est_bytes, gt_bytes):
    est, gt = _field(cluttered_room(1), dense_bytes=est_bytes), _field(cluttered_room(2), dense_bytes=gt_bytes)
    dense = _field(cluttered_room(1)), _field(cluttered_room(2))
    T_gt = _poses(20, seed=14)
    T_est, elements = _drifted(T_gt, 15), est.voxels.points[::3]
    c = _both(elements, est, gt, T_est, T_gt, pose_choice=choice)
    assert len(c) > 100
    _assert_same(c, associate_maps(elements, *dense, T_est, T_gt, ViewRules(CAMERA, pose_choice=choice)))


@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize("count", [1, 2, 15, 16, 17, 33])
def test_any_number_of_elements_and_poses(choice, count):
    est, gt = _field(cluttered_room(1)), _field(cluttered_room(2))
    T_gt = _poses(count, seed=count)
    chosen = np.random.default_rng(count).choice(len(est.voxels), count, replace=False)
    _both(est.voxels.points[chosen], est, gt, _drifted(T_gt, 1), T_gt, pose_choice=choice)


@pytest.mark.parametrize("choice", CHOICES)
def test_elements_in_disorder_repeated_between_voxels_and_outside_the_map(choice):
    est, gt = _field(cluttered_room(1)), _field(cluttered_room(2))
    rng = np.random.default_rng(5)
    points = est.voxels.points[rng.choice(len(est.voxels), 300)]
    stray = rng.uniform(-4, 7, size=(200, 3))
    elements = np.concatenate([points, points[:50], points[:80] + 0.5 * VOXEL, stray, [[300.0, -200.0, 90.0]]])
    T = _poses(20, seed=6)
    _both(rng.permutation(elements), est, gt, _drifted(T, 7), T, pose_choice=choice)


@pytest.mark.parametrize("choice", CHOICES)
def test_cameras_in_walls_on_elements_outside_the_map_and_far_away(choice):
    est, gt = _field(cluttered_room(1)), _field(cluttered_room(2))
    spots = [(0.0, 1.0, 0.5), (0.02, 0.98, 0.51), tuple(est.voxels.points[100]), (-3.0, 1.0, 0.7), (40.0, 1.2, 0.7)]
    T = np.stack([camera_pose(spot, yaw) for spot in spots for yaw in (0.0, 1.6, 3.14)])
    _both(est.voxels.points[::5], est, gt, T, T, pose_choice=choice)


@pytest.mark.parametrize("choice", CHOICES)
def test_equally_near_poses(choice):
    est, gt = _field(cluttered_room(1)), _field(cluttered_room(2))
    T = _poses(6, seed=8)[[0, 1, 0, 2, 1, 3, 3, 4, 0, 5, 5, 2, 4, 4, 1, 0, 0, 2, 3, 1]]
    c = _both(est.voxels.points[::4], est, gt, T, T, pose_choice=choice)
    if choice in ("nearest", "first"):
        assert set(np.unique(c.pose)) <= {0, 1, 3, 5, 7, 9}


@pytest.mark.parametrize("choice", CHOICES)
def test_far_from_the_grids_origin(choice):
    shift = np.array([410.0, -395.0, 130.0])
    est, gt = _field(cluttered_room(1) + shift), _field(cluttered_room(2) + shift)
    T = _poses(20, seed=9)
    T[:, :3, 3] += shift
    assert len(_both(est.voxels.points[::4], est, gt, _drifted(T, 1), T, pose_choice=choice)) > 100


@pytest.mark.parametrize("choice", CHOICES)
def test_one_thread_and_three_give_the_same(choice, monkeypatch):
    est, gt = _field(cluttered_room(1)), _field(cluttered_room(2))
    T = _poses(20, seed=10)
    answers = []
    for threads in ("1", "3"):
        monkeypatch.setenv("MAOMAPS_THREADS", threads)
        answers.append(associate_maps(est.voxels.points, est, gt, T, T, ViewRules(CAMERA, pose_choice=choice)))
    _assert_same(*answers)


def test_every_pose_of_a_chunk_too_large_for_its_memory(monkeypatch):
    est, gt = _field(cluttered_room(1)), _field(cluttered_room(2))
    T = _poses(20, seed=11)
    monkeypatch.setattr("maomaps_warp.scoring.association_packets._MOST_PAIRS", 1000)
    c = _both(est.voxels.points[::7], est, gt, T, T, pose_choice="all")
    order = np.lexsort((c.pose, c.element))
    np.testing.assert_array_equal(order, np.arange(len(c)))


def test_progress_is_told_to_the_end():
    est = _field(cluttered_room(1))
    T = _poses(3, seed=12)
    told = []
    associate_maps(est.voxels.points, est, est, T, T, ViewRules(CAMERA), progress=lambda *now: told.append(now))
    total = len(est.voxels)
    assert len(told) > 2
    assert [done for done, _ in told] == sorted({done for done, _ in told})
    assert told[-1] == (total, total)


@pytest.mark.parametrize("extent", [0.1, 5.0, 3e4])
def test_bricks_hold_every_element_once_in_a_small_box(extent):
    points = np.random.default_rng(13).uniform(-extent, extent, size=(1000, 3)).astype(np.float32)
    bricks = sort_into_bricks(tuple(points.T), VOXEL)
    np.testing.assert_array_equal(np.sort(bricks.order), np.arange(1000))
    np.testing.assert_array_equal(np.stack(bricks.columns, axis=1), points[bricks.order])
    assert bricks.first[0] == 0
    assert bricks.first[-1] == 1000
    assert (np.diff(bricks.first) > 0).all()
    low, high = (corner.reduceat(points[bricks.order], bricks.first[:-1]) for corner in (np.minimum, np.maximum))
    # Eight voxels, and what float32 rounds at this distance.
    assert (high - low).max() <= 8 * VOXEL + 1e-6 * extent
