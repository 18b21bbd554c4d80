"""Trajectory errors: against evo on real runs, against known motions, and by their symmetries."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_trajectory import pose, random_poses, read_euroc, read_kitti, read_tum
from shared_data import shared_data

from maomaps_warp.errors import InputError, NoScoreError
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.scoring.alignment import align
from maomaps_warp.scoring.stamps import match_stamps
from maomaps_warp.scoring.trajectory_errors import (
    absolute_trajectory_error,
    paper_rpe,
    relative_pose_error,
    rotation_angles,
)

GOLDEN = Path(__file__).parent / "golden"

#: metres or radians, absolute and relative: the agreement with evo that is promised.
EVO_TOLERANCE = 1e-6
#: evo's default --t_max_diff, seconds.
EVO_MAX_GAP_S = 0.01
#: metres or radians: rounding of a few float64 products of coordinates below 100 m.
ROUNDING = 1e-12
EVO_NAMES = ("rmse", "mean", "median", "std", "min", "max", "sse")


def read_pairs(golden: dict[str, Any], *, double_stamps: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Matched poses of a golden file's two trajectories, by the oracle's readers.

    evo holds stamps as doubles, whose rounding decides between equally near ones; so that the same poses are
    compared, ours are made from the same doubles.
    """
    gt_path, est_path = (
        shared_data(Path(golden[name]).parent.name) / Path(golden[name]).name for name in ("gt", "est")
    )
    if golden["format"] == "kitti":
        gt, est = Trajectory(read_kitti(gt_path)), Trajectory(read_kitti(est_path))
    else:
        read_gt = read_euroc if golden["format"] == "euroc" else read_tum
        gt = Trajectory(*read_gt(gt_path, double_stamps=double_stamps))
        est = Trajectory(*read_tum(est_path, double_stamps=double_stamps))
    matches = match_stamps(gt, est, method="nearest", max_gap_s=EVO_MAX_GAP_S)
    return matches.T_world_camera_gt, est.T_world_camera[matches.est_index]


def ours(entry: dict[str, Any], T_gt: np.ndarray, T_est: np.ndarray) -> Any:
    """The result that answers a golden entry."""
    T_est = align(entry["align"], T_gt, T_est).apply_poses(T_est)
    if entry["metric"] == "ape":
        return absolute_trajectory_error(T_gt, T_est)
    options = {key: entry[key] for key in ("delta", "unit", "all_pairs")}
    return relative_pose_error(T_gt, T_est, **options)


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("evo_*.json")), ids=lambda path: path.stem)
def test_every_statistic_of_ate_and_rpe_agrees_with_evo_on_a_real_run(path: Path) -> None:
    golden = json.loads(path.read_text())
    T_gt, T_est = read_pairs(golden)
    assert golden["results"]
    for entry in golden["results"]:
        result = ours(entry, T_gt, T_est)
        if entry["stats"] is None:  # evo found no motion that long
            assert result is None, entry
            continue
        assert result.pairs == entry["pairs"], entry
        statistics = getattr(result, entry["errors"])
        for name in EVO_NAMES:
            expected = pytest.approx(entry["stats"][name], rel=EVO_TOLERANCE, abs=EVO_TOLERANCE)
            assert getattr(statistics, name) == expected, (name, entry)


def test_the_golden_values_of_evo_are_there() -> None:
    assert len(list(GOLDEN.glob("evo_*.json"))) == 8


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("evo_*.json")), ids=lambda path: path.stem)
def test_stamps_to_the_nanosecond_move_the_rmse_by_less_than_the_tolerance(path: Path) -> None:
    golden = json.loads(path.read_text())
    T_gt, T_est = read_pairs(golden, double_stamps=False)
    for entry in golden["results"]:
        if entry["metric"] == "ape" or (entry["unit"] == "frames" and not entry["all_pairs"]):
            result = getattr(ours(entry, T_gt, T_est), entry["errors"])
            assert result.rmse == pytest.approx(entry["stats"]["rmse"], abs=EVO_TOLERANCE), entry


def test_a_tie_between_two_stamps_is_where_exact_stamps_and_doubles_part() -> None:
    golden = json.loads((GOLDEN / "evo_fr2_desk_orb.json").read_text())
    exact, _ = read_pairs(golden, double_stamps=False)
    doubles, _ = read_pairs(golden)
    assert np.count_nonzero(np.any(exact != doubles, axis=(1, 2))) == 1


def test_equal_trajectories_have_no_error() -> None:
    T = random_poses(np.random.default_rng(0), 20)
    ate = absolute_trajectory_error(T, T)
    rpe = relative_pose_error(T, T)
    assert rpe is not None
    assert ate.translation.max == 0.0
    assert ate.rotation.max < ROUNDING
    assert rpe.translation.max < ROUNDING
    assert rpe.rotation.max < ROUNDING


