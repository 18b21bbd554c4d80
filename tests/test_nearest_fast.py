"""The fast searches for nearest neighbours, against the tree and SciPy: the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from maomaps_warp.kernels.distance_transform import MAX_WINDOW
from maomaps_warp.scoring.cell_search import search_cells
from maomaps_warp.scoring.lattice_nearest import find_lattice, near_squares
from maomaps_warp.scoring.nearest import distances_between, nearest_distances, nearest_neighbours, search_tree

STEP = 0.05
#: Rounding of a coordinate difference in float64, metres per metre of coordinate.
FLOAT64 = 1e-15


def _room(count: int, seed: int) -> np.ndarray:
    """Points on the faces of a box of 4 x 3 x 2 m, a centimetre rough."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(size=(count, 3))
    face = rng.integers(0, 3, count)
    points[np.arange(count), face] = rng.integers(0, 2, count)
    return points * [4.0, 3.0, 2.0] + rng.normal(0.0, 0.01, (count, 3))


def _line(count: int) -> np.ndarray:
    return np.linspace(0.0, 7.0, count)[:, None] * [1.0, 0.0, 0.0]


CLOUDS = {
    "rooms": (_room(3001, 0), _room(2503, 1)),
    "one point": (_room(77, 2), np.array([[1.0, 2.0, 3.0]])),
    "one query": (np.array([[1.0, 2.0, 3.0]]), _room(77, 2)),
    "seventeen queries": (_room(17, 3), _room(500, 4)),
    "itself": (_room(1500, 5), _room(1500, 5)),
    "every point four times": (_room(300, 6), np.repeat(_room(200, 7), 4, axis=0)),
    "all points the same": (_room(100, 8), np.ones((1000, 3))),
    "collinear": (_line(333) + [0.01, 0.0, 0.0], _line(500)),
    "outliers": (
        np.concatenate([_room(500, 9), [[1e6, -1e6, 1e6], [0.0, 0.0, -1e6]]]),
        np.concatenate([_room(700, 10), [[1e6, 1e6, -1e6], [-1e6, 0.0, 0.0]]]),
    ),
    "half a metre apart": (_room(2000, 11) + [0.5, 0.4, 0.3], _room(2000, 12)),
    "ten metres apart": (_room(300, 13) + [10.0, 0.0, 0.0], _room(2000, 14)),
    "a kilometre apart": (_room(300, 15) + [0.0, 1000.0, 0.0], _room(500, 16)),
    "georeferenced": (_room(900, 17) + [458074.6, 5429380.2, 163.0], _room(900, 18) + [458074.6, 5429380.2, 163.0]),
    "two rooms far from each other": (
        np.concatenate([_room(400, 19), _room(400, 20) + [800.0, 0.0, 0.0]]),
        np.concatenate([_room(400, 21), _room(400, 22) + [800.0, 0.0, 0.0]]),
    ),
    "lattice with ties": (
        np.random.default_rng(23).integers(0, 24, (900, 3)) * 0.5,
        np.random.default_rng(24).permutation(np.stack(np.meshgrid(*[np.arange(12.0)] * 3), axis=-1).reshape(-1, 3)),
    ),
}


@pytest.mark.parametrize("name", CLOUDS)
def test_index_and_distance_are_those_of_the_tree_bit_for_bit(name):
    queries, points = CLOUDS[name]
    index, squares = search_tree(queries, points)
    fast_index, distance = nearest_neighbours(queries, points)
    np.testing.assert_array_equal(fast_index, index)
    np.testing.assert_array_equal(distance, np.sqrt(squares))
    largest = np.abs(np.concatenate([queries, points])).max()
    np.testing.assert_allclose(distance, cKDTree(points).query(queries)[0], rtol=1e-14, atol=FLOAT64 * largest)


@pytest.mark.parametrize("name", ["rooms", "outliers", "half a metre apart", "every point four times"])
def test_the_number_of_threads_changes_no_bit(name, monkeypatch):
    answers = []
    for threads in ("1", "3"):
        monkeypatch.setenv("MAOMAPS_THREADS", threads)
        answers.append((*nearest_neighbours(*CLOUDS[name]), nearest_distances(*CLOUDS[name])))
    for one, three in zip(*answers, strict=True):
        np.testing.assert_array_equal(one, three)


def test_packets_alone_decide_what_is_near():
    queries, points = CLOUDS["rooms"]
    index, squares = search_cells(queries, points, with_index=True)
    assert (index >= 0).all()
    np.testing.assert_array_equal(squares, search_tree(queries, points)[1])


def test_clouds_of_very_uneven_density_are_left_to_the_tree():
    rng = np.random.default_rng(25)
    dense, sparse = rng.uniform(0.0, 0.5, (9000, 3)), rng.uniform(-100.0, 100.0, (1000, 3))
    points = np.concatenate([dense, sparse])
    for with_index in (True, False):
        index, squares = search_cells(points, points, with_index=with_index)
        assert (squares == -1).all() and (index == -1).all() and len(index) == (len(points) if with_index else 0)
    index, distances = nearest_neighbours(points, points)
    np.testing.assert_array_equal(index, np.arange(len(points)))
    assert not distances.any()


def test_free_distances_are_those_of_the_neighbours_bit_for_bit():
    queries, points = CLOUDS["rooms"]
    assert find_lattice(queries, points) is None
    np.testing.assert_array_equal(nearest_distances(queries, points), nearest_neighbours(queries, points)[1])


