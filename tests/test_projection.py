"""Projections against a plain loop over columns, and grounds of scenes whose floor is known."""

from __future__ import annotations

import numpy as np
import pytest
from tum_sample import read_tum

from maomaps_warp.errors import InputError
from maomaps_warp.mapping.projection import Ground, find_ground, project
from maomaps_warp.model.occupancy import Cell

V = 0.05
#: One voxel: a height is rounded to a layer. Metres.
ONE_LAYER = V + 1e-9


def slab(x, y, z, voxel=V):
    """Voxel centres of a box, each side given as (from, to) in metres, the end exclusive, or as one layer."""
    sides = [np.arange(round(a / voxel), max(round(b / voxel), round(a / voxel) + 1)) for a, b in (x, y, z)]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3) * voxel


def floor(z=0.0, x=(0, 4), y=(0, 3), voxel=V):
    return slab(x, y, (z, z), voxel)


def room(z=0.0, height=2.5, ceiling=True):
    """A floor, two walls and, if wanted, a ceiling."""
    parts = [floor(z), slab((0, 4), (0, 0), (z, z + height)), slab((0, 0), (0, 3), (z, z + height))]
    return np.concatenate(parts + [floor(z + height)] * ceiling)


def table(z=0.75, x=(1, 3), y=(1, 2)):
    return slab(x, y, (z, z))


def layers_of(points):
    """Voxels by layer: {index: count}."""
    found = {}
    for z in points[:, 2]:
        found[round(z / V)] = found.get(round(z / V), 0) + 1
    return found


def projected_by_loop(points, ground_z, voxel=V):
    """{(i, j): kind} by the rule as it is stated, in whole millimetres."""
    found = {}
    for x, y, z in points:
        above = round((z - ground_z) * 1000)
        if -100 <= above <= 100:
            kind = Cell.FREE
        elif 100 < above < 1500:
            kind = Cell.OCCUPIED
        else:
            kind = Cell.UNKNOWN
        key = round(x / voxel), round(y / voxel)
        found[key] = max(found.get(key, Cell.UNKNOWN), kind)
    return found


@pytest.mark.parametrize("shift", [(0, 0), (-7, 3), (91_234, -80_001)])
def test_the_projection_is_that_of_a_loop_over_the_columns(shift):
    random = np.random.default_rng(3)
    ijk = np.unique(random.integers([-20, -15, -8], [25, 30, 45], (3000, 3)), axis=0) + [*shift, 0]
    points = ijk * V
    for ground_z in (0.0, -0.3, 0.113):
        grid = project(points, V, Ground(ground_z, True, "given"))
        expected = projected_by_loop(points, ground_z)
        assert sum(grid.counts[k] for k in ("free", "occupied", "unknown")) == grid.counts["total"] == grid.cells.size
        low = ijk[:, :2].min(axis=0)
        for row in range(grid.cells.shape[0]):
            for column in range(grid.cells.shape[1]):
                key = low[0] + column, low[1] + row
                assert grid.cells[row, column] == expected.get(key, Cell.UNKNOWN)
        assert grid.cells.shape == tuple((ijk[:, :2].max(axis=0) - low + 1)[::-1])


def test_cells_are_centred_on_multiples_of_the_voxel_size():
    grid = project(np.array([[1.0, -2.0, 0.0], [1.5, -1.0, 0.0]]), V, Ground(0.0, True, "given"))
    assert grid.origin == pytest.approx((0.975, -2.025, 0.0), abs=1e-12)
    np.testing.assert_allclose(grid.centers(grid.cells == Cell.FREE), [[1.0, -2.0], [1.5, -1.0]], rtol=0, atol=1e-12)


def test_heights_at_the_limits_belong_where_the_rule_says():
    heights = [-0.15, -0.1, 0.1, 0.15, 1.45, 1.5]
    kinds = [Cell.UNKNOWN, Cell.FREE, Cell.FREE, Cell.OCCUPIED, Cell.OCCUPIED, Cell.UNKNOWN]
    # Sums of decimals: 0.3 + 0.1 is not 0.4 exactly.
    points = np.array([[i * V, 0.0, 0.3 + z] for i, z in enumerate(heights)])
    assert project(points, V, Ground(0.3, True, "given")).cells[0].tolist() == kinds


