"""A furnished room seen by an exact camera, and poses written under any convention without our own code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scenes import camera_pose
from scipy.spatial.transform import Rotation

from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory

F64 = NDArray[np.float64]
CAMERA = Camera.from_fov(48, 36, 80.0)
FRAME_NS = 100_000_000
START_NS = 1_000_000_000_000

_ROOM = np.array([[0.0, 0.0, 0.0], [6.0, 5.0, 2.6]])
_FURNITURE = np.array(
    [
        [[0.0, 0.0, 0.0], [0.6, 2.0, 2.0]],
        [[2.6, 2.2, 0.0], [3.4, 2.9, 0.8]],
        [[5.2, 3.5, 0.0], [6.0, 5.0, 1.2]],
        [[1.5, 4.4, 0.0], [3.0, 5.0, 1.8]],
        [[4.6, 0.0, 0.0], [5.3, 0.7, 2.3]],
    ]
)
_R_BODY_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def room_depth(T_world_camera: F64, camera: Camera = CAMERA) -> NDArray[np.float32]:
    """Exact depth image of the room."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    directions = rays @ T_world_camera[:3, :3].T
    directions = np.where(np.abs(directions) < 1e-9, 1e-9, directions)
    origin = T_world_camera[:3, 3]
    depth = np.max((_ROOM - origin) / directions[..., None, :], axis=-2).min(axis=-1)
    for box in _FURNITURE:
        faces = (box - origin) / directions[..., None, :]
        enters, leaves = faces.min(axis=-2).max(axis=-1), faces.max(axis=-2).min(axis=-1)
        depth = np.where((enters < leaves) & (enters > 0), np.minimum(depth, enters), depth)
    return depth.astype(np.float32)


def drive(count: int = 40) -> F64:
    """(N, 4, 4): a robot's camera, level, on a loop around the table, now and then turning on the way."""
    angle = np.linspace(0.0, 1.5 * np.pi, count)
    yaw = angle + 0.5 * np.pi + 0.5 * np.sin(3.0 * angle)
    x, y = 3.0 + 1.4 * np.cos(angle), 2.5 + 1.3 * np.sin(angle)
    return np.stack([camera_pose((a, b, 1.1), c) for a, b, c in zip(x, y, yaw, strict=True)])


def handheld(count: int = 40) -> F64:
    """(N, 4, 4): the same loop with a hand that pitches, rolls and bobs."""
    T = drive(count)
    phase = np.linspace(0.0, 9.0, count)
    shake = Rotation.from_euler("xz", np.stack([0.35 * np.sin(phase), 0.3 * np.cos(1.3 * phase)], axis=1))
    T[:, :3, :3] = T[:, :3, :3] @ shake.as_matrix()
    T[:, 2, 3] += 0.25 * np.sin(1.7 * phase)
    return T


def on_the_spot(count: int = 40) -> F64:
    """(N, 4, 4): the drive's turns without its way."""
    T = drive(count)
    T[:, :3, 3] = T[0, :3, 3]
    return T


def stream_of(
    T_world_camera: F64, camera: Camera = CAMERA, factor: float = 1.0, with_stamps: bool = True
) -> FrameStream:
    """Depth frames at 10 Hz, depth times `factor`."""
    depth = [np.float32(factor) * room_depth(T, camera) for T in T_world_camera]

    def read(with_colors: bool):
        for i, image in enumerate(depth):
            yield Frame(i, START_NS + i * FRAME_NS if with_stamps else None, image)

    return FrameStream(camera, len(depth), read)


def trajectory_of(T: F64) -> Trajectory:
    """Poses at the frames' stamps."""
    return Trajectory(T, START_NS + FRAME_NS * np.arange(len(T), dtype=np.int64))


def written(T_world_camera: F64, axes: str = "optical", *, inverse: bool = False, wxyz: bool = False) -> F64:
    """Poses as a recorder of this convention would write them, read naively as camera-to-world with x y z w."""
    R_axes = {"optical": np.eye(3), "body": _R_BODY_CAMERA, "opengl": np.diag([1.0, -1.0, -1.0])}[axes]
    T = T_world_camera.copy()
    T[:, :3, :3] = T[:, :3, :3] @ R_axes.T
    if inverse:
        T = np.linalg.inv(T)
    return _refielded(T, [3, 0, 1, 2]) if wxyz else T


def written_by_maomaps(T_world_camera: F64, orientation: str, correction: float) -> F64:
    """The three orientations of MAOMaps bags: their readers add half a turn (a, b) and the correction to the yaw."""
    T = written(T_world_camera, "body")
    added = correction + (0.0 if orientation == "c" else np.pi)
    T[:, :3, :3] = Rotation.from_euler("z", -added).as_matrix() @ T[:, :3, :3]
    # Habitat turns about y; the readers exchange y and z.
    return _refielded(T, [0, 2, 1, 3]) if orientation == "a" else T


def _refielded(T: F64, places: list[int]) -> F64:
    """Quaternions whose fields x y z w hold the components at `places` of the real one."""
    T = T.copy()
    T[:, :3, :3] = Rotation.from_quat(Rotation.from_matrix(T[:, :3, :3]).as_quat()[:, places]).as_matrix()
    return T