def _cells(count: int, seed: int, high: tuple[int, int, int] = (70, 60, 30)) -> np.ndarray:
    return np.unique(np.random.default_rng(seed).integers(0, high, (count, 3)), axis=0)


def _lattice_answer(query_cells: np.ndarray, point_cells: np.ndarray) -> np.ndarray:
    squares = np.rint(cKDTree(point_cells.astype(float)).query(query_cells.astype(float))[0] ** 2)
    return STEP * np.sqrt(squares)


@pytest.mark.parametrize("offset", [0.0, 0.5])
@pytest.mark.parametrize("shift", [(0, 0, 0), (14, -10, 8), (40, 0, 0), (2000, 30, 0), (20000, 0, 0)])
@pytest.mark.parametrize("voxel_size", [None, STEP])
def test_on_one_lattice_a_distance_is_the_step_times_the_root_of_an_integer(device, offset, shift, voxel_size):
    queries, points = _cells(3000, 0) + np.array(shift), _cells(2000, 1) - [5, 7, 9]
    found = nearest_distances((queries + offset) * STEP, (points + offset) * STEP, device, voxel_size)
    np.testing.assert_array_equal(found, _lattice_answer(queries, points))


def test_on_a_lattice_the_number_of_threads_changes_no_bit(monkeypatch):
    answers = []
    for threads in ("1", "3"):
        monkeypatch.setenv("MAOMAPS_THREADS", threads)
        answers.append(nearest_distances(_cells(2500, 2) * STEP, _cells(400, 3) * STEP))
    np.testing.assert_array_equal(*answers)


@pytest.mark.parametrize(
    "clouds",
    [
        (_cells(3000, 11) * STEP, _cells(2000, 12) * STEP),
        (_cells(900, 13) * STEP, _cells(900, 14) * 2 * STEP),
        (_cells(900, 15) * 2 * STEP, _cells(900, 16) * STEP),
        (_cells(900, 17)[:1] * STEP, _cells(900, 18) * STEP),
        CLOUDS["rooms"],
    ],
    ids=["one lattice", "a coarser one", "a finer one", "one point", "free"],
)
def test_both_ways_together_are_each_way_alone(clouds, device):
    first, second = clouds
    one, other = distances_between(first, second, device)
    np.testing.assert_array_equal(one, nearest_distances(first, second, device))
    np.testing.assert_array_equal(other, nearest_distances(second, first, device))


@pytest.mark.parametrize("reach", [1, 9, 10, 11, 79, 80, 81])
def test_a_few_queries_far_from_the_others_are_decided_exactly(reach):
    points = _cells(2000, 19, (30, 30, 20))
    far = points[:5] + [29 + reach, 29 + reach, 0]
    queries = np.concatenate([points[:1500], far])
    np.testing.assert_array_equal(nearest_distances(queries * STEP, points * STEP), _lattice_answer(queries, points))


@pytest.mark.parametrize("apart", [0, 14, 15, 16, 99, 100, 101, MAX_WINDOW, 400])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_no_window_cuts_a_distance_off(apart, axis):
    points = _cells(600, 4, (6, 6, 6))
    queries = points + apart * np.eye(3, dtype=int)[axis]
    np.testing.assert_array_equal(nearest_distances(queries * STEP, points * STEP), _lattice_answer(queries, points))


def test_the_transform_says_where_it_does_not_know():
    cells = np.array([[0, 0, 0], [300, 0, 0]])
    clouds = find_lattice(cells * STEP, np.array([[0, 0, 0], [1, 0, 0]]) * STEP, STEP)
    assert clouds is not None
    np.testing.assert_array_equal(near_squares(clouds), [0, -1])


def test_an_extent_beyond_the_budget_is_decided_without_the_transform():
    corners = np.array([[0, 0, 0], [9000, 9000, 9000]])
    points = np.concatenate([_cells(500, 5), corners])
    queries = np.concatenate([_cells(500, 6), corners + 3])
    clouds = find_lattice(queries * STEP, points * STEP, STEP)
    assert clouds is not None
    assert (near_squares(clouds) == -1).all()
    np.testing.assert_array_equal(nearest_distances(queries * STEP, points * STEP), _lattice_answer(queries, points))


@pytest.mark.parametrize("off", [1e-6, -1e-7, 0.02])
def test_one_coordinate_beside_the_lattice_makes_the_clouds_free(off):
    queries, points = _cells(900, 7) * STEP, _cells(900, 8) * STEP
    assert find_lattice(queries, points) is not None
    beside = queries.copy()
    beside[451, 1] += off
    assert find_lattice(beside, points) is None
    np.testing.assert_array_equal(nearest_distances(beside, points), nearest_neighbours(beside, points)[1])


def test_clouds_of_two_lattices_are_free():
    queries, points = _cells(900, 9) * STEP, _cells(900, 10) * STEP
    assert find_lattice(queries + [0.5 * STEP, 0.0, 0.0], points, STEP) is None
    assert find_lattice(queries * 1.01, points, STEP) is None


def test_no_queries_give_no_distances():
    assert nearest_distances(np.empty((0, 3)), np.zeros((3, 3))).shape == (0,)


def test_no_points_are_refused():
    with pytest.raises(ValueError, match="points"):
        nearest_distances(np.zeros((3, 3)), np.empty((0, 3)))
