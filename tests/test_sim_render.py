"""The renderer against plain NumPy rays through boxes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from scipy.spatial.transform import Rotation

from maomaps_warp.kernels.appearance import create_appearance
from maomaps_warp.kernels.pixels import view_from
from maomaps_warp.kernels.render import MeshScene, render_scene
from maomaps_warp.kernels.triangle_tree import build_triangle_tree
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.render import in_memory, render_frames
from maomaps_warp.sim.scene import furnished_flat

#: Metres: float32 rays over a few metres are good to some 1e-6.
DEPTH_TOLERANCE = 1e-4
#: Metres: rays that pass an edge more closely may go to either side of it.
EDGE_BAND = 1e-4

ROOM = np.array([[-2.1, -1.7, 0.0], [2.3, 1.9, 2.6]])
BLOCK = np.array([[0.4, -0.5, 0.0], [1.1, 0.3, 0.9]])
GROWTH = EDGE_BAND * np.array([[-1.0], [1.0]])
#: x right, y down, z forward for a camera that looks along +x with z up.
LOOKING_ALONG_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
CAMERA = Camera(61, 45, 40.0, 42.0, 31.3, 20.8)


def mesh_of(boxes: list[np.ndarray], device: str) -> wp.Mesh:
    mesh = trimesh.util.concatenate([trimesh.creation.box(bounds=bounds) for bounds in boxes])
    return wp.Mesh(
        points=wp.array(mesh.vertices, dtype=wp.vec3f, device=device),
        indices=wp.array(mesh.faces.reshape(-1), dtype=wp.int32, device=device),
    )


@pytest.fixture(autouse=True, params=["rays", "tiles"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Down wp.Mesh's tree, and on a CPU down a tree of our own."""
    if request.param == "tiles" and request.node.callspec.params.get("device", "cpu") != "cpu":
        pytest.skip("tiles are for CPUs")
    monkeypatch.setitem(globals(), "WAY", request.param)
    return request.param


WAY = "rays"


def render(mesh: wp.Mesh, pose: np.ndarray, colors: np.ndarray | None = None, **options: object) -> tuple:
    """Depth and colours of a mesh whose faces have one colour each."""
    faces, device = mesh.indices.size // 3, mesh.device
    look = None
    if colors is not None:
        look = create_appearance([c.reshape(1, 1, 3) for c in colors], np.arange(len(colors)), device=device)
    both = wp.ones(faces, dtype=wp.uint8, device=device)
    surface = build_triangle_tree(mesh.points, mesh.indices) if WAY == "tiles" else mesh
    scene = MeshScene(surface, look, both, wp.zeros(faces, dtype=wp.int32, device=device))
    images = render_scene(scene, view_at(pose, options.pop("max_depth", 20.0)), CAMERA.height, **options)
    return images.depth, images.colors


def view_at(pose: np.ndarray, max_depth: float = 20.0) -> object:
    c = CAMERA
    transform = wp.transformf(wp.vec3f(*pose[:3, 3]), wp.quatf(*Rotation.from_matrix(pose[:3, :3]).as_quat()))
    return view_from(transform, c.width, c.fx, c.fy, c.cx, c.cy, max_depth)