def test_an_obstacle_wins_over_ground_whatever_the_order():
    points = np.array([[0, 0, 0], [0, 0, 1.0], [V, 0, 1.0], [V, 0, 0]])
    assert project(points, V, Ground(0.0, True, "given")).cells.tolist() == [[Cell.OCCUPIED, Cell.OCCUPIED]]


def test_outliers_that_make_the_image_absurd_are_refused():
    points = np.array([[0.0, 0, 0], [40_000.0, 40_000.0, 0]])
    with pytest.raises(InputError, match=r"flat\.pcd: 40000.* too many"):
        project(points, V, Ground(0.0, True, "given"), "flat.pcd")


def test_the_original_rule_takes_the_fullest_layer_of_the_lower_half():
    points = np.concatenate([room(ceiling=True), floor(2.5, x=(0, 9))])
    low, high = points[:, 2].min(), points[:, 2].max()
    counts = {k: n for k, n in layers_of(points).items() if k * V <= (low + high) / 2 + 1e-9}
    fullest = max(counts, key=lambda k: (counts[k], -k))
    assert find_ground(points, V, "original") == Ground(pytest.approx(fullest * V), True, "original")
    # The rule's weakness: in the lower half of two storeys the ceiling between them may be fuller than the floor.
    assert find_ground(np.concatenate([points, room(2.8)]), V, "original").z == pytest.approx(2.5)


def test_of_equally_full_layers_the_original_rule_takes_the_lowest():
    assert find_ground(np.array([[0, 0, 0.0], [0, 0, 0.1], [0, 0, 1.0]]), V, "original").z == 0.0


def test_a_height_is_taken_as_given():
    assert find_ground(room(), V, "0.35") == Ground(0.35, True, "given")


@pytest.mark.parametrize("rule", ["nearest", "", "nan", "inf", "0,35"])
def test_another_word_is_no_rule(rule):
    with pytest.raises(InputError, match="robust, original, or a height"):
        find_ground(room(), V, rule)


@pytest.mark.parametrize("base", [0.0, -31.4])
def test_a_plain_room_stands_on_its_floor(base):
    found = find_ground(room(base), V)
    assert found.is_found and found.rule == "robust"
    assert found.z == pytest.approx(base, abs=1e-9)


def test_a_ceiling_fuller_than_the_floor_is_no_ground():
    hidden = floor()[(floor()[:, 0] > 2.0)]
    points = np.concatenate([hidden, slab((0, 4), (0, 0), (0, 2.5)), floor(2.5)])
    assert find_ground(points, V).z == pytest.approx(0.0, abs=1e-9)
    assert find_ground(points, V, camera_heights=np.full(9, 1.2)).z == pytest.approx(0.0, abs=1e-9)


def test_a_table_larger_than_the_visible_floor_is_no_ground():
    strip = floor(x=(0, 4), y=(0, 1.2))
    points = np.concatenate([strip, table(x=(0, 3.5), y=(1.2, 3.6))])
    assert layers_of(points)[15] > layers_of(points)[0]
    for cameras in (None, np.full(5, 1.5)):
        found = find_ground(points, V, camera_heights=cameras)
        assert found.is_found and found.z == pytest.approx(0.0, abs=1e-9)
    assert "0.00, 0.75 m" in found.note


def test_a_chair_seat_and_a_shelf_do_not_stand_out():
    points = np.concatenate([table(0.45, (1, 1.4), (1, 1.4)), slab((2, 3), (1, 1.15), (0.3, 0.3)), floor(0.0)])
    assert find_ground(points, V).note == ""


def test_of_two_storeys_the_cameras_choose_theirs():
    points = np.concatenate([room(0.0), room(2.8)])
    assert find_ground(points, V).z == pytest.approx(0.0, abs=1e-9)
    assert find_ground(points, V, camera_heights=np.full(9, 1.3)).z == pytest.approx(0.0, abs=1e-9)
    assert find_ground(points, V, camera_heights=np.full(9, 4.2)).z == pytest.approx(2.8, abs=1e-9)
    # A minority upstairs does not decide.
    mixed = np.r_[np.full(9, 1.3), np.full(4, 4.2)]
    assert find_ground(points, V, camera_heights=mixed).z == pytest.approx(0.0, abs=1e-9)


