"""The original association program's results on real input, point by point, and the figures recorded beside them."""

from __future__ import annotations

import numpy as np
import pytest
from shared_data import shared_data, shared_reference

from maomaps_warp.io.sources import SourceOptions, open_original_directory, open_source
from maomaps_warp.mapping.cloud_map import octomap_leaves, voxelise
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.pipeline import score
from maomaps_warp.protocol import PRESETS
from maomaps_warp.protocol_files import with_overrides

#: Share of the original's correspondences that must be ours to the voxel.
IDENTICAL = 0.999
#: Agreement with the mean distance that the original prints, metres.
MEAN = 1e-3
#: Agreement with the independent figures of the corrected protocols (Embree, float32).
CORRECTED = 0.005

PRINTED = {
    ("abs", "nearest"): 0.957171,
    ("abs", "first"): 0.80582,
    ("abs", "last"): 0.9749,
    ("abs", "all"): 0.614386,
    ("rel", "nearest"): 0.839378,
}


def _scored(protocol_name, choice="nearest"):
    gt, est = open_original_directory(shared_reference("tum_fr1_rpy_a"), SourceOptions())
    protocol = with_overrides(PRESETS[protocol_name], {"pose_choice": choice}, "test")
    return score(gt, est, protocol, device="cpu")


def _in_voxel_halves(points):
    return [tuple(row) for row in np.rint(np.asarray(points, dtype=float) * 40).astype(int).tolist()]


@pytest.mark.parametrize("choice", ["nearest", "first", "last"])
def test_the_originals_correspondences_are_ours(choice):
    original = np.load(shared_reference("tum_fr1_rpy_a") / "original_outputs.npz")[f"abs_{choice}"]
    run = _scored("slam_comparison", choice)
    ours = dict(
        zip(
            _in_voxel_halves(run.correspondences.est()),
            _in_voxel_halves(run.correspondences.gt()),
            strict=True,
        )
    )
    theirs = zip(_in_voxel_halves(original[:, 3:]), _in_voxel_halves(original[:, :3]), strict=True)
    same = sum(ours.get(est) == gt for est, gt in theirs)
    assert same >= IDENTICAL * len(original)
    assert run.score.ame_ray.absolute.mean == pytest.approx(PRINTED["abs", choice], abs=MEAN)
    assert run.score.ame_ray.counts["occluded"] == pytest.approx(9993, abs=5)


@pytest.mark.parametrize(("points", "leaves"), [("gt_points.txt", "gt_leaves"), ("slam_points.txt", "est_leaves")])
def test_every_leaf_of_the_originals_octree_is_ours_and_no_other(points, leaves):
    folder = shared_reference("tum_fr1_rpy_a")
    in_float32 = np.loadtxt(folder / points, dtype=np.float32).astype(np.float64)
    ours = octomap_leaves(voxelise(in_float32, VoxelGrid.around(in_float32, 0.05, center_offset=0.5)))
    theirs = np.load(folder / "original_outputs.npz")[leaves]
    assert len(ours) == len(theirs)
    assert set(_in_voxel_halves(ours)) == set(_in_voxel_halves(theirs))


def test_the_originals_relative_correspondences_are_ours():
    original = np.load(shared_reference("tum_fr1_rpy_a") / "original_outputs.npz")["rel_nearest"]
    run = _scored("slam_comparison")
    c, poses = run.correspondences, run.poses

    def in_body(T, points):  # the original's camera frame: x forward, y left, z up
        p = np.einsum("nji,nj->ni", T[c.pose, :3, :3], points - T[c.pose, :3, 3])
        return np.stack([p[:, 2], -p[:, 0], -p[:, 1]], axis=1)

    ours = np.hstack([in_body(poses.T_world_camera_gt, c.gt()), in_body(poses.T_world_camera_est, c.est())])
    # The file holds six digits of a float: 1e-5 m. Rows are looked up by the rounded estimate's side.
    table = {tuple(np.round(row[3:], 3)): row for row in ours}
    same = 0
    for row in original.astype(float):
        keys = (tuple(np.round(row[3:] + d, 3)) for d in (0.0, 2e-5, -2e-5))
        found = next((table[k] for k in keys if k in table), None)
        same += found is not None and np.abs(found - row).max() < 1e-4
    assert same >= IDENTICAL * len(original)
    assert run.score.ame_ray.relative.mean == pytest.approx(PRINTED["rel", "nearest"], abs=MEAN)


