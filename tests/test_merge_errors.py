"""Errors of merges: transforms and maps with known answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from merge_samples import SEEN, corridor, move, pose
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from maomaps_warp.errors import InputError
from maomaps_warp.model.merge_results import MergedMapScore, SuccessRule, TransformError
from maomaps_warp.model.occupancy import Cell, OccupancyGrid
from maomaps_warp.model.results import NoValue
from maomaps_warp.scoring.merge_errors import lattice_note, merged_ground_truth, merged_map_score
from maomaps_warp.scoring.merge_fit import best_rigid, fit_merged
from maomaps_warp.scoring.merge_transforms import (
    first_placement,
    judge,
    moved_grid,
    reference_of,
    rotation_angle,
    start_placement,
    transform_errors,
    with_true_heights,
)

#: Rounding of products of 4x4 matrices, metres and radians.
EXACT = 1e-12
VOXEL = 0.05
TRUE = [pose(0.5, 1.0, 0.4, 0.3), pose(2.5, 0.75, 0.7, -2.0), pose(3.6, 1.2, 0.4, 1.2)]


def in_first(T_true):
    return [np.linalg.inv(T_true[0]) @ T for T in T_true]


# Transforms


def test_exact_transforms_have_no_error_whatever_the_merged_frame():
    elsewhere = pose(7.0, -3.0, 1.0, 2.2)
    reference, *others = transform_errors(TRUE, [elsewhere @ T for T in TRUE], is_planar=False)
    assert isinstance(reference, NoValue) and not reference.asked
    for error in others:
        assert isinstance(error, TransformError)
        assert error.translation == pytest.approx(0.0, abs=EXACT)
        assert error.rotation == pytest.approx(0.0, abs=EXACT)


def test_a_shift_and_a_turn_of_a_source_are_its_errors():
    merged = in_first(TRUE)
    merged[1] = merged[1] @ pose(0.3, 0.0, 0.0, math.radians(5.0))
    _, second, third = transform_errors(TRUE, merged, is_planar=False)
    assert isinstance(second, TransformError) and isinstance(third, TransformError)
    assert second.translation == pytest.approx(0.3, abs=EXACT)
    assert math.degrees(second.rotation) == pytest.approx(5.0, abs=1e-9)
    assert third.translation == pytest.approx(0.0, abs=EXACT)


def test_the_first_merged_source_is_the_reference():
    merged = [None, *in_first(TRUE)[1:]]
    assert reference_of(merged) == 1
    first, second, third = transform_errors(TRUE, merged, is_planar=False)
    assert isinstance(first, NoValue) and first.asked and first.reason == "not merged"
    assert isinstance(second, NoValue) and not second.asked
    assert isinstance(third, TransformError) and third.translation == pytest.approx(0.0, abs=EXACT)
    assert reference_of([None, None]) is None


def test_transforms_of_the_plane_are_compared_in_the_plane():
    flat = [pose(T[0, 3], T[1, 3], 0.0, math.atan2(T[1, 0], T[0, 0])) for T in in_first(TRUE)]
    _, second, _ = transform_errors(TRUE, flat, is_planar=True)
    assert isinstance(second, TransformError) and second.is_planar
    assert second.translation == pytest.approx(0.0, abs=EXACT)
    in_space = transform_errors(TRUE, flat, is_planar=False)[1]
    assert isinstance(in_space, TransformError) and in_space.translation == pytest.approx(0.3, abs=EXACT)  # the height


def test_heights_of_transforms_of_the_plane_come_from_the_truth():
    flat = [pose(T[0, 3], T[1, 3], 0.0, math.atan2(T[1, 0], T[0, 0])) for T in in_first(TRUE)]
    lifted = with_true_heights(TRUE, [*flat[:2], None], TRUE[0])
    assert lifted[2] is None
    for found, wanted in zip(lifted[:2], in_first(TRUE)[:2], strict=True):
        assert found is not None
        np.testing.assert_allclose(found, wanted, rtol=0, atol=EXACT)


def test_a_start_pose_is_read_by_the_rule_of_the_data_set():
    np.testing.assert_allclose(
        start_placement((1.0, 2.0, 3.0, 0.25 - math.pi), 0.5), pose(1, 2, 3, 0.75), rtol=0, atol=EXACT
    )


def test_the_first_merged_source_comes_to_where_its_run_began():
    elsewhere = pose(7.0, -3.0, 1.0, 2.2)
    T = first_placement(TRUE, [None, elsewhere @ TRUE[1], elsewhere])
    np.testing.assert_allclose(T @ elsewhere @ TRUE[1], TRUE[1], rtol=0, atol=EXACT)
    np.testing.assert_array_equal(first_placement(TRUE, None), TRUE[0])
    np.testing.assert_array_equal(first_placement(TRUE, [None] * 3), TRUE[0])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, math.pi - 1e-9, math.pi])
def test_angles_are_exact_at_both_ends(angle):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_matrix()
    assert rotation_angle(T) == pytest.approx(angle, abs=1e-14)


def test_a_grid_moves_with_the_merged_frame():
    cells = np.full((3, 4), Cell.FREE, dtype=np.uint8)
    cells[2, 1] = Cell.OCCUPIED
    grid = OccupancyGrid(cells, 0.5, (1.0, -2.0, 0.4))
    T = pose(3.0, 4.0, 9.0, 3.0)
    before, after = grid.centers(cells == Cell.OCCUPIED), moved_grid(T, grid).centers(cells == Cell.OCCUPIED)
    np.testing.assert_allclose(after, before @ T[:2, :2].T + T[:2, 3], rtol=0, atol=EXACT)


# Success

GOOD = TransformError(0.2, math.radians(2.0), False)


@pytest.mark.parametrize(
    ("errors", "ame", "rule", "expected", "words"),
    [
        ([NoValue("", False), GOOD], 0.1, SuccessRule(), True, "within 1 m and 10 deg"),
        ([NoValue("", False), GOOD], 0.1, SuccessRule(max_m=0.1), False, "second is 0.2 m and 2 deg off"),
        ([NoValue("", False), GOOD], 0.1, SuccessRule(max_rad=0.01), False, "second is 0.2 m and 2 deg off"),
        ([NoValue("", False), NoValue("not merged", True)], 0.1, SuccessRule(), False, "second was not merged"),
        ([NoValue("", False), GOOD], 0.1, SuccessRule(max_ame=0.05), False, "its AME is 0.1 m"),
        ([NoValue("", False), GOOD], None, SuccessRule(max_ame=0.05), False, "there is no AME"),
        (None, 0.1, SuccessRule(), None, "cannot be told"),
        (None, 0.1, SuccessRule(max_ame=0.2), True, "within an AME of 0.2 m"),
    ],
)
def test_success_is_judged_by_the_rule_and_says_why(errors, ame, rule, expected, words):
    is_success, verdict = judge(("first", "second"), errors, rule, ame)
    assert is_success is expected
    assert words in verdict


def test_an_error_of_exactly_the_limit_is_a_success():
    assert judge(("a", "b"), [NoValue("", False), TransformError(1.0, 0.0, False)], SuccessRule(1.0), None)[0] is True


# Maps


def worlds(runs: int) -> list[np.ndarray]:
    return [corridor(*SEEN[i]) * VOXEL for i in range(runs)]


def ground_truth(clouds: list[np.ndarray]):
    merged = np.unique(np.round(np.concatenate(clouds) / VOXEL), axis=0) * VOXEL
    return merged, merged_ground_truth(merged, clouds, VOXEL, "here")


def scored(points, gt) -> MergedMapScore:
    return merged_map_score(points, gt, wall_distance=0.5)


def test_a_perfect_map_has_no_error_and_knows_the_overlap():
    clouds = worlds(2)
    merged, gt = ground_truth(clouds)
    score = scored(np.concatenate(clouds), gt)
    assert (score.accuracy.max, score.completeness.max) == (0.0, 0.0)
    common = len({*map(tuple, corridor(*SEEN[0]).tolist())} & {*map(tuple, corridor(*SEEN[1]).tolist())})
    assert score.counts["gt_overlap"] == common
    assert score.counts["gt_one_run"] == len(merged) - common
    assert score.counts["inside_overlap"] == 2 * common  # both sources hold it
    assert score.counts["inside_overlap"] + score.counts["outside_overlap"] == score.counts["est_points"]


def test_errors_inside_and_outside_the_overlap_agree_with_brute_force():
    rng = np.random.default_rng(1)
    clouds = worlds(3)
    merged, gt = ground_truth(clouds)
    points = np.concatenate([clouds[0], move(pose(0.13, 0.02, 0.01, 0.03), clouds[1]), clouds[2]])
    points = points + rng.normal(0.0, 0.01, points.shape)
    score = scored(points, gt)
    distance, nearest = cKDTree(merged).query(points)
    seen = sum(cKDTree(cloud).query(merged)[0] < 1e-6 for cloud in clouds)
    inside = seen[nearest] >= 2
    for found, wanted in (
        (score.accuracy, distance),
        (score.inside, distance[inside]),
        (score.outside, distance[~inside]),
    ):
        assert not isinstance(found, NoValue)
        assert found.count == len(wanted)
        assert found.mean == pytest.approx(wanted.mean(), abs=1e-12)
        assert found.rmse == pytest.approx(math.sqrt((wanted**2).mean()), abs=1e-12)
    assert score.completeness.mean == pytest.approx(cKDTree(points).query(merged)[0].mean(), abs=1e-12)


def test_maps_that_do_not_overlap_have_nothing_inside():
    clouds = [corridor(0, 30) * VOXEL, corridor(60, 100) * VOXEL]
    score = scored(np.concatenate(clouds), ground_truth(clouds)[1])
    assert score.counts["gt_overlap"] == 0 and score.counts["outside_overlap"] == score.counts["est_points"]
    for part in (score.inside, score.doubled):
        assert isinstance(part, NoValue) and not part.asked and "do not overlap" in part.reason
    assert not isinstance(score.outside, NoValue) and score.outside.max == 0.0


def test_a_merge_that_never_enters_the_overlap_has_no_value_there():
    clouds = worlds(2)
    score = scored(corridor(0, 20) * VOXEL, ground_truth(clouds)[1])
    assert isinstance(score.inside, NoValue) and "no point" in score.inside.reason
    everything = scored(corridor(35, 45) * VOXEL, ground_truth(clouds)[1])
    assert isinstance(everything.outside, NoValue) and "every point" in everything.outside.reason


def test_elements_of_no_run_are_counted():
    clouds = worlds(2)
    gt = merged_ground_truth(np.concatenate([clouds[0], [[9.0, 9.0, 9.0]]]), clouds, VOXEL, "here")
    assert scored(clouds[0], gt).counts["gt_no_run"] == 1


def test_a_point_beyond_the_reach_of_the_lattice_is_refused():
    clouds = worlds(2)
    with pytest.raises(InputError, match="point 1 "):
        scored(np.array([[1e7, 0.0, 0.0]]), ground_truth(clouds)[1])


def test_maps_on_another_lattice_are_told_of():
    cloud = worlds(1)[0]
    assert lattice_note(cloud, VOXEL) is None
    assert "--voxel-size 0.1" in (lattice_note(2 * cloud, VOXEL) or "")
    assert f"{len(cloud)} of {len(cloud)}" in (lattice_note(cloud + 0.02, VOXEL) or "")


# The best alignment

#: How near registration comes on two samplings of one surface, metres.
FIT_M = 1e-3


def test_the_best_alignment_undoes_a_shift_and_says_what_it_hides():
    pytest.importorskip("small_gicp")
    cloud = worlds(1)[0]
    T_wrong = pose(0.2, 0.1, 0.05, math.radians(3.0))
    points = move(T_wrong, cloud)
    T, fit = fit_merged(points, cloud, VOXEL)
    np.testing.assert_allclose(move(T, points), cloud, rtol=0, atol=FIT_M)
    assert fit.ame_before == pytest.approx(cKDTree(cloud).query(points)[0].mean(), abs=1e-9)
    assert fit.ame_after < FIT_M
    assert fit.hidden == fit.ame_before - fit.ame_after
    assert math.degrees(fit.rotation) == pytest.approx(3.0, abs=0.05)
    middle = points.mean(axis=0)
    assert fit.translation == pytest.approx(
        np.linalg.norm(move(np.linalg.inv(T_wrong), middle[None]) - middle), abs=FIT_M
    )


def test_a_fit_that_helps_nothing_is_not_taken():
    pytest.importorskip("small_gicp")
    cloud = worlds(1)[0]
    T, fit = fit_merged(cloud, cloud, VOXEL)
    np.testing.assert_array_equal(T, np.eye(4))
    assert (fit.hidden, fit.translation, fit.rotation) == (0.0, 0.0, 0.0)


def test_far_from_zero_the_fit_is_as_good():
    pytest.importorskip("small_gicp")
    far = np.array([500_000.0, 6_000_000.0, 100.0])
    cloud = worlds(1)[0] + far
    T = best_rigid(cloud + [0.2, 0.1, 0.05], cloud, VOXEL)
    np.testing.assert_allclose(move(T, cloud + [0.2, 0.1, 0.05]), cloud, rtol=0, atol=FIT_M)


def test_a_few_points_determine_no_transform():
    pytest.importorskip("small_gicp")
    with pytest.raises(InputError, match="--align first"):
        best_rigid(np.zeros((5, 3)), worlds(1)[0], VOXEL)


def test_a_missing_registration_library_is_named_with_the_way_to_install_it(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "small_gicp", None)
    with pytest.raises(InputError, match=r"pip install 'maomaps-warp\[merge\]'"):
        best_rigid(worlds(1)[0], worlds(1)[0], VOXEL)