def test_a_slab_seen_from_below_is_not_the_floor_on_it():
    """The ceiling of the lower storey is as full as the floor 0.3 m above it and lies below the cameras too."""
    points = np.concatenate([floor(2.5), floor(2.8)])
    assert find_ground(points, V, camera_heights=np.full(3, 4.0)).z == pytest.approx(2.8, abs=1e-9)


def test_noise_below_the_floor_does_not_lower_it():
    random = np.random.default_rng(1)
    below = np.rint(random.uniform([0, 0, -2.0], [4, 3, -0.2], (1500, 3)) / V) * V
    found = find_ground(np.concatenate([room(), below]), V)
    assert found.is_found and found.z == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("voxel", [0.02, 0.05, 0.1])
def test_a_rough_floor_is_found_to_a_layer(voxel):
    random = np.random.default_rng(2)
    dense = random.uniform([0, 0, 0], [4, 3, 0], (60_000, 3)) + [0, 0, 0.4]
    dense[:, 2] += random.normal(0, 0.02, len(dense))
    points = np.unique(np.rint(dense / voxel), axis=0) * voxel
    found = find_ground(points, voxel)
    # The top of a rough floor counts: it lies up to two standard deviations above its middle.
    assert found.is_found and abs(found.z - 0.4) <= voxel + 0.04


def test_a_single_wall_is_no_ground():
    for thickness in (0.0, 0.25):
        points = slab((0, 5), (0, thickness), (0.5, 2.5))
        found = find_ground(points, V)
        assert not found.is_found and "no level layer" in found.note
        # The lowest per cent of a wall of 40 layers lies in its lowest layer.
        assert found.z == pytest.approx(0.5, abs=1e-9)


def test_walls_and_clutter_without_a_floor_are_no_ground():
    random = np.random.default_rng(4)
    clutter = np.rint(random.uniform(0, 3, (4000, 3)) / V) * V
    points = np.concatenate([slab((0, 4), (0, 0), (0, 2.5)), clutter])
    found = find_ground(points, V)
    assert not found.is_found
    below = np.count_nonzero(points[:, 2] < found.z - ONE_LAYER) / len(points)
    at_most = np.count_nonzero(points[:, 2] < found.z + ONE_LAYER) / len(points)
    assert below <= 0.01 <= at_most


def test_cameras_far_above_everything_find_no_ground_and_say_what_there_is():
    found = find_ground(room(ceiling=False), V, camera_heights=np.array([9.0, 9.1, 9.2]))
    assert not found.is_found
    assert "9.10 m" in found.note and "0.00 m" in found.note


def test_no_points_have_no_ground():
    found = find_ground(np.empty((0, 3)), V)
    assert not found.is_found and "no points" in found.note
    with pytest.raises(ValueError, match="at least one"):
        project(np.empty((0, 3)), V, found)


@pytest.mark.slow
def test_the_floor_of_the_real_recording_is_found_though_its_desk_is_as_full():
    """Motion capture puts the floor at z = 0; the Kinect bends it by some centimetres. Back-projected here."""
    frames = read_tum()
    focal, cx, cy = 525.0 / 4, 319.5 / 4, 239.5 / 4
    row, column = np.indices(frames.depth.shape[1:])
    points = []
    for stamp, depth in zip(frames.stamps_ns[::4], frames.depth[::4], strict=True):
        T = frames.T_world_camera[np.abs(frames.pose_stamps_ns - stamp).argmin()]
        seen = depth > 0
        rays = np.stack([(column - cx) / focal, (row - cy) / focal, np.ones(depth.shape)], axis=-1)
        points.append((rays * depth[..., None])[seen] @ T[:3, :3].T + T[:3, 3])
    voxels = np.unique(np.rint(np.concatenate(points) / V), axis=0) * V
    heights = frames.T_world_camera[:, 2, 3]
    full = layers_of(voxels)
    assert max(full[k] for k in range(14, 18)) > 0.9 * max(full[k] for k in range(-2, 3))
    for cameras in (heights, None):
        found = find_ground(voxels, V, camera_heights=cameras)
        assert found.is_found and abs(found.z) <= 0.1
