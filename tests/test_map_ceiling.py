"""Ceilings of hand-made maps."""

from __future__ import annotations

import numpy as np
import pytest

from maomaps_warp.mapping.ceiling import remove_ceiling
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap, pack_keys


def column(layers: dict[int, int], *, origin: int = 0, voxel_size: float = 0.05, colors: bool = False) -> VoxelMap:
    """A map with so many voxels in each z layer of the world."""
    ijk = np.array([(i, 0, k - origin) for k, n in layers.items() for i in range(n)], dtype=np.int32).reshape(-1, 3)
    ijk = ijk[np.argsort(pack_keys(ijk))]
    grid = VoxelGrid(voxel_size, np.array([0, 0, origin]))
    shades = np.repeat((ijk[:, 2:] % 200).astype(np.uint8), 3, axis=1) if colors else None
    return VoxelMap(grid, ijk, np.arange(1, len(ijk) + 1), shades)


def layers_of(voxels: VoxelMap) -> list[int]:
    return sorted({int(k) for k in voxels.ijk[:, 2] + voxels.grid.origin_ijk[2]})


def test_the_fullest_layer_of_the_upper_half_is_the_ceiling():
    # The floor is the fullest of all, the upper half of the six layers begins at 40: 44 is the ceiling.
    lower, removed, note = remove_ceiling(column({0: 90, 10: 1, 30: 1, 40: 2, 44: 50, 46: 3}))
    assert layers_of(lower) == [0, 10]
    assert removed == 1 + 2 + 50 + 3
    assert "ceiling at z = 2.2 m: what lies above 1.2 m was removed, 56 of 147 voxels" in note


def test_the_layer_exactly_a_metre_below_the_ceiling_stays():
    # As floats 0.15 = 3 * 0.05 is 0.15000000000000002 and would lie above 1.15 - 1.0.
    lower, removed, _ = remove_ceiling(column({1: 1, 2: 1, 3: 1, 4: 1, 23: 9}))
    assert layers_of(lower) == [1, 2, 3]
    assert removed == 10


def test_of_an_odd_number_of_layers_the_middle_one_belongs_to_the_upper_half():
    lower, _, _ = remove_ceiling(column({0: 1, 20: 9, 45: 1}))
    assert layers_of(lower) == [0]


def test_below_the_upper_half_no_layer_is_a_ceiling_however_full():
    lower, _, _ = remove_ceiling(column({0: 1, 1: 99, 40: 2, 41: 1}))
    assert layers_of(lower) == [0, 1]


def test_of_equally_full_layers_the_lowest_is_the_ceiling():
    lower, _, _ = remove_ceiling(column({0: 1, 25: 1, 30: 5, 60: 5}))
    assert layers_of(lower) == [0]


def test_only_occupied_layers_are_halved():
    # Half of the height would be layer 50; half of the occupied layers begins at 4.
    lower, _, _ = remove_ceiling(column({0: 1, 1: 1, 2: 1, 3: 1, 4: 9, 5: 1, 6: 1, 100: 1}), margin=0.1)
    assert layers_of(lower) == [0, 1, 2]


def test_layers_are_those_of_the_world_wherever_the_grid_begins():
    layers = {-3: 8, 10: 2, 30: 9}
    for origin in (0, 8, -40):
        lower, removed, note = remove_ceiling(column(layers, origin=origin))
        assert (layers_of(lower), removed) == ([-3, 10], 9)
        assert "z = 1.5 m" in note


def test_samples_and_colours_stay_with_their_voxels():
    voxels = column({0: 2, 5: 1, 40: 3}, colors=True)
    lower, _, _ = remove_ceiling(voxels)
    kept = voxels.ijk[:, 2] < 20
    np.testing.assert_array_equal(lower.ijk, voxels.ijk[kept])
    np.testing.assert_array_equal(lower.counts, voxels.counts[kept])
    np.testing.assert_array_equal(lower.colors, voxels.colors[kept])


@pytest.mark.parametrize(("height", "kept"), [(0.15, 3), (0.1499, 2), (0.0, 0), (-0.05, -1), (2.1, 42), (1e9, 50)])
def test_a_height_keeps_the_layers_up_to_it(height, kept):
    lower, removed, note = remove_ceiling(column(dict.fromkeys(range(-5, 51), 1)), height=height)
    assert layers_of(lower) == list(range(-5, kept + 1))
    assert removed == 50 - kept
    assert f"above {height:g} m" in note


def test_an_empty_map_has_no_ceiling():
    empty = column({})
    lower, removed, _ = remove_ceiling(empty)
    assert (len(lower), removed) == (0, 0)
