"""The furnished flat and the drive through it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh

from maomaps_warp.sim.agent import START_NS, drive
from maomaps_warp.sim.scene import Scene, furnished_flat

SEEDS = range(5)
#: Metres: the least distance of the camera's way from walls and furniture, on the floor plan.
CLEARANCE = 0.35
#: Metres above the floor: rugs can be walked over, lamps and lintels are overhead.
LOWEST_OBSTACLE, HIGHEST_OBSTACLE = 0.06, 2.0
#: Metres: no large face may lie nearer to a face or a centre of voxels of 0.05.
LATTICE_MARGIN = 0.01


def distance_to_segments(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    along = b - a
    share = np.clip(((point - a) * along).sum(1) / np.maximum((along**2).sum(1), 1e-12), 0.0, 1.0)
    return float(np.sqrt(((a + share[:, None] * along - point) ** 2).sum(1).min()))


def obstacle_edges(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Ends, on the floor plan, of the edges of all triangles that somebody could run into."""
    corners = scene.vertices[scene.triangles].astype(float)
    height = corners[:, :, 2] - scene.floor_z
    corners = corners[(height.max(1) > LOWEST_OBSTACLE) & (height.min(1) < HIGHEST_OBSTACLE)][:, :, :2]
    pairs = np.concatenate([corners[:, [i, j]] for i, j in ((0, 1), (1, 2), (2, 0))])
    pairs = np.unique(pairs.reshape(-1, 4), axis=0)
    return pairs[:, :2], pairs[:, 2:]


