"""First voxels on rays: the packet caster, the one-ray caster, the mesh caster and a float64 walk agree."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import first_voxel
from scenes import VOXEL, cluttered_room

from maomaps_warp.kernels.distance_field_building import build_distance_field
from maomaps_warp.kernels.surface import cast_rays
from maomaps_warp.kernels.voxel_rays import cast_voxel_rays
from maomaps_warp.mapping.distance_field import build_voxel_field
from maomaps_warp.mapping.surface import build_surface
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap

# Metres. A float32 ray may pass an edge on the other side within this; rays that near to an edge are left out.
GRAZING_BAND = 2e-5


def voxel_map(ijk, center_offset=0.0):
    ijk = np.unique(np.asarray(ijk, dtype=np.int32), axis=0)
    return VoxelMap(VoxelGrid(VOXEL, np.zeros(3, np.int64), center_offset), ijk, np.ones(len(ijk), np.int64))


def vectors(values, device):
    return wp.array(np.ascontiguousarray(values, dtype=np.float32).reshape(-1, 3), dtype=wp.vec3, device=device)


def cast(voxels, origins, directions, device="cpu", dense_bytes=1 << 28):
    """Hits of the rays, one by one, in packets, on three threads, and through bricks: all the same."""
    field = build_voxel_field(voxels, device, dense_bytes=dense_bytes).field
    o, d = vectors(origins, device), vectors(directions, device)
    hits = cast_voxel_rays(field, o, d, packets=False).numpy()
    np.testing.assert_array_equal(cast_voxel_rays(field, o, d).numpy(), hits)
    np.testing.assert_array_equal(cast_voxel_rays(field, o, d, threads=3).numpy(), hits)
    return hits


def compare_with_oracle(voxels, origins, directions, hits, steps=300):
    """Rays that no shift of the band changes hit what the float64 walk hits; how many those are."""
    occupied = {tuple(cell) for cell in voxels.ijk.tolist()}
    shifts = [sign * GRAZING_BAND * axis for axis in np.eye(3) for sign in (-1, 1)]
    compared = 0
    origins, directions = (np.asarray(a, dtype=np.float32).astype(np.float64) for a in (origins, directions))
    for o, d, hit in zip(origins, directions, hits, strict=True):
        expected = first_voxel(occupied, o, d, VOXEL, steps)
        if all(first_voxel(occupied, o + shift, d, VOXEL, steps) == expected for shift in shifts):
            compared += 1
            assert (tuple(voxels.ijk[hit].tolist()) if hit >= 0 else None) == expected, (o, d)
    return compared


def room_rays(seed, count, scale=1.0):
    rng = np.random.default_rng(seed)
    origins = rng.uniform([0.2, 0.2, 0.2], [2.8, 2.3, 1.3], (count, 3)) * scale
    directions = rng.normal(size=(count, 3))
    return origins, directions


@pytest.mark.parametrize("seed", range(3))
def test_rays_in_a_cluttered_room_hit_what_the_walk_and_the_mesh_hit(device, seed):
    room = np.rint(cluttered_room(seed) / VOXEL).astype(np.int32)
    voxels = voxel_map(room)
    origins, directions = room_rays(seed, 161)
    hits = cast(voxels, origins, directions, device)
    assert compare_with_oracle(voxels, origins, directions, hits) > 150
    surface = build_surface(voxels, device)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    mesh_hits = cast_rays(surface.surface, vectors(origins, device), vectors(unit, device)).numpy()
    # The mesh takes unit vectors, whose rounding is another ray's: grazing rays may differ.
    assert np.mean(hits == mesh_hits) > 0.99


def test_origins_in_voxels_outside_and_far_away_hit_what_the_walk_hits(device):
    rng = np.random.default_rng(5)
    voxels = voxel_map(rng.integers(-20, 20, (3000, 3)))
    targets = voxels.ijk[rng.integers(0, len(voxels), 400)] * VOXEL + rng.uniform(-0.02, 0.02, (400, 3))
    origins = targets + rng.normal(size=(400, 3)) * np.repeat([0.01, 0.5, 3.0, 20.0], 100)[:, None]
    directions = (targets - origins) * rng.uniform(0.01, 100.0, (400, 1))
    hits = cast(voxels, origins, directions, device)
    assert compare_with_oracle(voxels, origins, directions, hits, steps=3000) > 330
    own = np.rint(origins[:100] / VOXEL).astype(np.int32)
    inside = [k for k in range(100) if (voxels.ijk == own[k]).all(axis=1).any()]
    assert inside
    for k in inside:
        if np.abs(origins[k] / VOXEL - own[k]).max() < 0.499:
            assert tuple(voxels.ijk[hits[k]]) == tuple(own[k])


def test_rays_along_axes_with_zeros_and_tiny_components_hit_what_the_walk_hits(device):
    rng = np.random.default_rng(6)
    voxels = voxel_map(rng.integers(-15, 15, (400, 3)))
    origins = rng.uniform(-1.0, 1.0, (320, 3))
    directions = rng.choice(
        [0.0, -0.0, 1.0, -1.0, 1e-9, -1e-9, 1e-30], (320, 3), p=[0.3, 0.1, 0.2, 0.2, 0.1, 0.05, 0.05]
    )
    directions[np.abs(directions).max(axis=1) < 0.5, 0] = 1.0
    hits = cast(voxels, origins, directions, device)
    assert compare_with_oracle(voxels, origins, directions, hits, steps=120) > 88


def test_rays_that_start_on_faces_and_corners_end(device):
    voxels = voxel_map(np.random.default_rng(7).integers(-4, 4, (60, 3)))
    # Faces of cells lie half a voxel beside multiples of the voxel size; 0.25 of 1 keeps them exact in float32.
    exact = VoxelMap(VoxelGrid(0.25, np.zeros(3, np.int64)), voxels.ijk, voxels.counts)
    steps = np.stack(np.meshgrid(*[np.arange(-9, 10) * 0.125] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    signs = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [1, 1, 0], [-1, 0, 1], [1, 1, 1], [-1, -1, -1], [1, -1, 1]])
    origins, directions = np.repeat(steps, len(signs), axis=0), np.tile(signs, (len(steps), 1))
    hits = cast(exact, origins, directions, device)
    # A hit touches its closed cube: the slab test in float64, exact for these numbers.
    hit = hits >= 0
    assert hit.any() and not hit.all()
    lower = (exact.ijk[hits[hit]] - 0.5) * 0.25 - origins[hit]
    upper = lower + 0.25
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = lower / directions[hit], upper / directions[hit]
    parallel = directions[hit] == 0
    near = np.where(parallel, np.where((lower <= 0) & (upper >= 0), -np.inf, np.inf), np.minimum(a, b)).max(axis=1)
    far = np.where(parallel, np.inf, np.maximum(a, b)).min(axis=1)
    assert np.all(np.maximum(near, 0) <= far)


def test_a_ray_never_passes_between_two_voxels_that_share_a_face(device):
    j, k = np.meshgrid(np.arange(-30, 31), np.arange(-30, 31), indexing="ij")
    wall = np.stack([np.full(j.size, 20), j.ravel(), k.ravel()], axis=1)
    rng = np.random.default_rng(8)
    # Towards edges and corners of the wall's cells, as exactly as float32 can.
    targets = np.column_stack([np.full(4000, 0.975), (rng.integers(-20, 20, (4000, 2)) + 0.5) * VOXEL])
    origins = rng.uniform([-0.5, -0.5, -0.5], [0.5, 0.5, 0.5], (4000, 3))
    assert (cast(voxel_map(wall), origins, targets - origins, device) >= 0).all()


def test_a_ray_through_a_diagonal_gap_of_some_width_passes(device):
    voxels = voxel_map([[0, 0, 0], [1, 1, 0], [5, -4, 0]])
    gap = np.array([0.5, 0.5, 0.0]) * VOXEL
    through = np.array([1.0, -1.0, 0.0])
    # Exactly through the shared edge either voxel or none may be met; clearly beside it, the voxel of that side.
    for shift, expected in ((0.004, 1), (-0.004, 0)):
        origin = gap - 0.1 * through + shift
        assert voxels.ijk[cast(voxels, [origin], [through], device)[0]].tolist() == [[0, 0, 0], [1, 1, 0]][expected]


@pytest.mark.parametrize("center_offset", [0.0, 0.5])
def test_cells_that_start_at_multiples_are_hit_there(device, center_offset):
    voxels = voxel_map([[3, 0, 0], [6, 1, 0]], center_offset)
    y = (center_offset + 0.9) * VOXEL  # in the row of the second voxel, near the first's
    assert cast(voxels, [[0, y, center_offset * VOXEL]], [[1, 0, 0]], device).tolist() == [1]


def test_long_rays_in_a_sparse_map_hit_what_the_walk_hits(device):
    rng = np.random.default_rng(9)
    voxels = voxel_map(np.column_stack([rng.integers(0, 2000, 60), rng.integers(0, 100, 60), rng.integers(0, 40, 60)]))
    targets = voxels.ijk[rng.integers(0, 60, 64)] * VOXEL + rng.uniform(-0.024, 0.024, (64, 3))
    origins = np.column_stack([rng.choice([-1.0, 101.0], 64), rng.uniform(0, 5, 64), rng.uniform(0, 2, 64)])
    hits = cast(voxels, origins, targets - origins, device)
    assert (hits >= 0).mean() > 0.95
    assert compare_with_oracle(voxels, origins, targets - origins, hits, steps=5000) > 55


def test_what_is_no_ray_hits_nothing(device):
    voxels = voxel_map(np.random.default_rng(10).integers(-5, 5, (100, 3)))
    nan, inf = np.nan, np.inf
    directions = [
        [nan, 0, 0],
        [0, nan, 1],
        [nan] * 3,
        [0, 0, 0],
        [inf, 0, 0],
        [inf, -inf, 0],
        [1e-40, 0, 0],
        [1e30, 1, 0],
    ]
    origins = np.full((len(directions), 3), 0.01)
    assert cast(voxels, origins, directions, device).tolist() == [-1] * len(directions)
    origins = [[nan, 0, 0], [0, inf, 0], [-inf, 0, nan], [3e38, 3e38, 3e38], [-3e38, 0, 0]]
    hits = cast(voxels, origins, [[1, 0.1, 0.2]] * len(origins), device)
    assert hits[:4].tolist() == [-1] * 4


def test_rays_that_miss_the_box_hit_nothing(device):
    voxels = voxel_map([[0, 0, 0], [3, 3, 3]])
    origins = [[-1, 0, 0], [-1, 0, 0], [-1, 0.3, 0], [0, 0, 1], [500, 500, 500.2]]
    directions = [[1, 0, 0], [-1, 0, 0], [1, 0, 0], [0, 0, 1], [-1, -1, -1]]
    assert cast(voxels, origins, directions, device).tolist() == [0, -1, -1, -1, -1]


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 33])
def test_any_number_of_rays_is_cast(device, count):
    voxels = voxel_map([[5, 0, 0]])
    hits = cast(voxels, np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0], (count, 1)), device)
    assert hits.tolist() == [0] * count


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    size=st.integers(1, 24),
    count=st.integers(1, 200),
    spread=st.sampled_from([0.3, 1.0, 4.0, 1e3]),
)
def test_packets_one_ray_and_bricks_give_the_same_bits(seed, size, count, spread):
    rng = np.random.default_rng(seed)
    voxels = voxel_map(rng.integers(0, size, (count, 3)))
    origins = rng.uniform(-1, 1, (70, 3)) * spread * size * VOXEL
    lattice = rng.random(70) < 0.3
    origins[lattice] = np.rint(origins[lattice] / VOXEL * 2) * VOXEL / 2
    directions = voxels.ijk[rng.integers(0, len(voxels), 70)] * VOXEL - origins
    directions[rng.random((70, 3)) < 0.15] = 0.0
    dense = cast(voxels, origins, directions)
    np.testing.assert_array_equal(cast(voxels, origins, directions, dense_bytes=0), dense)


def test_bricks_give_the_same_hits_as_one_dense_field(device):
    rng = np.random.default_rng(12)
    voxels = voxel_map(
        np.column_stack([rng.integers(0, 700, 400), rng.integers(0, 60, 400), rng.integers(0, 300, 400)])
    )
    origins = rng.uniform([0, 0, 0], [20, 3, 10], (500, 3))
    directions = voxels.ijk[rng.integers(0, len(voxels), 500)] * VOXEL - origins
    dense = cast(voxels, origins, directions, device)
    np.testing.assert_array_equal(cast(voxels, origins, directions, device, dense_bytes=0), dense)
    assert (dense >= 0).mean() > 0.9


def test_a_map_with_outliers_kilometres_away_is_hit_where_it_is_without_them(device):
    rng = np.random.default_rng(5)
    near = rng.integers(0, [80, 60, 30], (600, 3))
    far = rng.integers(-100_000, 100_000, (20, 3))
    origins = rng.uniform([0, 0, 0], [4, 3, 1.5], (300, 3))
    directions = near[rng.integers(0, len(near), 300)] * VOXEL - origins
    alone, both = voxel_map(near), voxel_map(np.concatenate([near, far]))
    hits, expected = cast(both, origins, directions, device), cast(alone, origins, directions, device)
    assert (expected >= 0).all()
    # A field 200,000 cells wide places a ray to a hundredth of a cell: a few that graze an edge pass on the other side.
    assert (both.ijk[hits] == alone.ijk[expected]).all(axis=1).mean() > 0.98


def test_bricks_beyond_the_reach_of_int32_cells_are_found():
    voxels = voxel_map(np.rint(cluttered_room(0) / VOXEL).astype(np.int32))
    origins, directions = (vectors(rays, "cpu") for rays in room_rays(0, 200))
    field = build_voxel_field(voxels, dense_bytes=0).field
    hits = cast_voxel_rays(field, origins, directions).numpy()
    # The same bricks as if 2^23 others came before them: 512 cells each are 2^32.
    bricks, real = 1 << 23, field.clearance
    field.clearance = wp.array(
        ptr=real.ptr - 256 * bricks, shape=(64 * bricks + len(real),), dtype=wp.int32, device="cpu"
    )
    field.clearance_address = field.clearance.ptr
    field.brick_values = wp.array(field.brick_values.numpy() + bricks, dtype=wp.int32, device="cpu")
    for packets in (True, False):
        np.testing.assert_array_equal(cast_voxel_rays(field, origins, directions, packets=packets).numpy(), hits)
    assert (hits >= 0).mean() > 0.5 and len(real) > 0


def test_arrays_that_do_not_fit_together_are_named():
    voxels = voxel_map(np.rint(cluttered_room(0) / VOXEL).astype(np.int32))
    rays = vectors([[0.0, 0.0, 0.0]], "cpu"), vectors([[1.0, 0.0, 0.0]], "cpu")
    for name in ("columns", "ranks", "clearance"):
        field = build_voxel_field(voxels).field
        setattr(field, name, wp.clone(getattr(field, name))[:8])
        with pytest.raises(ValueError, match=rf"field\.{name}"):
            cast_voxel_rays(field, *rays)


def test_a_box_too_large_for_a_dense_field_is_refused():
    ijk = wp.array(np.array([[0, 0, 0], [2000, 2000, 2000]]), dtype=wp.vec3i, device="cpu")
    with pytest.raises(ValueError, match="too large for a dense field"):
        build_distance_field(ijk, (0, 0, 0), (2000, 2000, 2000), VOXEL, 0.0)