@pytest.mark.slow
def test_the_mean_over_all_poses_is_the_originals():
    run = _scored("slam_comparison", "all")
    assert run.score.ame_ray.absolute.mean == pytest.approx(PRINTED["abs", "all"], abs=MEAN)
    assert len(run.correspondences) == pytest.approx(405625, rel=1e-3)


@pytest.mark.parametrize(
    ("protocol", "associated", "occluded", "no_gt", "rmse", "mean", "median", "p90"),
    [
        ("paper", 26115, 24187, 52, 1.1722, 0.6467, 0.3536, 1.2903),
        ("maomaps", 26115, 24187, 52, 1.0793, 0.5327, 0.2693, 1.1045),
    ],
)
def test_the_corrected_protocols_agree_with_the_independent_figures(
    protocol, associated, occluded, no_gt, rmse, mean, median, p90
):
    ray = _scored(protocol).score.ame_ray
    assert ray.counts["total"] == 50354
    assert ray.counts["associated"] == pytest.approx(associated, rel=CORRECTED)
    assert ray.counts["occluded"] == pytest.approx(occluded, rel=CORRECTED)
    assert ray.counts["no_ground_truth"] == pytest.approx(no_gt, abs=3)
    assert ray.counts["out_of_view"] == 0
    for name, expected in (("rmse", rmse), ("mean", mean), ("median", median), ("p90", p90)):
        assert getattr(ray.absolute, name) == pytest.approx(expected, rel=CORRECTED)


@pytest.mark.slow
def test_the_ground_truth_scored_against_itself():
    folder = shared_reference("tum_fr1_rpy_a")
    gt, _ = open_original_directory(folder, SourceOptions())
    ours, printed = (score(gt, gt, PRESETS[name], device="cpu").score.ame_ray for name in ("maomaps", "paper"))
    assert ours.absolute.max == 0.0
    assert ours.relative.max < 1e-12
    assert ours.counts["associated"] == pytest.approx(25250, rel=CORRECTED)
    assert printed.absolute.rmse == pytest.approx(0.2273, rel=CORRECTED)
    assert printed.absolute.mean == pytest.approx(0.1826, rel=CORRECTED)


#: The figures are given to four digits.
FOUR_DIGITS = 5e-5


def _assert_nearest_figures(nearest):
    for value, expected in (
        (nearest.accuracy.mean, 0.0555),
        (nearest.accuracy.median, 0.0),
        (nearest.accuracy.rmse, 0.1043),
        (nearest.accuracy.max, 0.7228),
        (nearest.completeness.mean, 0.0639),
        (nearest.overlap.iou, 0.3354),
    ):
        assert value == pytest.approx(expected, abs=FOUR_DIGITS)


def test_the_nearest_neighbour_figures_of_the_recorded_maps():
    _assert_nearest_figures(_scored("maomaps").score.ame_nn)


@pytest.mark.slow
def test_the_nearest_neighbour_figures_from_the_raw_frames():
    """The recipe beside the reference: frames, motion capture and odometry to maps, every second pixel."""
    folder = shared_data("rgbd_tum_fr1_rpy_a")
    gt = open_source(folder, SourceOptions(), "gt")
    est = open_source(folder, SourceOptions(), "est", trajectory_path=folder / "estimated_dvo.txt")
    recipe = {"align": "origin", "match": "nearest", "max_stamp_gap": 0.02, "pixel_stride": 2}
    run = score(gt, est, with_overrides(PRESETS["maomaps"], recipe, "test"), device="cpu")
    assert run.score.gt.facts["voxels"] == pytest.approx(56112, rel=1e-4)
    assert run.score.est.facts["voxels"] == pytest.approx(50354, rel=1e-4)
    _assert_nearest_figures(run.score.ame_nn)
