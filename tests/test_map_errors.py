"""Precision, recall, F-score and voxel overlap."""

from __future__ import annotations

import numpy as np
import pytest

from maomaps_warp.mapping.cloud_map import voxelise
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.scoring.map_errors import distances_both_ways, threshold_scores, voxel_overlap

GRID = VoxelGrid(0.05, np.zeros(3, dtype=np.int64))


def test_a_shift_by_one_voxel_is_measured_both_ways(device):
    gt = np.array([[0.05 * i, 0, 0] for i in range(10)])
    est = gt + [0, 0, 0.05]
    accuracy, completeness = distances_both_ways(est, gt, device)
    np.testing.assert_allclose(accuracy, 0.05, rtol=0, atol=1e-12)
    np.testing.assert_allclose(completeness, 0.05, rtol=0, atol=1e-12)


def test_a_missing_half_shows_in_the_completeness_alone(device):
    gt = np.array([[1.0 * i, 0, 0] for i in range(4)])
    accuracy, completeness = distances_both_ways(gt[:2], gt, device)
    assert accuracy.tolist() == [0, 0]
    assert completeness.tolist() == [0, 0, 1, 2]


def test_a_distance_of_exactly_the_threshold_is_not_within_it_whatever_the_rounding():
    # 0.05-voxel neighbours at large coordinates: the float64 differences scatter around 0.05.
    k = np.arange(0, 4000, 7)
    distances = (k + 1) * 0.05 - k * 0.05
    assert len(np.unique(distances)) > 1
    score, beyond = threshold_scores(distances, distances, (0.05, 0.0501))
    assert (score.precision, score.recall, score.f_score) == (0.0, 0.0, 0.0)
    assert beyond.f_score == 1.0


def test_georeferenced_maps_decide_the_threshold_as_others_do(device):
    northing = np.array([[0.0, 8_400_000.0, 0.0]])
    k = np.arange(200)[:, None] * np.array([[0.05, 0.05, 0.0]])
    accuracy, completeness = distances_both_ways(northing + k + [0, 0.05, 0], northing + k, device)
    score, beyond = threshold_scores(accuracy, completeness, (0.05, 0.0501))
    assert score.precision < 0.05
    assert beyond.precision == 1.0


def test_the_f_score_is_the_harmonic_mean():
    (score,) = threshold_scores(np.array([0.0, 1.0]), np.array([0.0, 0.0, 0.0, 1.0]), (0.5,))
    assert (score.precision, score.recall) == (0.5, 0.75)
    assert score.f_score == pytest.approx(2 * 0.5 * 0.75 / 1.25)


def test_overlap_counts_common_cells():
    gt = voxelise(np.array([[0.05 * i, 0, 0] for i in range(10)]), GRID)
    est = voxelise(np.array([[0.05 * i, 0, 0] for i in range(6, 18)]), GRID)
    overlap = voxel_overlap(est, gt)
    assert (overlap.est, overlap.gt, overlap.common) == (12, 10, 4)
    assert overlap.iou == pytest.approx(4 / 18)


def test_maps_on_different_grids_are_a_programming_mistake():
    other = VoxelGrid(0.1, np.zeros(3, dtype=np.int64))
    with pytest.raises(ValueError, match="one grid"):
        voxel_overlap(voxelise(np.zeros((1, 3)), GRID), voxelise(np.zeros((1, 3)), other))