def pose_at(position: list[float], rotation: np.ndarray = LOOKING_ALONG_X) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def slabs(bounds: np.ndarray, origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ray parameters at which `rays` enter and leave a box (the slab method), float64."""
    with np.errstate(divide="ignore"):
        t = (bounds[:, None, None, :] - origin) / rays
    return t.min(axis=0).max(axis=-1), t.max(axis=0).min(axis=-1)


def expected_depth(pose: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Depth inside ROOM with a block in it, seen from outside of the block."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    in_camera = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
    rays = in_camera @ pose[:3, :3].T
    _, wall = slabs(ROOM, pose[:3, 3], rays)
    enter, leave = slabs(block, pose[:3, 3], rays)
    return np.where((enter < leave) & (enter > 0.0), np.minimum(enter, wall), wall)


def test_depth_agrees_with_numpy_rays_in_a_room_with_a_block(device: str) -> None:
    mesh = mesh_of([ROOM, BLOCK], device)
    rng = np.random.default_rng(3)
    blocked = 0
    for _ in range(12):
        yaw, tilt, roll = rng.uniform(-0.7, 0.7, 3)
        turn = Rotation.from_euler("zyx", [yaw, tilt, roll]).as_matrix() @ LOOKING_ALONG_X
        pose = pose_at(list(rng.uniform([-1.9, -1.5, 0.3], [0.0, 1.7, 2.3])), turn)
        depth = render(mesh, pose)[0].numpy()
        expected = expected_depth(pose, BLOCK)
        larger, smaller = (expected_depth(pose, BLOCK + band) for band in (GROWTH, -GROWTH))
        clear = np.abs(larger - smaller) < 10 * EDGE_BAND
        assert clear.mean() > 0.95
        np.testing.assert_allclose(depth[clear], expected[clear], rtol=0.0, atol=DEPTH_TOLERANCE)
        blocked += np.count_nonzero(expected < expected_depth(pose, BLOCK + 100.0))
    assert blocked > 1000


def test_up_is_up_and_left_is_left(device: str) -> None:
    mesh = mesh_of([ROOM], device)
    corners = mesh.points.numpy()[mesh.indices.numpy().reshape(-1, 3)]
    colors = np.full((len(corners), 3), 90, np.uint8)
    red, green, blue, yellow = (200, 20, 20), (20, 200, 20), (20, 20, 200), (200, 200, 20)
    for axis, side, color in ((2, 0, red), (2, 1, blue), (1, 1, green), (1, 0, yellow)):
        colors[np.all(np.isclose(corners[:, :, axis], ROOM[side, axis]), axis=1)] = color
    _, image = render(mesh, pose_at([-1.9, 0.1, 1.3]), colors)
    pixels = image.numpy().astype(int)
    middle_row, middle_column = CAMERA.height // 2, CAMERA.width // 2

    def hue(row: int, column: int) -> list[bool]:
        return list(pixels[row, column] > 0.5 * pixels[row, column].max())

    assert hue(-1, middle_column) == [True, False, False]  # floor below: red
    assert hue(0, middle_column) == [False, False, True]  # ceiling above: blue
    assert hue(middle_row, 0) == [False, True, False]  # +y is left of +x: green
    assert hue(middle_row, -1) == [True, True, False]  # -y is right: yellow


def test_rays_that_hit_nothing_are_zero_and_black(device: str) -> None:
    mesh = mesh_of([BLOCK], device)
    depth, image = render(mesh, pose_at([2.0, 0.0, 0.5]), np.full((12, 3), 9, np.uint8))
    assert not depth.numpy().any() and not image.numpy().any()


def test_nothing_is_seen_beyond_max_depth(device: str) -> None:
    mesh = mesh_of([ROOM], device)
    pose = pose_at([-1.9, 0.1, 1.3])
    full = render(mesh, pose)[0].numpy()
    cut = render(mesh, pose, max_depth=3.0)[0].numpy()
    assert (full > 3.0).any() and (full < 3.0).any()
    np.testing.assert_array_equal(cut, np.where(full < 3.0, full, 0.0))


def test_given_outputs_are_used_and_inputs_stay_as_they_are(device: str) -> None:
    mesh = mesh_of([ROOM], device)
    points, indices = mesh.points.numpy().copy(), mesh.indices.numpy().copy()
    face_colors = np.arange(36, dtype=np.uint8).reshape(12, 3)
    out_depth = wp.zeros((CAMERA.height, CAMERA.width), dtype=wp.float32, device=device)
    out_colors = wp.zeros((CAMERA.height, CAMERA.width), dtype=wp.vec3ub, device=device)
    depth, colors = render(mesh, pose_at([0.0, 0.1, 1.3]), face_colors, out_depth=out_depth, out_colors=out_colors)
    assert depth is out_depth and colors is out_colors and out_depth.numpy().min() > 0.0
    np.testing.assert_array_equal(mesh.points.numpy(), points)
    np.testing.assert_array_equal(mesh.indices.numpy(), indices)


def test_wrong_arrays_and_numbers_are_named() -> None:
    mesh = mesh_of([ROOM], "cpu")
    pose = pose_at([0.0, 0.1, 1.3])
    with pytest.raises(ValueError, match="face_texture"):
        render(mesh, pose, np.zeros((11, 3), np.uint8))
    with pytest.raises(TypeError, match="out_depth"):
        render(mesh, pose, out_depth=wp.zeros((CAMERA.height, CAMERA.width), dtype=wp.float64, device="cpu"))
    with pytest.raises(ValueError, match="out_depth"):
        render(mesh, pose, out_depth=wp.zeros((CAMERA.width, CAMERA.height), dtype=wp.float32, device="cpu"))
    with pytest.raises(ValueError, match="out_colors"):
        render(mesh, pose, out_colors=wp.zeros((CAMERA.height, CAMERA.width), dtype=wp.vec3ub, device="cpu"))
    with pytest.raises(ValueError, match="max_depth"):
        render(mesh, pose, max_depth=float("inf"))


def six_views(position: list[float]) -> np.ndarray:
    """Poses whose square images of 90 degrees cover the whole sphere."""
    turns = [Rotation.from_euler("z", a * np.pi / 2) for a in range(4)] + [
        Rotation.from_euler("y", a * np.pi / 2) for a in (-1, 1)
    ]
    return np.stack([pose_at(position, turn.as_matrix() @ LOOKING_ALONG_X) for turn in turns])


def test_no_ray_leaves_the_furnished_flat() -> None:
    scene = furnished_flat(1)
    poses = np.concatenate([six_views([(r.x_min + r.x_max) / 2, (r.y_min + r.y_max) / 2, 1.7]) for r in scene.rooms])
    for frame in render_frames(scene.world, Camera.from_fov(48, 48, 90), Trajectory(poses)).read(False):
        assert frame.depth.min() > 0.0, f"a hole in view {frame.index}"
        assert frame.colors is None and frame.stamp_ns is None


def test_a_stream_gives_the_same_bytes_each_time_it_is_read() -> None:
    stamps = np.arange(6, dtype=np.int64) * 100 + 7
    trajectory = Trajectory(six_views([1.0, 1.0, 1.2]), stamps)
    stream = render_frames(furnished_flat(0).world, Camera.from_fov(40, 30, 90), trajectory)
    kept = in_memory(stream)
    for a, b, c, d in zip(stream.read(True), stream.read(True), kept.read(True), kept.read(False), strict=True):
        assert a.stamp_ns == stamps[a.index] == d.stamp_ns and a.colors is not None
        assert a.depth.shape == (30, 40) and a.colors.shape == (30, 40, 3)
        for other in (b, c):
            assert a.depth.tobytes() == other.depth.tobytes() and a.colors.tobytes() == other.colors.tobytes()
        assert a.depth.tobytes() == d.depth.tobytes() and d.colors is None