def test_the_same_seed_gives_the_same_flat_and_another_seed_another() -> None:
    a, b, c = furnished_flat(5), furnished_flat(5), furnished_flat(6)
    for name in ("vertices", "triangles", "face_colors", "tour"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
    assert a.rooms == b.rooms and a.doors == b.doors
    assert a.rooms != c.rooms


@pytest.mark.parametrize("seed", SEEDS)
def test_the_flat_is_made_of_closed_bodies_with_faces_outwards(seed: int) -> None:
    scene = furnished_flat(seed)
    assert scene.vertices.dtype == np.float32 and scene.triangles.dtype == np.int32
    assert scene.face_colors.shape == scene.triangles.shape and scene.face_colors.dtype == np.uint8
    mesh = trimesh.Trimesh(scene.vertices, scene.triangles, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    corners = scene.vertices[scene.triangles].astype(float)
    labels = trimesh.graph.connected_component_labels(mesh.edges, node_count=len(scene.vertices))
    # Six times each body's volume, summed over its triangles: positive if they look outwards.
    body = labels[scene.triangles[:, 0]]
    first = scene.vertices[np.unique(labels, return_index=True)[1]][body].astype(float)
    x, y, z = (corners[:, k] - first for k in range(3))
    volumes = np.bincount(body, np.einsum("ij,ij->i", x, np.cross(y, z)))
    assert volumes.min() > 0.0


@pytest.mark.parametrize("seed", SEEDS)
def test_no_large_face_lies_on_a_face_or_a_centre_of_voxels(seed: int) -> None:
    scene = furnished_flat(seed)
    corners = scene.vertices[scene.triangles].astype(float)
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    checked = 0
    for axis in range(3):
        level = corners[:, :, axis]
        flat = (np.ptp(level, axis=1) < 1e-5) & (areas > 0.02)
        off = np.abs(level[flat, 0] / 0.025 - np.rint(level[flat, 0] / 0.025)) * 0.025
        assert off.min() > LATTICE_MARGIN
        checked += np.count_nonzero(flat)
    assert checked > 200


def test_four_rooms_of_about_four_by_three_and_a_half_metres_do_not_overlap() -> None:
    for seed in SEEDS:
        rooms = furnished_flat(seed).rooms
        assert {room.name for room in rooms} == {"living room", "kitchen", "study", "bedroom"}
        for room in rooms:
            assert 3.8 < room.x_max - room.x_min < 4.2 and 3.35 < room.y_max - room.y_min < 3.7
        for a, b in itertools.combinations(rooms, 2):
            apart_x = a.x_max < b.x_min or b.x_max < a.x_min
            assert apart_x or a.y_max < b.y_min or b.y_max < a.y_min


@pytest.mark.parametrize("seed", SEEDS)
def test_the_drive_keeps_clear_of_walls_and_furniture(seed: int) -> None:
    scene = furnished_flat(seed)
    positions = drive(scene, frames=240, seed=seed).positions[::2]
    start, end = obstacle_edges(scene)
    assert len(start) > 1000
    # Steps are shorter than the clearance: the way cannot jump over an outline, so it is outside of all.
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() < CLEARANCE
    assert min(distance_to_segments(p[:2], start, end) for p in positions) > CLEARANCE


@pytest.mark.parametrize("seed", SEEDS)
def test_the_drive_goes_through_all_rooms_by_the_doors_and_comes_back(seed: int) -> None:
    scene = furnished_flat(seed)
    positions = drive(scene, frames=240, seed=seed).positions
    room_of = [
        next((i for i, r in enumerate(scene.rooms) if r.x_min < x < r.x_max and r.y_min < y < r.y_max), None)
        for x, y, _ in positions
    ]
    visited = [key for key, _ in itertools.groupby(i for i in room_of if i is not None)]
    assert visited == [0, 1, 2, 3, 0]
    for door in scene.doors:
        nearest = positions[np.argmin(np.hypot(positions[:, 0] - door.x, positions[:, 1] - door.y))]
        beside = abs(nearest[1] - door.y) if door.across == "x" else abs(nearest[0] - door.x)
        assert beside < door.width / 2 - CLEARANCE
    np.testing.assert_allclose(positions[0], positions[-1], rtol=0, atol=1e-6)


@pytest.mark.parametrize(("frames", "rate_hz"), [(240, 10.0), (900, 30.0), (240, 5.0)])
def test_the_camera_turns_slower_than_60_degrees_a_second(frames: int, rate_hz: float) -> None:
    trajectory = drive(furnished_flat(2), frames=frames, rate_hz=rate_hz, seed=4)
    R = trajectory.T_world_camera[:, :3, :3]
    cosines = (np.einsum("nij,nij->n", R[1:], R[:-1]) - 1.0) / 2.0
    assert np.degrees(np.arccos(cosines)).max() * rate_hz < 60.0


def test_poses_are_optical_level_and_stamped() -> None:
    scene = furnished_flat(0)
    trajectory = drive(scene, frames=100, rate_hz=4.0, height=1.3)
    R = trajectory.T_world_camera[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (100, 1, 1)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_allclose(R[:, 2, 0], 0.0, rtol=0, atol=1e-12)  # x right is level
    assert (R[:, 2, 1] < -0.9).all()  # y down
    assert (np.abs(R[:, 2, 2]) < 0.3).all()  # z forward, slightly pitched
    np.testing.assert_allclose(trajectory.positions[:, 2] - scene.floor_z, 1.3, rtol=0, atol=0.02)
    np.testing.assert_array_equal(trajectory.stamps_ns, START_NS + np.arange(100) * 250_000_000)
    # Mostly the camera looks where it goes.
    step = np.diff(trajectory.positions, axis=0)
    ahead = (step * R[:-1, :, 2]).sum(1) / np.linalg.norm(step, axis=1)
    assert np.mean(ahead > 0.5) > 0.8


def test_the_same_seed_gives_the_same_drive() -> None:
    scene = furnished_flat(0)
    a, b, c = (drive(scene, seed=seed).T_world_camera for seed in (1, 1, 2))
    assert a.tobytes() == b.tobytes() != c.tobytes()


def test_a_drive_that_is_too_short_says_how_long_it_must_be() -> None:
    with pytest.raises(ValueError, match=r"needs more than \d+\.\d s, got 0\.9 s"):
        drive(furnished_flat(0), frames=10)


def test_every_triangle_belongs_to_a_kind_of_thing() -> None:
    world = furnished_flat(3).world
    assert len(world.face_part) == len(world.triangles) and set(world.face_part) == set(range(len(world.parts)))
    assert {"floor", "ceiling", "wall", "door frame", "chair", "bed", "sofa", "counter", "table"} <= set(world.parts)
    assert "" not in world.parts
    floor = world.vertices[world.triangles[world.face_part == world.parts.index("floor")]]
    assert floor[..., 2].max() == np.float32(furnished_flat(3).floor_z)
    chairs = world.vertices[world.triangles[world.face_part == world.parts.index("chair")]]
    assert 0.8 < chairs[..., 2].max() < 1.0, "its legs are the chair's, though a table's legs are made alike"
