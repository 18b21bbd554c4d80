"""The union of several maps."""

from __future__ import annotations

import numpy as np
import pytest

from maomaps_warp.errors import InputError
from maomaps_warp.mapping.cloud_map import voxelise
from maomaps_warp.mapping.merging import merge_maps
from maomaps_warp.model.voxels import KEY_BIAS, VoxelGrid, VoxelMap, pack_keys


def _map(
    cells: dict[tuple[int, int, int], tuple[int, tuple[int, int, int]]],
    origin: tuple[int, int, int] = (0, 0, 0),
    *,
    colored: bool = True,
) -> VoxelMap:
    """A map of world cells, each with how often it was seen and its colour."""
    grid = VoxelGrid(0.05, np.array(origin, np.int64))
    ordered = sorted(cells)
    return VoxelMap(
        grid,
        (np.array(ordered, np.int64).reshape(-1, 3) - grid.origin_ijk).astype(np.int32),
        np.array([cells[cell][0] for cell in ordered], np.int64),
        np.array([cells[cell][1] for cell in ordered], np.uint8).reshape(-1, 3) if colored else None,
    )


def _as_dict(voxels: VoxelMap) -> dict[tuple[int, ...], tuple[int, tuple[int, ...] | None]]:
    cells = (voxels.ijk + voxels.grid.origin_ijk).tolist()
    colors = [None] * len(voxels) if voxels.colors is None else [tuple(color) for color in voxels.colors.tolist()]
    return {tuple(c): (n, color) for c, n, color in zip(cells, voxels.counts.tolist(), colors, strict=True)}


FIRST = {(0, 0, 0): (1, (10, 20, 30)), (5, -3, 2): (3, (100, 0, 255)), (7, 7, 7): (2, (0, 0, 1))}
SECOND = {(5, -3, 2): (1, (0, 1, 255)), (7, 7, 7): (2, (1, 0, 0)), (-9, 0, 4): (6, (9, 8, 7))}
#: By hand: (3 * 100 + 0) / 4 = 75, (0 + 1) / 4 rounds to 0, 255; half of one rounds up to 1.
UNION = {
    (-9, 0, 4): (6, (9, 8, 7)),
    (0, 0, 0): (1, (10, 20, 30)),
    (5, -3, 2): (4, (75, 0, 255)),
    (7, 7, 7): (4, (1, 0, 1)),
}


@pytest.mark.parametrize("origin", [(0, 0, 0), (4, -100, 2), (200_000, 0, -8)])
def test_the_union_sums_counts_and_weighs_colours_by_them(origin: tuple[int, int, int]) -> None:
    merged = merge_maps([_map(FIRST), _map(SECOND, origin)])
    assert _as_dict(merged) == UNION
    keys = pack_keys(merged.ijk)
    assert (np.diff(keys) > 0).all()
    assert merged.ijk.dtype == np.int32 and merged.counts.dtype == np.int64


def test_colours_of_the_union_are_truncated_where_those_of_the_maps_are() -> None:
    merged = merge_maps([_map(FIRST), _map(SECOND)], color_mean="truncated")
    assert _as_dict(merged) == UNION | {(7, 7, 7): (4, (0, 0, 0))}


def test_the_order_of_the_maps_makes_no_difference() -> None:
    rng = np.random.default_rng(3)
    maps = []
    for shift in (0, 30, -50):
        points = rng.integers(-6, 6, (3000, 3)) * 0.05 + shift * 0.01
        colors = rng.integers(0, 256, points.shape).astype(np.uint8)
        maps.append(voxelise(points, VoxelGrid.around(points, 0.05), colors))
    results = [merge_maps([maps[i] for i in order]) for order in ((0, 1, 2), (2, 0, 1), (1, 2, 0))]
    for other in results[1:]:
        assert _as_dict(other) == _as_dict(results[0])
        np.testing.assert_array_equal(other.ijk, results[0].ijk)
        np.testing.assert_array_equal(other.grid.origin_ijk, results[0].grid.origin_ijk)
    union = set().union(*(map(tuple, (m.ijk + m.grid.origin_ijk).tolist()) for m in maps))
    assert set(_as_dict(results[0])) == union


def test_a_map_alone_is_its_own_union() -> None:
    assert _as_dict(merge_maps([_map(FIRST, (4, 4, 4))])) == FIRST
    assert _as_dict(merge_maps([_map(FIRST), _map(FIRST)])) == {c: (2 * n, color) for c, (n, color) in FIRST.items()}


def test_empty_maps_add_nothing() -> None:
    assert _as_dict(merge_maps([_map(FIRST), _map({})])) == FIRST
    assert len(merge_maps([_map({})])) == 0


def test_a_map_without_colours_leaves_the_union_without_colours() -> None:
    merged = merge_maps([_map(FIRST), _map(SECOND, colored=False)])
    assert merged.colors is None
    assert {cell: n for cell, (n, _) in _as_dict(merged).items()} == {cell: n for cell, (n, _) in UNION.items()}


def test_maps_of_different_lattices_are_a_mistake() -> None:
    other = VoxelMap(VoxelGrid(0.1, np.zeros(3, np.int64)), np.zeros((1, 3), np.int32), np.ones(1, np.int64))
    for maps in ([_map(FIRST), other], []):
        with pytest.raises(ValueError, match="one lattice"):
            merge_maps(maps)


def test_maps_too_far_apart_for_one_grid_are_refused_with_the_distance() -> None:
    far = _map({(2 * KEY_BIAS + 10, 0, 0): (1, (0, 0, 0))}, (2 * KEY_BIAS, 0, 0))
    with pytest.raises(InputError, match=r"span 104858 m.*are the maps in one world"):
        merge_maps([_map(FIRST), far])
    near = _map({(2 * KEY_BIAS - 10, 0, 0): (1, (0, 0, 0))}, (2 * KEY_BIAS, 0, 0))
    assert len(merge_maps([_map(FIRST), near])) == 4