def test_ate_of_a_known_shift_and_turn_is_that_shift_and_turn() -> None:
    T_gt = random_poses(np.random.default_rng(1), 8)
    T_est = T_gt @ pose(0.0, 0.0, 0.0, yaw=0.25)
    T_est[:, :3, 3] += [3.0, 0.0, 4.0]
    ate = absolute_trajectory_error(T_gt, T_est)
    assert ate.pairs == 8
    np.testing.assert_allclose(ate.translation_errors, 5.0, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(ate.rotation_errors, 0.25, rtol=0, atol=ROUNDING)


def test_ate_is_the_root_mean_square_of_the_papers_formula() -> None:
    T_gt = np.stack([pose(0, 0, 0), pose(1, 0, 0)])
    T_est = np.stack([pose(0, 0, 1), pose(1, 7, 0)])
    assert absolute_trajectory_error(T_gt, T_est).translation.rmse == pytest.approx(np.sqrt((1 + 49) / 2))


def test_ate_without_pairs_is_no_score() -> None:
    with pytest.raises(NoScoreError, match="no pair"):
        absolute_trajectory_error(np.zeros((0, 4, 4)), np.zeros((0, 4, 4)))


def test_unequal_pose_counts_are_a_programming_mistake() -> None:
    with pytest.raises(ValueError, match=r"\(2, 4, 4\)"):
        absolute_trajectory_error(np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(4), (3, 1, 1)))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-3, 1.0, np.pi - 1e-8, np.pi - 1e-12, np.pi])
def test_rotation_angles_keep_their_digits_near_zero_and_pi(angle: float) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    R = np.eye(3) + np.sin(angle) * K + 2.0 * np.sin(angle / 2) ** 2 * (K @ K)  # Rodrigues
    assert rotation_angles(R[None])[0] == pytest.approx(angle, abs=1e-15)


def test_rpe_of_a_scaled_straight_drive_is_the_missing_length() -> None:
    T_gt = np.stack([pose(0.5 * i, 0, 0) for i in range(11)])
    T_est = np.stack([pose(0.55 * i, 0, 0) for i in range(11)])
    for delta, pairs in ((1, 10), (2, 5), (3, 3), (10, 1)):
        rpe = relative_pose_error(T_gt, T_est, delta=delta)
        assert rpe is not None
        assert rpe.pairs == pairs
        np.testing.assert_allclose(rpe.translation_errors, 0.05 * delta, rtol=0, atol=ROUNDING)


def test_all_pairs_of_frames_overlap() -> None:
    T = np.stack([pose(i, 0, 0) for i in range(6)])
    rpe = relative_pose_error(T, T, delta=2, all_pairs=True)
    assert rpe is not None
    np.testing.assert_array_equal(rpe.first, [0, 1, 2, 3])
    np.testing.assert_array_equal(rpe.second, [2, 3, 4, 5])


def test_metres_are_counted_along_the_ground_truth_and_begin_anew_at_every_end() -> None:
    x = [0, 2, 2.1, 2.2, 5, 5.6, 5.7, 6.1]
    T_gt = np.stack([pose(v, 0, 0) for v in x])
    T_est = np.stack([pose(100.0 * v, 0, 0) for v in x])
    rpe = relative_pose_error(T_gt, T_est, delta=1.0, unit="metres")
    assert rpe is not None
    np.testing.assert_array_equal(rpe.first, [0, 1, 4])
    np.testing.assert_array_equal(rpe.second, [1, 4, 7])


def test_a_motion_ends_where_the_path_reaches_delta_exactly() -> None:
    T = np.stack([pose(0.25 * i, 0, 0) for i in range(10)])
    rpe = relative_pose_error(T, T, delta=1.0, unit="metres")
    assert rpe is not None
    np.testing.assert_array_equal(rpe.second, [4, 8])


def test_all_pairs_in_metres_take_the_nearest_pose_within_a_tenth() -> None:
    T = np.stack([pose(v, 0, 0) for v in (0.0, 0.5, 0.95, 1.5, 1.5, 9.0)])
    rpe = relative_pose_error(T, T, delta=1.0, unit="metres", all_pairs=True)
    assert rpe is not None
    np.testing.assert_array_equal(rpe.first, [0, 1])  # 0.95 to 1.5 misses by 0.45, 1.5 to 9 by 6.5
    np.testing.assert_array_equal(rpe.second, [2, 3])  # of the two poses at 1.5 the first


