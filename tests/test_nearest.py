"""Exact nearest neighbours, against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import nearest_distances

from maomaps_warp.scoring.nearest import nearest_neighbours

#: Rounding of float64 differences, metres per metre of coordinate.
FLOAT64 = 1e-15


def _check(queries, points, device):
    index, distance = nearest_neighbours(queries, points, device)
    largest = np.abs(np.concatenate([queries, points])).max()
    np.testing.assert_allclose(distance, nearest_distances(queries, points), rtol=0, atol=FLOAT64 * (1 + largest))
    np.testing.assert_allclose(distance, np.linalg.norm(queries - points[index], axis=1))


def test_two_random_clouds(device):
    rng = np.random.default_rng(0)
    _check(rng.normal(size=(700, 3)), rng.normal(size=(1500, 3)), device)


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9, 17, 33])
def test_few_points(device, count):
    rng = np.random.default_rng(count)
    _check(rng.uniform(size=(50, 3)), rng.uniform(size=(count, 3)), device)


@pytest.mark.parametrize("apart", [0.5, 10.0, 5000.0])
def test_clouds_apart_have_no_cut_off(device, apart):
    rng = np.random.default_rng(1)
    _check(rng.uniform(size=(100, 3)) + [apart, 0, 0], rng.uniform(size=(400, 3)), device)


def test_an_outlier_far_away_spoils_nothing(device):
    rng = np.random.default_rng(2)
    points = np.concatenate([rng.uniform(size=(500, 3)), [[5e4, -5e4, 300.0]]])
    index, distance = nearest_neighbours(points[:50], points, device)
    assert distance.max() == 0.0
    np.testing.assert_array_equal(index, np.arange(50))


def test_points_far_from_the_worlds_zero_keep_their_distances(device):
    rng = np.random.default_rng(3)
    far = np.array([458074.6, 5429380.2, 163.0])
    _check(rng.uniform(size=(60, 3)) + far, rng.uniform(size=(300, 3)) + far, device)


def test_of_equally_near_points_the_lowest_is_named(device):
    points = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [1.0, 0, 0]])
    index, distance = nearest_neighbours(np.zeros((1, 3)), points, device)
    assert index[0] == 0
    assert distance[0] == 1.0


def test_ties_across_many_leaves_go_to_the_lowest_index(device):
    rng = np.random.default_rng(9)
    points = rng.permutation(np.stack(np.meshgrid(*[np.arange(9.0)] * 3), axis=-1).reshape(-1, 3))
    queries = rng.integers(0, 16, size=(300, 3)) * 0.5
    index, _ = nearest_neighbours(queries, points, device)
    squares = ((queries[:, None] - points[None]) ** 2).sum(axis=2)
    np.testing.assert_array_equal(index, squares.argmin(axis=1))


def test_no_queries_give_no_distances(device):
    index, distance = nearest_neighbours(np.empty((0, 3)), np.zeros((1, 3)), device)
    assert index.shape == distance.shape == (0,)


@settings(max_examples=30, deadline=None)
@given(
    st.integers(1, 60),
    st.integers(1, 60),
    st.integers(0, 2**31),
    st.sampled_from([0.05, 1.0, 1e-3]),
)
def test_lattices_lines_and_duplicates(queries, points, seed, step):
    rng = np.random.default_rng(seed)
    flat = rng.integers(0, 2, size=3)  # whole axes may be zero: lines, planes, one point many times over
    a = rng.integers(-4, 5, size=(queries, 3)) * step
    b = rng.integers(-4, 5, size=(points, 3)) * flat * step
    _check(a, b, "cpu")
