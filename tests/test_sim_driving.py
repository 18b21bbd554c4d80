"""Free space of analytic rooms, ways through it, and drives along them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from maomaps_warp.errors import InputError
from maomaps_warp.sim.driving import Driving, drive_along
from maomaps_warp.sim.free_space import FreeSpace, Robot, find_floor, find_free_space
from maomaps_warp.sim.planning import WAY_STEP_M, Planner, rounded
from maomaps_warp.sim.scene import furnished_flat
from maomaps_warp.sim.world import World, plain_world

#: Metres: the mesh is float32, and so is the distance to it.
CLEARANCE_TOLERANCE = 1e-4
ROBOT = Robot(radius=0.2, height=1.2, camera_height=0.9)


def world_of(*meshes: trimesh.Trimesh) -> World:
    mesh = trimesh.util.concatenate(meshes)
    vertices, triangles = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    return plain_world(vertices, triangles, np.full((len(triangles), 3), 128, np.uint8), source="room")


def room(width: float = 6.0, depth: float = 4.0) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[[0, 0, 0], [width, depth, 2.5]])


def wall(x: float, y0: float, y1: float, top: float = 2.5, bottom: float = 0.0) -> trimesh.Trimesh:
    """A wall of no thickness across the room."""
    corners = [[x, y0, bottom], [x, y1, bottom], [x, y1, top], [x, y0, top]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def distance_to_box(points: np.ndarray, low: tuple[float, float], high: tuple[float, float]) -> np.ndarray:
    outside = np.maximum(np.maximum(np.asarray(low) - points, points - np.asarray(high)), 0.0)
    return np.linalg.norm(outside, axis=1)


def middles(space: FreeSpace) -> np.ndarray:
    return space.place_of(np.argwhere(np.ones_like(space.is_free)))


def test_a_robot_keeps_its_radius_from_walls_and_furniture(device: str) -> None:
    world = world_of(room(), trimesh.creation.box(bounds=[[2, 1, 0], [3, 2, 0.8]]))
    space = find_free_space(world, ROBOT, device=device)
    points = middles(space)
    to_walls = np.minimum(points, [6.0, 4.0] - points).min(axis=1)
    clearance = np.minimum(to_walls, distance_to_box(points, (2, 1), (3, 2)))
    clear = np.abs(clearance - ROBOT.radius) > CLEARANCE_TOLERANCE
    np.testing.assert_array_equal(space.is_free.reshape(-1)[clear], (clearance > ROBOT.radius)[clear])
    assert clear.mean() > 0.9 and space.floor_z == pytest.approx(0.0, abs=1e-6)


def test_walls_without_thickness_doors_lintels_and_table_tops_count() -> None:
    low_door = wall(4.5, 0.0, 4.0, bottom=1.0)  # a bar across the room at 1 m: the robot is 1.2 m high
    table = trimesh.creation.box(bounds=[[0.5, 2.5, 0.7], [1.5, 3.5, 0.75]])  # without legs
    space = find_free_space(world_of(room(), wall(2, 0, 1.5), wall(2, 2.5, 4), low_door, table), ROBOT)

    def inside(x: float, y: float) -> bool:
        return bool(space.holds(np.array([[x, y]]))[0])

    assert inside(2.0, 2.0) and not inside(2.0, 1.0) and not inside(2.0, 1.6)
    assert not inside(5.5, 2.0), "nobody gets under the bar"
    assert not inside(1.0, 3.0), "the table's top is in the way"
    low = Robot(radius=0.1, height=0.6, camera_height=0.4)
    under = find_free_space(world_of(room(), low_door, table), low)
    assert under.holds(np.array([[5.5, 2.0], [1.0, 3.0]])).all()


def test_the_floor_is_the_lowest_large_level_and_not_the_slab_under_it() -> None:
    slab = trimesh.creation.box(bounds=[[0, 0, -0.2], [6, 4, 0.0]])
    ceiling = trimesh.creation.box(bounds=[[0, 0, 2.5], [6, 4, 2.7]])
    carpet = trimesh.creation.box(bounds=[[1, 1, 0], [2, 2, 0.02]])
    assert find_floor(world_of(slab, ceiling, carpet)) == pytest.approx(0.0, abs=0.021)
    assert find_floor(furnished_flat(0).world) == pytest.approx(furnished_flat(0).floor_z, abs=0.021)


def test_what_has_no_floor_is_refused_unless_its_height_is_said() -> None:
    walls = world_of(*(wall(x, 0, 4) for x in (0.0, 3.0)))
    with pytest.raises(InputError, match=r"room: has no floor.*--floor"):
        find_free_space(walls, ROBOT)
    shelf = trimesh.creation.box(bounds=[[1.0, 0, 0.7], [1.3, 4, 0.75]])  # level, but too narrow to stand on
    with pytest.raises(InputError, match=r"fits nowhere where a surface lies .*--floor 0.7"):
        find_free_space(world_of(*(wall(x, 0, 4) for x in (0.0, 1.0, 1.3, 3.0)), shelf), ROBOT)
    assert find_free_space(walls, ROBOT, floor_z=0.0).area > 5.0


def test_a_robot_that_fits_nowhere_is_told_so() -> None:
    with pytest.raises(InputError, match=r"a robot 6 m wide and 1.2 m high fits nowhere"):
        find_free_space(world_of(room()), Robot(radius=3.0, height=1.2, camera_height=0.9))


def test_only_the_largest_region_counts_and_the_nearest_place_is_named() -> None:
    space = find_free_space(world_of(room(), wall(2, 0, 4)), ROBOT)
    assert not space.holds(np.array([[1.0, 2.0]]))[0]
    small = find_free_space(world_of(room(), wall(2, 0, 4)), ROBOT, around=np.array([1.0, 2.0]))
    assert small.holds(np.array([[1.0, 2.0]]))[0] and not small.holds(np.array([[4.0, 2.0]]))[0]
    nearest = space.nearest(np.array([1.0, 2.0]))
    assert nearest[0] == pytest.approx(2.2, abs=0.06) and nearest[1] == pytest.approx(2.0, abs=0.03)


@pytest.fixture(scope="module")
def two_rooms() -> FreeSpace:
    return find_free_space(world_of(room(), wall(3, 0, 1.5), wall(3, 2.5, 4)), ROBOT)


def test_the_shortest_way_goes_through_the_door_and_keeps_off_its_frame(two_rooms: FreeSpace) -> None:
    start, goal = np.array([1.0, 0.6]), np.array([5.0, 0.6])
    way = Planner(two_rooms).way(start, goal)
    assert two_rooms.holds(way).all()
    np.testing.assert_allclose(way[[0, -1]], [start, goal], rtol=0, atol=two_rooms.cell)
    through = way[np.abs(way[:, 0] - 3.0) <= two_rooms.cell]
    assert len(through) and np.abs(through[:, 1] - 2.0).max() < 0.31
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    least = np.hypot(2.0, 1.1) + np.hypot(2.0, 1.1)  # straight to the door's near side and on
    assert least < length < 1.25 * least


def test_a_rounded_way_stays_free_has_its_ends_and_even_steps(two_rooms: FreeSpace) -> None:
    way = Planner(two_rooms).way(np.array([0.4, 0.4]), np.array([5.6, 3.6]))
    smooth = rounded(way, two_rooms)
    assert two_rooms.holds(smooth).all()
    np.testing.assert_allclose(smooth[[0, -1]], way[[0, -1]], rtol=0, atol=1e-9)
    assert np.linalg.norm(np.diff(smooth, axis=0), axis=1).max() < 1.6 * WAY_STEP_M

    def sharpest(track: np.ndarray) -> float:
        step = np.diff(track[::10], axis=0)
        return float(np.abs(np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))).max())

    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    even = np.linspace(0.0, along[-1], len(smooth))
    angular = np.stack([np.interp(even, along, way[:, k]) for k in range(2)], axis=1)
    assert sharpest(smooth) < 0.6 * sharpest(angular)


def test_an_exploration_comes_near_everything_is_long_enough_and_repeats_with_its_seed(two_rooms: FreeSpace) -> None:
    start = np.array([1.0, 1.0])
    planner = Planner(two_rooms)
    way = planner.exploration(start, 30.0, seed=3)
    assert two_rooms.holds(way).all()
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() >= 30.0
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() < 1.5 * two_rooms.cell
    free = two_rooms.place_of(np.argwhere(two_rooms.is_free))
    assert np.linalg.norm(free[:, None] - way[None, ::5], axis=2).min(axis=1).max() < 1.6
    np.testing.assert_array_equal(way, Planner(two_rooms).exploration(start, 30.0, seed=3))
    assert len(way) != len(other := planner.exploration(start, 30.0, seed=4)) or (way != other).any()


def test_a_drive_is_smooth_looks_ahead_and_never_turns_too_fast(two_rooms: FreeSpace) -> None:
    way = rounded(Planner(two_rooms).exploration(np.array([1.0, 1.0]), 20.0, seed=1), two_rooms)
    driving = Driving(speed=0.6, turn_rate=0.7, rate_hz=20.0, pitch=-0.1)
    trajectory = drive_along(way, 0.9, driving)
    assert two_rooms.holds(trajectory.positions[:, :2]).all()
    np.testing.assert_array_equal(trajectory.positions[:, 2], 0.9)
    assert trajectory.stamps_ns is not None
    seconds = np.diff(trajectory.stamps_ns) / 1e9
    np.testing.assert_allclose(seconds, 0.05, rtol=0, atol=1e-9)
    speed = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1) / seconds
    assert speed.max() <= driving.speed * (1 + 1e-9) and speed[0] < 0.1 * driving.speed
    forward = trajectory.T_world_camera[:, :3, 2]
    np.testing.assert_allclose(forward[:, 2], np.sin(-0.1), rtol=0, atol=1e-12)
    yaw = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    assert np.abs(np.diff(yaw) / seconds).max() <= driving.turn_rate * (1 + 1e-9)
    moved = np.diff(trajectory.positions[:, :2], axis=0)
    ahead = np.einsum("ij,ij->i", moved, forward[1:, :2]) / np.maximum(np.linalg.norm(moved, axis=1), 1e-9)
    assert np.median(ahead) > 0.98


def test_a_drive_ends_when_its_time_is_over(two_rooms: FreeSpace) -> None:
    way = rounded(Planner(two_rooms).exploration(np.array([1.0, 1.0]), 20.0, seed=1), two_rooms)
    assert len(drive_along(way, 0.9, Driving(), duration=6.0)) == 61


def test_a_furnished_flat_is_explored_through_all_its_doors() -> None:
    scene = furnished_flat(0)
    space = find_free_space(scene.world, Robot())
    way = Planner(space).exploration(scene.tour[0], 40.0, seed=0)
    assert space.holds(scene.tour).mean() > 0.8
    for place in scene.rooms:
        inside = (way > [place.x_min, place.y_min]).all(axis=1) & (way < [place.x_max, place.y_max]).all(axis=1)
        assert inside.any(), place.name
