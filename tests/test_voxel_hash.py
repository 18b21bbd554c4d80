"""The voxel hash: keys, growth, capacity."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from maomaps_warp.kernels.voxel_hash import (
    VoxelHash,
    add_sample,
    build_voxel_index,
    cell_of,
    create_voxel_hash,
    rehash,
)
from maomaps_warp.kernels.voxel_keys import find_slot, pack_key
from maomaps_warp.model.voxels import KEY_BIAS, VoxelGrid, pack_keys, unpack_keys


@wp.kernel(enable_backward=False)
def _insert(ijk: wp.array(dtype=wp.vec3i), table: VoxelHash):
    i = wp.tid()
    add_sample(table, ijk[i], wp.vec3i(i, 2 * i, 255), wp.int64(1))


@wp.kernel(enable_backward=False)
def _look_up(
    ijk: wp.array(dtype=wp.vec3i),
    keys: wp.array(dtype=wp.int64),
    values: wp.array(dtype=wp.int32),
    out: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    slot = find_slot(keys, pack_key(ijk[i]))
    out[i] = -1
    if slot >= 0:
        out[i] = values[slot]


def _insert_all(ijk: np.ndarray, table: VoxelHash, device: str) -> None:
    wp.launch(_insert, dim=len(ijk), inputs=[wp.array(ijk, dtype=wp.vec3i, device=device), table], device=device)


def _content(table: VoxelHash) -> dict[tuple[int, ...], tuple[int, ...]]:
    keys = table.keys.numpy()
    used = np.nonzero(keys >= 0)[0]
    sums = np.column_stack([table.counts.numpy()[used], table.color_sums.numpy()[used]])
    return dict(zip(map(tuple, unpack_keys(keys[used]).tolist()), map(tuple, sums.tolist()), strict=True))


def _expected(ijk: np.ndarray) -> dict[tuple[int, ...], tuple[int, ...]]:
    content: dict[tuple[int, ...], list[int]] = {}
    for i, cell in enumerate(map(tuple, ijk.tolist())):
        entry = content.setdefault(cell, [0, 0, 0, 0])
        for place, add in enumerate((1, i, 2 * i, 255)):
            entry[place] += add
    return {cell: tuple(entry) for cell, entry in content.items()}


def test_no_slot_holds_an_index_beyond_the_key(device):
    keys, values = build_voxel_index(wp.array([[1, 2, 3], [4, 5, 6]], dtype=wp.vec3i, device=device))
    asked = wp.array([[4, 5, 6], [KEY_BIAS, 0, 0], [0, -KEY_BIAS - 1, 0], [9, 9, 9]], dtype=wp.vec3i, device=device)
    found = wp.empty(4, dtype=wp.int32, device=device)
    wp.launch(_look_up, dim=4, inputs=[asked, keys, values, found], device=device)
    assert found.numpy().tolist() == [1, -1, -1, -1]


def test_keys_are_unpacked_to_the_indices_they_were_packed_from():
    rng = np.random.default_rng(0)
    ijk = rng.integers(-KEY_BIAS, KEY_BIAS, size=(1000, 3))
    ijk[:2] = [[-KEY_BIAS] * 3, [KEY_BIAS - 1] * 3]
    np.testing.assert_array_equal(unpack_keys(pack_keys(ijk)), ijk)


def test_keys_sort_as_indices_do():
    rng = np.random.default_rng(1)
    ijk = rng.integers(-5, 5, size=(500, 3))
    np.testing.assert_array_equal(np.lexsort(ijk.T[::-1]), np.argsort(pack_keys(ijk), kind="stable"))


def test_an_index_beyond_the_key_is_refused_on_the_host():
    with pytest.raises(ValueError, match="within"):
        pack_keys(np.array([[KEY_BIAS, 0, 0]]))


def test_samples_add_up_whatever_collides(device):
    rng = np.random.default_rng(2)
    ijk = rng.integers(-8, 8, size=(3000, 3)).astype(np.int32)
    table = create_voxel_hash(4096, device, with_colors=True)
    _insert_all(ijk, table, device)
    assert _content(table) == _expected(ijk)
    assert table.size.numpy()[0] == len(np.unique(ijk, axis=0))
    assert table.rejected.numpy().tolist() == [0, 0]


def test_a_larger_table_takes_over_everything(device):
    rng = np.random.default_rng(3)
    ijk = rng.integers(-6, 6, size=(500, 3)).astype(np.int32)
    small, large = (create_voxel_hash(n, device, with_colors=True) for n in (1024, 8192))
    _insert_all(ijk, small, device)
    rehash(small, large)
    assert _content(large) == _expected(ijk)


def test_a_full_table_counts_every_sample_it_cannot_take(device):
    ijk = np.stack([np.arange(20), np.zeros(20), np.zeros(20)], axis=1).astype(np.int32)
    table = create_voxel_hash(16, device)
    _insert_all(ijk, table, device)
    assert table.size.numpy()[0] == 16
    assert table.rejected.numpy().tolist() == [4, 0]


def test_a_voxel_outside_the_key_range_is_counted_not_wrapped(device):
    ijk = np.array([[0, 0, 0], [1 << 20, 0, 0], [0, -(1 << 20) - 1, 0]], dtype=np.int32)
    table = create_voxel_hash(16, device, with_colors=True)
    _insert_all(ijk, table, device)
    assert table.rejected.numpy().tolist() == [0, 2]
    assert list(_content(table)) == [(0, 0, 0)]


def test_the_index_finds_every_voxel_and_no_other(device):
    rng = np.random.default_rng(4)
    ijk = np.unique(rng.integers(-10, 10, size=(2000, 3)), axis=0).astype(np.int32)
    keys, values = build_voxel_index(wp.array(ijk, dtype=wp.vec3i, device=device))
    asked = np.concatenate([ijk, ijk + 40]).astype(np.int32)
    out = wp.empty(len(asked), dtype=wp.int32, device=device)
    wp.launch(
        _look_up,
        dim=len(asked),
        inputs=[wp.array(asked, dtype=wp.vec3i, device=device), keys, values],
        outputs=[out],
        device=device,
    )
    expected = np.concatenate([np.arange(len(ijk)), np.full(len(ijk), -1)])
    np.testing.assert_array_equal(out.numpy(), expected)


def test_an_index_is_built_anew_in_arrays_that_held_another(device):
    def put(rows):
        return wp.array(np.array(rows, np.int32), dtype=wp.vec3i, device=device)

    keys, values = build_voxel_index(put([[0, 0, 0], [1, 0, 0], [2, 0, 0]]))
    build_voxel_index(put([[7, 7, 7]]), out_keys=keys, out_values=values)
    assert np.count_nonzero(keys.numpy() >= 0) == 1


@wp.kernel(enable_backward=False)
def _cells(points: wp.array(dtype=wp.vec3), inverse: float, offset: float, out: wp.array(dtype=wp.vec3i)):
    i = wp.tid()
    out[i] = cell_of(points[i], inverse, offset)


@pytest.mark.parametrize("offset", [0.0, 0.5])
@pytest.mark.parametrize("origin", [(0, 0, 0), (2, -6, 40)])
def test_points_on_faces_fall_into_the_same_cell_on_host_and_device(device, offset, origin):
    # 0.25 is exact in binary, so every one of these points lies on a face, or in the middle of a cell, exactly.
    grid = VoxelGrid(0.25, np.array(origin, dtype=np.int64), offset)
    steps = np.arange(-24, 25) * 0.125
    points = np.stack([steps, steps[::-1], steps + 3.0], axis=1)
    out = wp.empty(len(points), dtype=wp.vec3i, device=device)
    relative = wp.array((points - grid.origin).astype(np.float32), dtype=wp.vec3, device=device)
    wp.launch(_cells, dim=len(points), inputs=[relative, 4.0, offset], outputs=[out], device=device)
    np.testing.assert_array_equal(out.numpy(), grid.ijk_of(points))


def test_points_that_are_no_numbers_or_far_too_large_are_in_no_cell(device):
    wild = np.array([[np.nan, 0, 0], [0, 1e30, 0], [0, 0, -np.inf]], dtype=np.float32)
    out = wp.empty(3, dtype=wp.vec3i, device=device)
    put = wp.array(wild, dtype=wp.vec3, device=device)
    wp.launch(_cells, dim=3, inputs=[put, 20.0, 0.0], outputs=[out], device=device)
    assert (np.abs(out.numpy()).max(axis=1) >= KEY_BIAS).all()


def test_a_grid_of_rounded_cells_has_an_even_origin():
    with pytest.raises(ValueError, match="even"):
        VoxelGrid(0.05, np.array([0, 3, 0], dtype=np.int64))
    rng = np.random.default_rng(0)
    for _ in range(20):
        grid = VoxelGrid.around(rng.normal(scale=100.0, size=(5, 3)), 0.05)
        assert not (grid.origin_ijk % 2).any()


def test_a_wrong_array_is_named(device):
    with pytest.raises(TypeError, match="ijk: expected dtype vec3i"):
        build_voxel_index(wp.zeros(3, dtype=wp.vec3, device=device))
    with pytest.raises(ValueError, match="power of two"):
        create_voxel_hash(1000, device)
