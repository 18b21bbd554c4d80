"""Doubled walls: shares known by construction."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from maomaps_warp.mapping.cloud_map import voxelise
from maomaps_warp.model.merge_results import DoubledWalls
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap, pack_keys
from maomaps_warp.scoring.doubled_walls import find_doubled_walls, normals_at

V = 0.05
GRID = VoxelGrid(V, np.zeros(3, dtype=np.int64))


def cells_map(cells: NDArray[np.int64]) -> VoxelMap:
    return voxelise(cells * V, GRID)


def wall(x: int, width: int = 40, height: int = 30) -> NDArray[np.int64]:
    """Cells of a wall in the plane x, `width` along y and `height` along z."""
    y, z = np.meshgrid(np.arange(width), np.arange(height), indexing="ij")
    return np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1)


def doubled(predicted: NDArray[np.int64], gt: NDArray[np.int64], distance: float = 0.5) -> DoubledWalls:
    gt_map = cells_map(gt)
    return find_doubled_walls(cells_map(predicted), gt_map, np.ones(len(gt_map), dtype=bool), distance)


def test_a_map_equal_to_the_truth_has_no_doubled_walls():
    found = doubled(wall(0), wall(0))
    assert found == DoubledWalls(0.5, 1200, 1200, 0, 0, 0, 0)
    assert found.share == 0.0


def test_every_voxel_of_both_walls_counts_where_a_wall_is_doubled_throughout():
    found = doubled(np.concatenate([wall(0), wall(6)]), wall(0))
    assert (found.in_overlap, found.decided, found.doubled) == (2400, 2400, 2400)


@pytest.mark.parametrize("behind", [6, -6])
def test_the_share_is_that_of_the_voxels_with_a_second_surface(behind):
    # Half of the wall has a ghost 0.3 m behind or before it: 20 of 40 columns, and the ghost itself.
    found = doubled(np.concatenate([wall(0), wall(behind, width=20)]), wall(0))
    assert (found.decided, found.doubled) == (1200 + 600, 600 + 600)
    assert found.share == pytest.approx(2.0 / 3.0)


def test_real_walls_with_two_sides_are_not_counted():
    both_sides = np.concatenate([wall(0), wall(6)])
    found = doubled(both_sides, both_sides)
    assert (found.decided, found.doubled, found.gt_has_more) == (0, 0, 2400)
    assert found.share is None


@pytest.mark.parametrize("at", [0, 1])  # halves round to even, so odd cells must do as well
@pytest.mark.parametrize(("apart", "share"), [(1, 0.0), (2, 0.0), (-2, 0.0), (3, 1.0), (-3, 1.0), (10, 1.0), (11, 0.0)])
def test_surfaces_are_two_from_two_empty_voxels_on_and_up_to_the_distance(apart, share, at):
    found = doubled(np.concatenate([wall(at), wall(at + apart)]), wall(at))
    # Beyond the distance the ghost's own line does not reach the ground truth.
    assert found.gt_has_none == (1200 if apart > 10 else 0)
    assert found.share == share


def test_a_thick_wall_is_one_surface():
    thick = np.concatenate([wall(0), wall(1), wall(2)])
    assert doubled(thick, wall(0)).doubled == 0
    assert doubled(np.concatenate([wall(0), wall(6)]), np.concatenate([wall(0), wall(1)])).share == 1.0


def test_a_wall_that_is_missing_is_not_doubled():
    found = doubled(wall(6), wall(0))
    assert (found.decided, found.doubled) == (1200, 0)


def test_voxels_whose_nearest_element_one_run_alone_has_seen_are_left_out():
    gt = cells_map(wall(0))
    shared = gt.ijk[:, 1] < 10
    found = find_doubled_walls(cells_map(np.concatenate([wall(0), wall(6)])), gt, shared, 0.5)
    assert (found.in_overlap, found.decided, found.doubled) == (600, 600, 600)


def test_rods_and_lone_voxels_have_no_plane():
    rod = np.stack([np.zeros(50, dtype=np.int64), np.zeros(50, dtype=np.int64), np.arange(50)], axis=1)
    assert doubled(rod, rod).undecided == 50
    assert doubled(rod[:1], rod[:1]).undecided == 1


def test_the_counts_add_up_in_a_cluttered_map():
    rng = np.random.default_rng(3)
    gt = np.concatenate([wall(0), wall(6)[:600], rng.integers(-10, 40, (300, 3))])
    found = doubled(np.concatenate([gt + [1, 0, 0], rng.integers(-30, 60, (500, 3))]), gt)
    parts = (found.decided, found.undecided, found.gt_has_more, found.gt_has_none)
    assert sum(parts) == found.in_overlap and all(part > 0 for part in parts)


def test_an_empty_overlap_counts_nothing():
    gt = cells_map(wall(0))
    found = find_doubled_walls(gt, gt, np.zeros(len(gt), dtype=bool), 0.5)
    assert found == DoubledWalls(0.5, 0, 0, 0, 0, 0, 0)


def test_maps_on_different_grids_are_a_programming_mistake():
    other = voxelise(wall(0) * 0.1, VoxelGrid(0.1, np.zeros(3, dtype=np.int64)))
    with pytest.raises(ValueError, match="one grid"):
        find_doubled_walls(other, cells_map(wall(0)), np.ones(1200, dtype=bool), 0.5)


#: Share of the voxels of two slanted sheets whose line finds both: samples half a voxel apart slip through a few gaps
#: of a voxelised sheet.
FOUND_SHARE = 0.98


@pytest.mark.parametrize("seed", range(4))
def test_slanted_walls_are_found_too(seed):
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    sheet = rng.uniform(-1.0, 1.0, (80_000, 2)) @ axes[:2]
    gt = voxelise(sheet, GRID)
    is_shared = np.ones(len(gt), dtype=bool)
    alone = find_doubled_walls(gt, gt, is_shared, 0.5)
    assert (alone.decided, alone.doubled) == (len(gt) - alone.undecided, 0)
    both = find_doubled_walls(voxelise(np.concatenate([sheet, sheet + 0.3 * axes[2]]), GRID), gt, is_shared, 0.5)
    assert both.decided > FOUND_SHARE * both.in_overlap
    assert both.doubled > FOUND_SHARE * both.decided


def test_normals_agree_with_those_of_a_tree_and_a_singular_value_decomposition():
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(5)
    bumpy = np.stack([*(rng.uniform(-1, 1, (2, 20_000))), np.empty(20_000)], axis=1)
    bumpy[:, 2] = 0.2 * np.sin(3 * bumpy[:, 0]) + 0.1 * bumpy[:, 1]
    voxels = voxelise(bumpy, GRID)
    chosen = np.arange(0, len(voxels), 17)
    normals, is_planar = normals_at(voxels.ijk[chosen], pack_keys(voxels.ijk))
    assert is_planar.all()
    centers = voxels.ijk.astype(np.float64)
    near = cKDTree(centers).query_ball_point(centers[chosen], 3.0 + 1e-9)
    for normal, rows in zip(normals, near, strict=True):
        _, sizes, axes = np.linalg.svd(centers[rows] - centers[rows].mean(axis=0))
        assert sizes[1] > 1.5 * sizes[2]  # else the direction is a matter of rounding
        assert abs(normal @ axes[2]) == pytest.approx(1.0, abs=1e-9)
