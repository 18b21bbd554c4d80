"""Overlaps against sets of cells, and where the answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from maomaps_warp.mapping.projection import Ground
from maomaps_warp.scoring.overlap import map_overlap

V = 0.05
FLOOR = Ground(0.0, True, "given")


def overlap_by_sets(maps, ground_z):
    """The three shares by loops over sets of whole cells: {name: (common, any)}."""
    seen = {"known": [], "obstacle": [], "voxel": []}
    for points in maps:
        voxels = {tuple(round(x / V) for x in p) for p in points}
        above = {(i, j, k * 50 - round(ground_z * 1000)) for i, j, k in voxels}
        obstacle = {(i, j) for i, j, a in above if 100 < a < 1500}
        free = {(i, j) for i, j, a in above if abs(a) <= 100}
        seen["voxel"].append(voxels)
        seen["obstacle"].append(obstacle)
        seen["known"].append(obstacle | free)
    found = {}
    for name, sets in seen.items():
        either = set().union(*sets)
        found[name] = sum(sum(cell in s for s in sets) >= 2 for cell in either), len(either)
    return found


@pytest.mark.parametrize("number", [2, 3, 5])
def test_shares_are_those_of_sets_of_cells(number):
    random = np.random.default_rng(number)
    maps = [np.unique(random.integers([-8, -8, -6], [9, 9, 36], (900, 3)), axis=0) * V for _ in range(number)]
    for z in (0.0, 0.2):
        found = map_overlap(maps, V, Ground(z, True, "given"))
        for name, (common, either) in overlap_by_sets(maps, z).items():
            assert (found.counts[f"{name}_common"], found.counts[f"{name}_any"]) == (common, either)
            assert getattr(found, f"{name}_iou") == common / either


def floor(x0, x1):
    i, j = np.meshgrid(np.arange(x0, x1), np.arange(10), indexing="ij")
    return np.stack([i.ravel(), j.ravel(), np.zeros(i.size)], axis=1) * V


def test_two_floors_shifted_by_half_share_a_third():
    found = map_overlap([floor(0, 20), floor(10, 30)], V, FLOOR)
    assert found.known_iou == found.voxel_iou == pytest.approx(1 / 3)
    assert found.obstacle_iou is None
    assert found.counts["obstacle_any"] == 0


def test_equal_maps_share_everything_and_distant_ones_nothing():
    wall = floor(0, 20) + [0, 0, 0.5]
    same = map_overlap([wall, wall], V, FLOOR)
    assert (same.known_iou, same.obstacle_iou, same.voxel_iou) == (1.0, 1.0, 1.0)
    apart = map_overlap([wall, wall + [200.0, -90.0, 0.0]], V, FLOOR)
    assert (apart.known_iou, apart.obstacle_iou, apart.voxel_iou) == (0.0, 0.0, 0.0)


def test_a_column_that_is_free_in_one_map_and_occupied_in_the_other_is_known_to_both():
    found = map_overlap([floor(0, 4), floor(0, 4) + [0, 0, 1.0]], V, FLOOR)
    assert (found.known_iou, found.obstacle_iou, found.voxel_iou) == (1.0, 0.0, 0.0)


def test_points_twice_in_a_map_count_once():
    found = map_overlap([np.concatenate([floor(0, 4), floor(0, 4)]), floor(90, 94)], V, FLOOR)
    assert found.counts["voxel_common"] == found.counts["known_common"] == 0


def test_an_empty_map_shares_nothing_and_empty_maps_have_no_share():
    nothing = np.empty((0, 3))
    assert map_overlap([floor(0, 4), nothing], V, FLOOR).voxel_iou == 0.0
    found = map_overlap([nothing, nothing], V, FLOOR)
    assert (found.known_iou, found.obstacle_iou, found.voxel_iou) == (None, None, None)
    assert set(found.counts.values()) == {0}


def test_one_map_has_no_overlap():
    with pytest.raises(ValueError, match="two maps"):
        map_overlap([floor(0, 4)], V, FLOOR)
