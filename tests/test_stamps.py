"""Pairing in time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_trajectory import pose, random_poses, read_tum
from scipy.spatial.transform import Rotation, Slerp
from shared_data import shared_data

from maomaps_warp.errors import InputError, NoScoreError
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.scoring.stamps import diagnose_stamps, match_stamps, poses_at

#: metres, and entries of a rotation matrix: rounding of a product of three rotations.
ROUNDING = 1e-12

SECOND = 10**9


def trajectory(seconds: list[float], source: str = "run") -> Trajectory:
    """Poses that move along x by a metre a second and turn by a tenth of a radian a second."""
    T = np.stack([pose(t, 0.0, 0.0, yaw=0.1 * t) for t in seconds])
    return Trajectory(T, np.array([round(t * SECOND) for t in seconds], dtype=np.int64), source)


def brute_force_nearest(among: np.ndarray, stamp: int) -> int:
    """The first of the smallest distances."""
    return int(min(range(len(among)), key=lambda i: (abs(int(among[i]) - int(stamp)), i)))


def test_interpolation_between_two_poses_is_linear_in_position_and_angle() -> None:
    matches = match_stamps(trajectory([0, 1]), trajectory([0.25]), method="interpolate", max_gap_s=1.0)
    np.testing.assert_allclose(matches.T_world_camera_gt[0], pose(0.25, 0, 0, yaw=0.025), rtol=0, atol=ROUNDING)
    assert matches.gt_index is None
    assert matches.gaps_ns.tolist() == [SECOND]
    assert matches.unmatched == 0
    assert matches.method == "interpolate"


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_interpolation_agrees_with_scipys_slerp_and_numpys_interp(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gt_stamps = np.cumsum(rng.integers(1, 10**8, 12))
    stamps = np.unique(rng.integers(gt_stamps[0], gt_stamps[-1], 20))
    gt = Trajectory(random_poses(rng, 12), gt_stamps)
    est = Trajectory(random_poses(rng, len(stamps)), stamps)
    matches = match_stamps(gt, est, method="interpolate", max_gap_s=0.1)
    T = matches.T_world_camera_gt
    slerp = Slerp(gt_stamps, Rotation.from_matrix(gt.T_world_camera[:, :3, :3]))
    np.testing.assert_allclose(T[:, :3, :3], slerp(stamps).as_matrix(), rtol=0, atol=1e-9)  # Slerp's own float time
    for axis in range(3):
        np.testing.assert_allclose(
            T[:, axis, 3], np.interp(stamps, gt_stamps, gt.positions[:, axis]), rtol=0, atol=1e-9
        )


@given(st.integers(0, 2**32 - 1), st.sampled_from(["interpolate", "nearest"]))
@settings(max_examples=30, deadline=None)
def test_a_pose_with_exactly_the_stamp_is_returned_bit_for_bit_without_any_gap(seed: int, method: str) -> None:
    rng = np.random.default_rng(seed)
    stamps = 1_700_000_000 * SECOND + np.cumsum(rng.integers(1, SECOND, 15))
    gt = Trajectory(random_poses(rng, 15), stamps)
    chosen = np.unique(rng.integers(0, 15, 6))
    est = Trajectory(random_poses(rng, len(chosen)), stamps[chosen])
    matches = match_stamps(gt, est, method=method, max_gap_s=0.0)
    np.testing.assert_array_equal(matches.T_world_camera_gt, gt.T_world_camera[chosen])
    np.testing.assert_array_equal(matches.gaps_ns, 0)
    assert matches.unmatched == 0


def test_nothing_is_extrapolated() -> None:
    matches = match_stamps(trajectory([1, 2]), trajectory([0.999, 1, 2, 2.001]), method="interpolate", max_gap_s=9)
    assert matches.est_index.tolist() == [1, 2]
    assert matches.unmatched == 2


def test_a_gap_in_the_ground_truth_is_bridged_up_to_the_limit_and_not_beyond() -> None:
    gt, est = trajectory([0, 1, 3, 3.5]), trajectory([0.5, 2, 3, 3.2])
    assert match_stamps(gt, est, method="interpolate", max_gap_s=1.0).est_index.tolist() == [0, 2, 3]
    assert match_stamps(gt, est, method="interpolate", max_gap_s=2.0).est_index.tolist() == [0, 1, 2, 3]
    assert match_stamps(gt, est, method="interpolate", max_gap_s=np.inf).unmatched == 0


def test_the_limit_of_nearest_is_inclusive_in_whole_nanoseconds() -> None:
    gt = Trajectory(np.eye(4)[None], np.array([1_305_031_102_000_000_000]))
    at = Trajectory(np.tile(np.eye(4), (2, 1, 1)), gt.stamps_ns[0] + np.array([10_000_000, 10_000_001]))
    assert match_stamps(gt, at.select(np.array([0])), method="nearest", max_gap_s=0.01).gaps_ns.tolist() == [10**7]
    with pytest.raises(NoScoreError):
        match_stamps(gt, at.select(np.array([1])), method="nearest", max_gap_s=0.01)


def test_of_two_equally_near_stamps_the_earlier_is_taken() -> None:
    matches = match_stamps(trajectory([1, 3]), trajectory([2]), method="nearest", max_gap_s=1.0)
    assert matches.gt_index is not None
    assert matches.gt_index.tolist() == [0]


def test_equally_many_poses_iterate_the_estimate_and_may_share_a_partner() -> None:
    matches = match_stamps(trajectory([0, 5, 9]), trajectory([4, 5, 6]), method="nearest", max_gap_s=1.0)
    assert matches.gt_index is not None
    assert matches.est_index.tolist() == [0, 1, 2]
    assert matches.gt_index.tolist() == [1, 1, 1]


def test_a_shorter_ground_truth_is_iterated_and_the_rest_of_the_estimate_is_unmatched() -> None:
    matches = match_stamps(trajectory([4, 6]), trajectory([0, 5, 9]), method="nearest", max_gap_s=1.0)
    assert matches.gt_index is not None
    assert matches.est_index.tolist() == [1, 1]
    assert matches.gt_index.tolist() == [0, 1]
    assert matches.unmatched == 2


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_nearest_agrees_with_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gt_stamps = np.unique(rng.integers(0, 60, rng.integers(1, 25)))  # dense: ties and shared partners abound
    stamps = np.unique(rng.integers(0, 60, rng.integers(1, 25)))
    gt, est = (Trajectory(random_poses(rng, len(s)), s) for s in (gt_stamps, stamps))
    if len(stamps) <= len(gt_stamps):
        pairs = [(i, brute_force_nearest(gt_stamps, s)) for i, s in enumerate(stamps)]
    else:
        pairs = [(brute_force_nearest(stamps, s), j) for j, s in enumerate(gt_stamps)]
    expected = [(i, j) for i, j in pairs if abs(int(stamps[i]) - int(gt_stamps[j])) <= 2]
    if not expected:
        with pytest.raises(NoScoreError):
            match_stamps(gt, est, method="nearest", max_gap_s=2e-9)
        return
    matches = match_stamps(gt, est, method="nearest", max_gap_s=2e-9)
    assert matches.gt_index is not None
    assert list(zip(matches.est_index.tolist(), matches.gt_index.tolist(), strict=True)) == expected
    assert np.all(np.diff(matches.est_index) >= 0)
    assert matches.unmatched == len(stamps) - len({i for i, _ in expected})
    np.testing.assert_array_equal(matches.T_world_camera_gt, gt.T_world_camera[matches.gt_index])


@pytest.mark.parametrize(("method", "places"), [("interpolate", [0, 0.25]), ("nearest", [0, 0, 1, 1])])
def test_poses_at_stamps_tells_which_stamps_have_one(method: str, places: list[float]) -> None:
    run = trajectory([0, 1, 5])
    stamps = np.array([0.0, 0.25, 1.25, 1.5, 3.0]) * SECOND
    found, T = poses_at(
        run, stamps.astype(np.int64), method=method, max_gap_s={"interpolate": 1, "nearest": 0.5}[method]
    )
    assert found.tolist() == list(range(len(places)))
    np.testing.assert_allclose(T[:, 0, 3], places, rtol=0, atol=ROUNDING)


def test_the_offset_is_added_to_the_estimates_stamps() -> None:
    matches = match_stamps(
        trajectory([10, 11]), trajectory([0.5]), method="interpolate", max_gap_s=1.0, t_offset_s=10.0
    )
    np.testing.assert_allclose(matches.T_world_camera_gt[0, :3, 3], [10.5, 0, 0], rtol=0, atol=ROUNDING)


def test_without_stamps_poses_pair_by_index() -> None:
    gt, est = trajectory([0, 1]), trajectory([5, 6])
    matches = match_stamps(Trajectory(gt.T_world_camera), est, method="interpolate", max_gap_s=0.1)
    assert matches.method == "index"
    assert matches.est_index.tolist() == [0, 1]
    np.testing.assert_array_equal(matches.T_world_camera_gt, gt.T_world_camera)


def test_without_stamps_unequal_counts_are_refused_with_both_of_them() -> None:
    gt, est = trajectory([0, 1, 2]), trajectory([0, 1])
    with pytest.raises(InputError, match=r"kitti.txt.*3 ground-truth and 2 estimated"):
        match_stamps(gt, Trajectory(est.T_world_camera, source="kitti.txt"), method="nearest", max_gap_s=1.0)


def test_an_offset_without_stamps_is_refused() -> None:
    bare = Trajectory(trajectory([0, 1]).T_world_camera)
    with pytest.raises(InputError, match="--t-offset"):
        match_stamps(bare, bare, method="nearest", max_gap_s=1.0, t_offset_s=1.0)


@pytest.mark.parametrize("gap", [-0.1, float("nan")])
def test_a_gap_limit_that_is_no_time_is_refused(gap: float) -> None:
    with pytest.raises(InputError, match="--max-stamp-gap"):
        match_stamps(trajectory([0]), trajectory([0]), method="nearest", max_gap_s=gap)


@pytest.mark.parametrize("offset", [float("nan"), float("inf"), 1e11])
def test_an_offset_that_int64_nanoseconds_cannot_hold_is_refused(offset: float) -> None:
    with pytest.raises(InputError, match="--t-offset"):
        match_stamps(trajectory([0]), trajectory([0]), method="nearest", max_gap_s=1, t_offset_s=offset)


def test_a_trajectory_without_poses_is_no_score_and_is_named() -> None:
    empty = Trajectory(np.zeros((0, 4, 4)), np.zeros(0, np.int64), "empty.txt")
    with pytest.raises(NoScoreError, match=r"empty.txt"):
        match_stamps(trajectory([0]), empty, method="nearest", max_gap_s=1.0)


def test_ranges_apart_are_named_with_the_offset_that_makes_them_fit() -> None:
    rng = np.random.default_rng(3)
    stamps = 1_305_031_102 * SECOND + np.cumsum(rng.integers(8_000_000, 12_000_000, 3000))
    gt = Trajectory(random_poses(rng, 3000), stamps, "gt.txt")
    # every third pose of the middle, on a clock that is 3600.25 s late
    est = Trajectory(random_poses(rng, 500), stamps[600:2100:3] + 3_600_250_000_000, "est.txt")
    with pytest.raises(NoScoreError) as caught:
        match_stamps(gt, est, method="nearest", max_gap_s=0.01)
    message = str(caught.value)
    assert "est.txt" in message and "gt.txt" in message
    assert f"{stamps[0] // SECOND}.{stamps[0] % SECOND:09d}" in message
    assert "> 10 s: 500" in message
    assert "--t-offset -3600.25" in message
    found = diagnose_stamps(gt, est, method="nearest", max_gap_s=0.01)
    assert found.best_offset_s == pytest.approx(-3600.25, abs=1e-9)
    assert found.matches == 0
    assert found.matches_at_best_offset == 500
    assert found.best_offset_is_certain
    again = match_stamps(gt, est, method="nearest", max_gap_s=0.01, t_offset_s=found.best_offset_s)
    assert again.unmatched == 0


def test_the_best_offset_of_a_jittered_real_run_is_found_on_top_of_the_one_given() -> None:
    folder = shared_data("traj_evo")
    gt = Trajectory(*read_tum(folder / "freiburg1_xyz-groundtruth.txt"))
    T, stamps = read_tum(folder / "freiburg1_xyz-rgbdslam.txt")
    est = Trajectory(T, stamps - 500 * SECOND)
    found = diagnose_stamps(gt, est, method="nearest", max_gap_s=0.01, t_offset_s=7.0)
    aligned = match_stamps(gt, Trajectory(T, stamps), method="nearest", max_gap_s=0.01)
    assert found.matches == 0
    assert found.matches_at_best_offset >= len(aligned)
    assert not found.best_offset_is_certain  # 30 Hz frames among 100 Hz poses fit at many offsets
    assert "others fit as well" in str(found)
    matches = match_stamps(gt, est, method="nearest", max_gap_s=0.01, t_offset_s=found.best_offset_s)
    assert len(matches) == found.matches_at_best_offset


@pytest.mark.parametrize("method", ["interpolate", "nearest"])
def test_a_ground_truth_that_is_too_sparse_is_told_with_a_limit_that_works(method: str) -> None:
    gt, est = trajectory([0, 1, 2, 3]), trajectory([0.4, 1.4, 2.4])
    with pytest.raises(NoScoreError, match="--max-stamp-gap"):
        match_stamps(gt, est, method=method, max_gap_s=0.1)
    hint = diagnose_stamps(gt, est, method=method, max_gap_s=0.1).hints
    limit = float(next(h for h in hint if h.startswith("--max-stamp-gap")).split()[1])
    assert limit == pytest.approx({"interpolate": 1.0, "nearest": 0.4}[method])
    assert len(match_stamps(gt, est, method=method, max_gap_s=limit)) >= 2


def test_nearest_is_suggested_where_only_interpolation_fails() -> None:
    gt, est = trajectory([0, 1, 2]), trajectory([0.995, 2.004])
    hints = diagnose_stamps(gt, est, method="interpolate", max_gap_s=0.01).hints
    assert "--match nearest" in hints


def test_nothing_is_suggested_where_everything_matches() -> None:
    found = diagnose_stamps(trajectory([0, 1, 2]), trajectory([0.5]), method="interpolate", max_gap_s=1.0)
    assert found.hints == ()
    assert found.best_offset_s == 0.0
    assert found.matches == found.matches_at_best_offset == 1


def test_the_histogram_of_gaps_counts_every_estimated_stamp_once() -> None:
    gt, est = trajectory([0]), trajectory([0.0005, 0.001, 0.005, 0.05, 0.5, 5, 50, 500])
    found = diagnose_stamps(gt, est, method="nearest", max_gap_s=1.0)
    assert [count for _, count in found.gap_histogram] == [2, 1, 1, 1, 1, 2]
