"""The distance field of a voxel map: clearances, positions of voxels, bricks."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from scipy.ndimage import distance_transform_cdt

from maomaps_warp.kernels import distance_field_building
from maomaps_warp.kernels.distance_field import DistanceField
from maomaps_warp.kernels.field_cells import clearance_at, ray_origin, voxel_at
from maomaps_warp.mapping.distance_field import build_voxel_field, unpack_clearance
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap, unpack_keys

CAP = 15


def voxel_map(ijk, voxel_size=0.05, center_offset=0.0):
    ijk = np.unique(np.asarray(ijk, dtype=np.int32), axis=0)
    return VoxelMap(VoxelGrid(voxel_size, np.zeros(3, np.int64), center_offset), ijk, np.ones(len(ijk), np.int64))


def expected_clearance(voxels, field):
    """SciPy's chessboard distance to the voxels and the border, capped."""
    taken = np.ones((field.nx, field.ny, field.nz), dtype=bool)
    taken[1:-1, 1:-1, 1:-1] = False
    taken[tuple((voxels.ijk - np.array([*field.lower])).T)] = True
    return np.minimum(distance_transform_cdt(~taken, "chessboard"), CAP)


@wp.kernel
def _read_kernel(
    field: DistanceField,
    cells: wp.array(dtype=wp.vec3i),
    out_clearance: wp.array(dtype=wp.int32),
    out_voxel: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    c = cells[i]
    out_voxel[i] = voxel_at(field, c[0], c[1], c[2])
    out_clearance[i] = clearance_at(field, c[0], c[1], c[2])


@wp.kernel
def _origin_kernel(field: DistanceField, points: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    out[i] = ray_origin(field, points[i])


def read(field, cells, device):
    out = [wp.zeros(len(cells), dtype=wp.int32, device=device) for _ in range(2)]
    wp.launch(_read_kernel, len(cells), [field, wp.array(cells, dtype=wp.vec3i, device=device), *out], device=device)
    return out[0].numpy(), out[1].numpy()


@pytest.mark.parametrize(
    ("size", "count"),
    [((1, 1, 1), 1), ((10, 10, 10), 4), ((40, 33, 61), 30), ((70, 20, 62), 20), ((9, 80, 130), 60), ((20, 7, 400), 9)],
)
def test_clearances_are_chessboard_distances(device, size, count):
    rng = np.random.default_rng(count)
    voxels = voxel_map(rng.integers(-5, np.array(size) - 5, (count, 3)))
    field = build_voxel_field(voxels, device).field
    np.testing.assert_array_equal(unpack_clearance(field), expected_clearance(voxels, field))


def test_a_field_built_in_slabs_is_the_same(device, monkeypatch):
    voxels = voxel_map(np.random.default_rng(0).integers(0, 120, (80, 3)))
    whole = unpack_clearance(build_voxel_field(voxels, device).field)
    monkeypatch.setattr(distance_field_building, "_PLANE_WORDS", 1)
    np.testing.assert_array_equal(unpack_clearance(build_voxel_field(voxels, device).field), whole)


def test_threads_build_the_same_field(monkeypatch):
    voxels = voxel_map(np.random.default_rng(1).integers(0, 90, (500, 3)))
    fields = []
    for threads in ("1", "3"):
        monkeypatch.setenv("MAOMAPS_THREADS", threads)
        fields.append(build_voxel_field(voxels).field)
    np.testing.assert_array_equal(fields[0].clearance.numpy(), fields[1].clearance.numpy())
    np.testing.assert_array_equal(fields[0].columns.numpy(), fields[1].columns.numpy())


@pytest.mark.parametrize("dense_bytes", [1 << 30, 0])
def test_every_voxel_is_found_at_its_cell_and_nowhere_else(device, dense_bytes):
    voxels = voxel_map(np.random.default_rng(2).integers(-40, 40, (3000, 3)))
    field = build_voxel_field(voxels, device, dense_bytes=dense_bytes).field
    shape = (field.nx, field.ny, field.nz)
    cells = np.stack(np.unravel_index(np.arange(np.prod(shape)), shape), axis=1).astype(np.int32)
    expected = np.full(shape, -1)
    expected[tuple((voxels.ijk - np.array([*field.lower])).T)] = np.arange(len(voxels))
    clearance, voxel = read(field, cells, device)
    np.testing.assert_array_equal(voxel, expected.ravel())
    np.testing.assert_array_equal(clearance, expected_clearance(voxels, field).ravel())


def test_outside_the_field_there_is_no_voxel(device):
    field = build_voxel_field(voxel_map([[0, 0, 0]]), device).field
    cells = np.array([[1, 1, -1], [-5, 1, 1], [1, 99, 1], [0, 1, 1], [1, 1, 1]], dtype=np.int32)
    out = wp.zeros(len(cells), dtype=wp.int32, device=device)

    assert [int(v) for v in read_voxels(field, cells, out, device)] == [-1, -1, -1, -1, 0]


@wp.kernel
def _voxel_kernel(field: DistanceField, cells: wp.array(dtype=wp.vec3i), out: wp.array(dtype=wp.int32)):
    i = wp.tid()
    out[i] = voxel_at(field, cells[i][0], cells[i][1], cells[i][2])


def read_voxels(field, cells, out, device):
    wp.launch(_voxel_kernel, len(cells), [field, wp.array(cells, dtype=wp.vec3i, device=device), out], device=device)
    return out.numpy()


@pytest.mark.parametrize("center_offset", [0.0, 0.5])
def test_origins_are_rounded_once(device, center_offset):
    voxels = voxel_map([[30000, -20000, 17], [30100, -19900, 40]], 0.03, center_offset)
    field = build_voxel_field(voxels, device).field
    points = (np.array([[900.1, -599.9, 0.7], [903.0, -597.0, 1.2]])).astype(np.float32)
    out = wp.zeros(len(points), dtype=wp.vec3, device=device)
    wp.launch(_origin_kernel, len(points), [field, wp.array(points, dtype=wp.vec3, device=device), out], device=device)
    expected = points.astype(np.float64) / 0.03 + (0.5 - center_offset) - np.array([*field.lower])
    # One rounding to float32 of a number below 128.
    np.testing.assert_allclose(out.numpy(), expected, rtol=0, atol=2.0**-18)


def test_an_empty_map_is_refused():
    with pytest.raises(ValueError, match="at least one voxel"):
        build_voxel_field(voxel_map(np.empty((0, 3))))


@pytest.mark.parametrize("seed", range(4))
def test_clearances_of_bricks_are_those_of_the_dense_field(device, seed):
    rng = np.random.default_rng(seed)
    voxels = voxel_map(rng.integers(0, [90, 40, 60], (int(rng.integers(1, 60)), 3)))
    dense = unpack_clearance(build_voxel_field(voxels, device).field)
    field = build_voxel_field(voxels, device, dense_bytes=0).field
    keys, values = field.brick_keys.numpy(), field.brick_values.numpy()
    numbers = field.clearance.numpy().view(np.uint32).reshape(-1, 64)
    bricked = np.full(dense.shape, 15, dtype=np.uint8)
    for axis, n in enumerate(dense.shape):
        to_border = np.minimum(np.arange(n), np.arange(n)[::-1]).clip(max=15).astype(np.uint8)
        np.minimum(bricked, np.expand_dims(to_border, [a for a in range(3) if a != axis]), out=bricked)
    for key, value in zip(keys[keys >= 0], values[keys >= 0], strict=True):
        x, y, z = 8 * unpack_keys(np.array([key]))[0]
        eights = (numbers[value][:, None] >> np.arange(0, 32, 4, dtype=np.uint32)) & 15
        inside = [slice(max(a, 0), min(a + 8, n)) for a, n in zip((x, y, z), dense.shape, strict=True)]
        own = tuple(slice(s.start - a, s.stop - a) for s, a in zip(inside, (x, y, z), strict=True))
        if all(s.stop > s.start for s in inside):
            bricked[tuple(inside)] = eights.reshape(8, 8, 8)[own]
    np.testing.assert_array_equal(bricked, dense)
