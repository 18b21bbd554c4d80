"""Alignment of an estimate with the ground truth."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_trajectory import pose, poses, random_poses, read_tum
from shared_data import shared_data

from maomaps_warp.errors import InputError
from maomaps_warp.model.alignment import Alignment
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.scoring.alignment import align
from maomaps_warp.scoring.trajectory_errors import absolute_trajectory_error

#: metres and matrix entries: rounding of a least-squares fit of coordinates below 100 m.
ROUNDING = 1e-10

#: Body (x forward, y left, z up) to optical camera (x right, y down, z forward) coordinates.
R_BODY_CAMERA = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])

seeds = st.integers(0, 2**32 - 1)


def body_poses(rows: list[tuple[float, float, float, float]]) -> np.ndarray:
    """Camera poses of a robot at x, y, z with a yaw."""
    T = np.stack([pose(*row) for row in rows])
    T[:, :3, :3] = T[:, :3, :3] @ R_BODY_CAMERA
    return T


def transformed(T: np.ndarray, R: np.ndarray, t: np.ndarray, scale: float = 1.0) -> np.ndarray:
    moved = T.copy()
    moved[:, :3, :3] = R @ T[:, :3, :3]
    moved[:, :3, 3] = scale * T[:, :3, 3] @ R.T + t
    return moved


def straight(count: int = 10) -> np.ndarray:
    return np.stack([pose(0.3 * i, 0.6 * i, -0.1 * i) for i in range(count)])


def static(count: int = 10) -> np.ndarray:
    return np.tile(pose(1e6, 2.0, 3.0), (count, 1, 1))


def vertical(count: int = 10) -> np.ndarray:
    return np.stack([pose(4.0, 5.0, 0.2 * i) for i in range(count)])


@given(seeds, st.floats(0.05, 20.0))
@settings(max_examples=40, deadline=None)
def test_sim3_recovers_a_known_similarity(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    est = random_poses(rng, 12)
    known = random_poses(rng, 1, spread=10.0)[0]
    gt = transformed(est, known[:3, :3], known[:3, 3], scale)
    found = align("sim3", gt, est)
    np.testing.assert_allclose(found.T_gt_est, known, rtol=0, atol=ROUNDING * max(1.0, scale))
    assert found.scale == pytest.approx(scale, rel=ROUNDING)
    assert found.pairs == 12
    np.testing.assert_allclose(found.apply_poses(est), gt, rtol=0, atol=ROUNDING * max(1.0, scale))


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_se3_recovers_a_known_motion_and_keeps_the_scale(seed: int) -> None:
    rng = np.random.default_rng(seed)
    est = random_poses(rng, 12)
    known = random_poses(rng, 1, spread=10.0)[0]
    found = align("se3", known @ est, est)
    np.testing.assert_allclose(found.T_gt_est, known, rtol=0, atol=ROUNDING)
    assert found.scale == 1.0


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_yaw_recovers_a_known_turn_about_the_vertical(seed: int) -> None:
    rng = np.random.default_rng(seed)
    est = random_poses(rng, 12)
    known = pose(*rng.normal(size=3), yaw=rng.uniform(-np.pi, np.pi))
    np.testing.assert_allclose(align("yaw", known @ est, est).T_gt_est, known, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("method", ["yaw", "se3", "sim3"])
def test_no_nearby_transform_fits_noisy_paths_better(method: Any) -> None:
    rng = np.random.default_rng(8)
    est, gt = random_poses(rng, 30), random_poses(rng, 30)
    gt[:, :3, 3] = est[:, :3, 3] + 0.3 * rng.normal(size=(30, 3))
    found = align(method, gt, est)

    def squared_error(T: np.ndarray, scale: float) -> float:
        moved = scale * est[:, :3, 3] @ T[:3, :3].T + T[:3, 3]
        return float(((moved - gt[:, :3, 3]) ** 2).sum())

    best = squared_error(found.T_gt_est, found.scale)
    for step in (1e-3, -1e-3):
        for axis in range(3):
            moved = found.T_gt_est.copy()
            moved[axis, 3] += step
            assert squared_error(moved, found.scale) > best
        for axis in (2,) if method == "yaw" else (0, 1, 2):
            quaternion = np.array([0.0, 0.0, 0.0, 1.0])
            quaternion[axis] = step
            turned = found.T_gt_est.copy()
            turned[:3, :3] = poses(np.zeros((1, 3)), quaternion[None])[0, :3, :3] @ turned[:3, :3]
            turned[:3, 3] += (found.T_gt_est - turned)[:3, :3] @ est[:, :3, 3].mean(axis=0) * found.scale
            assert squared_error(turned, found.scale) > best
        if method == "sim3":
            scaled = found.T_gt_est.copy()
            scaled[:3, 3] -= step * scaled[:3, :3] @ est[:, :3, 3].mean(axis=0)
            assert squared_error(scaled, found.scale + step) > best


def test_a_mirrored_path_still_gives_a_rotation() -> None:
    rng = np.random.default_rng(2)
    est = random_poses(rng, 20)
    gt = est.copy()
    gt[:, 2, 3] *= -1.0
    for method in ("se3", "sim3"):
        R = align(method, gt, est).T_gt_est[:3, :3]
        assert np.linalg.det(R) == pytest.approx(1.0, abs=ROUNDING)
        np.testing.assert_allclose(R @ R.T, np.eye(3), rtol=0, atol=ROUNDING)


def test_a_planar_path_is_enough_for_se3() -> None:
    rng = np.random.default_rng(5)
    est = random_poses(rng, 10)
    est[:, 2, 3] = 0.0
    known = random_poses(rng, 1)[0]
    np.testing.assert_allclose(align("se3", known @ est, est).T_gt_est, known, rtol=0, atol=ROUNDING)


def test_georeferenced_coordinates_lose_no_more_than_their_rounding() -> None:
    folder = shared_data("traj_evo")
    gt, _ = read_tum(folder / "georeferenced.tum")
    known = pose(-458_000.0, -5_429_000.0, -160.0, yaw=0.7)
    est = np.linalg.inv(known) @ gt
    moved = align("se3", gt, est).apply_poses(est)
    np.testing.assert_allclose(moved[:, :3, 3], gt[:, :3, 3], rtol=0, atol=1e-6)  # metres; coordinates of 5e6 m


def test_none_leaves_points_and_poses_as_they_are_bit_for_bit() -> None:
    T = random_poses(np.random.default_rng(0), 4)
    found = align("none", np.zeros((0, 4, 4)), np.zeros((0, 4, 4)))
    points, run = np.array([[0.1, -0.0, 1e-300]]), Trajectory(T)
    assert found.apply_points(points) is points
    assert found.apply_poses(T) is T
    assert found.apply_trajectory(run) is run


def test_origin_makes_the_first_poses_equal() -> None:
    rng = np.random.default_rng(6)
    gt, est = random_poses(rng, 5), random_poses(rng, 5)
    found = align("origin", gt, est)
    np.testing.assert_allclose(found.apply_poses(est)[0], gt[0], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(found.T_gt_est, gt[0] @ np.linalg.inv(est[0]), rtol=0, atol=ROUNDING)
    assert found.pairs == 1


def test_points_and_poses_move_alike_and_rotations_are_not_scaled() -> None:
    rng = np.random.default_rng(7)
    T = random_poses(rng, 6)
    run = Trajectory(T, np.arange(6), source="est.txt", notes=("a note",))
    alignment = Alignment("sim3", pose(1, 2, 3, yaw=0.4), scale=2.5, pairs=6)
    moved = alignment.apply_trajectory(run)
    np.testing.assert_allclose(moved.positions, alignment.apply_points(run.positions), rtol=0, atol=ROUNDING)
    by_hand = 2.5 * (pose(0, 0, 0, yaw=0.4)[:3, :3] @ run.positions[3]) + [1, 2, 3]
    np.testing.assert_allclose(moved.positions[3], by_hand, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(np.linalg.det(moved.T_world_camera[:, :3, :3]), 1.0, rtol=0, atol=ROUNDING)
    assert moved.source == "est.txt" and moved.notes == ("a note",)
    assert moved.stamps_ns is run.stamps_ns


def test_a_start_pose_file_turns_by_yaw_plus_pi_plus_correction_and_then_shifts() -> None:
    none = np.zeros((0, 4, 4))
    found = align("start-pose", none, none, start_pose=(1.0, 2.0, 3.0, 0.3), yaw_correction=-0.45)
    np.testing.assert_allclose(found.T_gt_est, pose(1, 2, 3, yaw=0.3 + math.pi - 0.45), rtol=0, atol=ROUNDING)
    # a point one metre ahead of the robot at start
    angle = 0.3 + math.pi - 0.45
    ahead = found.apply_points(np.array([[1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(ahead, [[1 + math.cos(angle), 2 + math.sin(angle), 3]], rtol=0, atol=ROUNDING)


def test_a_run_that_starts_at_its_worlds_zero_is_put_onto_the_first_ground_truth_pose() -> None:
    local = [(0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.1), (2.0, 0.5, 0.0, 0.4)]
    est = body_poses(local)
    gt = pose(4.0, -1.0, 1.5, yaw=2.2) @ est
    found = align("start-pose", gt, est)
    np.testing.assert_allclose(found.T_gt_est, pose(4.0, -1.0, 1.5, yaw=2.2), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(found.apply_poses(est), gt, rtol=0, atol=ROUNDING)
    turned = align("start-pose", gt, est, yaw_correction=0.5)
    np.testing.assert_allclose(turned.T_gt_est, pose(4.0, -1.0, 1.5, yaw=2.7), rtol=0, atol=ROUNDING)


def test_the_start_pose_file_and_the_first_pose_say_the_same() -> None:
    heading = 1.1
    gt = body_poses([(4.0, -1.0, 1.5, heading)])
    from_file = align("start-pose", gt, gt, start_pose=(4.0, -1.0, 1.5, heading - math.pi))
    np.testing.assert_allclose(from_file.T_gt_est, align("start-pose", gt, gt).T_gt_est, rtol=0, atol=ROUNDING)


def test_a_camera_that_tilts_at_start_only_gives_its_heading() -> None:
    gt = body_poses([(1.0, 1.0, 1.0, 0.8)])
    tilt = poses(np.zeros((1, 3)), np.array([[math.sin(0.3), 0, 0, math.cos(0.3)]]))[0]  # about the image's x
    np.testing.assert_allclose(
        align("start-pose", gt @ tilt, gt).T_gt_est, pose(1, 1, 1, yaw=0.8), rtol=0, atol=ROUNDING
    )


def test_a_camera_that_looks_straight_down_has_no_heading() -> None:
    gt = pose(0, 0, 2)[None].copy()
    gt[0, :3, :3] = np.diag([1.0, -1.0, -1.0])
    with pytest.raises(InputError, match="--align origin"):
        align("start-pose", gt, gt)


@pytest.mark.parametrize("method", ["se3", "sim3"])
@pytest.mark.parametrize(
    ("path", "reason"),
    [
        (straight(), "straight line"),
        (vertical(), "straight line"),
        (static(), "does not leave its place"),
        (straight(2), "it takes 3"),
        (straight(1), "it takes 3"),
    ],
    ids=["straight", "vertical", "static", "two poses", "one pose"],
)
def test_a_path_that_leaves_the_rotation_open_is_refused_with_a_way_out(
    method: Any, path: np.ndarray, reason: str
) -> None:
    curved = random_poses(np.random.default_rng(1), len(path))
    for gt, est in ((path, curved), (curved, path), (path, path)):
        with pytest.raises(InputError, match=f"--align {method}.*{reason}.*--align yaw, or --align origin"):
            align(method, gt, est)


def test_a_line_far_from_the_worlds_zero_is_still_a_line() -> None:
    path = straight()
    path[:, :3, 3] += [458_000.0, 5_429_000.0, 160.0]
    with pytest.raises(InputError, match="straight line"):
        align("se3", path, path)


@pytest.mark.parametrize("path", [vertical(), static(), straight(1)], ids=["vertical", "static", "one pose"])
def test_yaw_is_refused_where_the_path_does_not_move_in_the_plane(path: np.ndarray) -> None:
    curved = random_poses(np.random.default_rng(1), len(path))
    for gt, est in ((path, curved), (curved, path)):
        with pytest.raises(InputError, match=r"--align yaw.*--align origin"):
            align("yaw", gt, est)


def test_yaw_of_two_poses_on_a_line_is_determined() -> None:
    est = straight(2)
    known = pose(1, 2, 3, yaw=-2.0)
    np.testing.assert_allclose(align("yaw", known @ est, est).T_gt_est, known, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("method", ["origin", "start-pose", "yaw", "se3", "sim3"])
def test_without_any_pair_there_is_no_alignment(method: Any) -> None:
    with pytest.raises(InputError, match=f"--align {method}.*no pair"):
        align(method, np.zeros((0, 4, 4)), np.zeros((0, 4, 4)))


def test_unequal_pose_counts_and_unknown_methods_are_programming_mistakes() -> None:
    T = random_poses(np.random.default_rng(0), 3)
    with pytest.raises(ValueError, match=r"\(2, 4, 4\)"):
        align("se3", T, T[:2])
    with pytest.raises(ValueError, match="icp"):
        unknown: Any = "icp"
        align(unknown, T, T)


def test_alignment_is_never_worse_than_the_narrower_one_on_a_real_run() -> None:
    folder = shared_data("rgbd_tum_fr1_rpy_a")
    gt, gt_stamps = read_tum(folder / "groundtruth.txt")
    est, stamps = read_tum(folder / "estimated_dvo.txt")
    nearest = np.abs(gt_stamps[None, :] - stamps[:, None]).argmin(axis=1)
    rmse = [
        absolute_trajectory_error(gt[nearest], align(method, gt[nearest], est).apply_poses(est)).translation.rmse
        for method in ("sim3", "se3", "origin", "none")
    ]
    assert rmse == sorted(rmse)
    assert rmse[0] < rmse[1] < rmse[2]