def test_seconds_pair_with_the_nearest_stamp_and_leave_out_gaps() -> None:
    stamps = np.array([0, 500, 1040, 1500, 5000, 5980, 6020, 7000], dtype=np.int64) * 10**6
    T = np.stack([pose(i, 0, 0) for i in range(len(stamps))])
    rpe = relative_pose_error(T, T, stamps, delta=1.0, unit="seconds")
    assert rpe is not None
    # 5980 and 6020 are equally near to 6000: the earlier. From 1040 and 1500 there is nothing a second later.
    np.testing.assert_array_equal(rpe.first, [0, 4, 5])
    np.testing.assert_array_equal(rpe.second, [2, 5, 7])
    overlapping = relative_pose_error(T, T, stamps, delta=1.0, unit="seconds", all_pairs=True)
    assert overlapping is not None
    np.testing.assert_array_equal(overlapping.first, [0, 1, 4, 5, 6])
    np.testing.assert_array_equal(overlapping.second, [2, 3, 5, 7, 7])


@pytest.mark.parametrize("all_pairs", [False, True])
@pytest.mark.parametrize("unit", ["frames", "metres", "seconds"])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_short_a_run_has_no_rpe(unit: Any, all_pairs: bool, count: int) -> None:
    T = np.tile(np.eye(4), (count, 1, 1))
    stamps = np.arange(count, dtype=np.int64)
    assert relative_pose_error(T, T, stamps, delta=5, unit=unit, all_pairs=all_pairs) is None


@pytest.mark.parametrize("delta", [0, -1, float("nan"), float("inf"), 1.5])
def test_a_delta_that_is_no_number_of_frames_is_refused(delta: float) -> None:
    T = np.tile(np.eye(4), (3, 1, 1))
    with pytest.raises(InputError, match="delta"):
        relative_pose_error(T, T, delta=delta)


def test_seconds_without_stamps_are_refused_with_the_way_out() -> None:
    T = np.tile(np.eye(4), (3, 1, 1))
    with pytest.raises(InputError, match="frames or metres"):
        relative_pose_error(T, T, delta=1, unit="seconds")


def test_the_papers_rpe_is_its_formula_written_out() -> None:
    rng = np.random.default_rng(4)
    T_gt, T_est = random_poses(rng, 6), random_poses(rng, 6)
    squares = []
    for t in range(5):
        step_gt = np.linalg.inv(T_gt[t, :3, :3]) @ (T_gt[t + 1, :3, 3] - T_gt[t, :3, 3])
        step_est = np.linalg.inv(T_est[t, :3, :3]) @ (T_est[t + 1, :3, 3] - T_est[t, :3, 3])
        squares.append(((step_gt - step_est) ** 2).sum())
    result = paper_rpe(T_gt, T_est)
    assert result is not None
    assert result.count == 5
    assert result.rmse == pytest.approx(np.sqrt(np.mean(squares)), abs=ROUNDING)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_the_papers_rpe_is_the_fields_rpe_of_one_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_gt, T_est = random_poses(rng, 12), random_poses(rng, 12)
    paper, field = paper_rpe(T_gt, T_est), relative_pose_error(T_gt, T_est)
    assert paper is not None and field is not None
    assert paper.rmse == pytest.approx(field.translation.rmse, abs=ROUNDING)


def test_the_papers_rpe_of_one_pose_is_none() -> None:
    assert paper_rpe(np.eye(4)[None], np.eye(4)[None]) is None


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_errors_do_not_change_when_both_runs_move_together(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_gt, T_est = random_poses(rng, 15), random_poses(rng, 15)
    T = random_poses(rng, 1)[0]
    before, after = absolute_trajectory_error(T_gt, T_est), absolute_trajectory_error(T @ T_gt, T @ T_est)
    np.testing.assert_allclose(after.translation_errors, before.translation_errors, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(after.rotation_errors, before.rotation_errors, rtol=0, atol=ROUNDING)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_rpe_does_not_change_when_either_run_moves_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_gt, T_est = random_poses(rng, 15), random_poses(rng, 15)
    first, second = random_poses(rng, 2)
    before, after = relative_pose_error(T_gt, T_est), relative_pose_error(first @ T_gt, second @ T_est)
    assert before is not None and after is not None
    np.testing.assert_allclose(after.translation_errors, before.translation_errors, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(after.rotation_errors, before.rotation_errors, rtol=0, atol=ROUNDING)


def test_scoring_trajectories_does_not_import_warp() -> None:
    code = (
        "import sys, maomaps_warp.scoring.stamps, maomaps_warp.scoring.alignment, "
        "maomaps_warp.scoring.trajectory_errors; sys.exit('warp' in sys.modules or 'scipy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
