"""Small bags, frames and poses that the tests of bags share."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bags
import numpy as np
import pytest
from bags import BAG_KINDS, BagKind, bag_path, write_bag
from scipy.spatial.transform import Rotation

from maomaps_warp.io.bags import (
    BagContents,
    open_contents,
    read_bag_camera,
    read_bag_cloud,
    read_bag_frames,
    read_bag_trajectory,
)
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory

CAMERA = Camera(8, 6, 5.0, 5.5, 3.4, 2.6)
T0_NS = 1_305_031_229_000_000_123
STEP_NS = 33_333_333
#: Rotations pass through a quaternion of float64, dimensionless: a few rounding errors of 2e-16.
ROTATION_TOLERANCE = 1e-14


#: sensor_msgs/PointField datatypes.
FLOAT32, FLOAT64, UINT32, UINT8 = 7, 8, 6, 2

every_kind = pytest.mark.parametrize("kind", BAG_KINDS)


def some_frames(count: int, with_colors: bool = True) -> list[Frame]:
    rng = np.random.default_rng(1)
    frames = []
    for i in range(count):
        depth = (rng.integers(300, 9000, (CAMERA.height, CAMERA.width)) / 1000).astype(np.float32)
        depth[0, :2] = 0
        colors = rng.integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8) if with_colors else None
        frames.append(Frame(i, T0_NS + i * STEP_NS, depth, colors))
    return frames


def some_poses(count: int) -> Trajectory:
    rng = np.random.default_rng(2)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=3).as_matrix()
    T[:, :3, 3] = rng.normal(size=(count, 3))
    return Trajectory(T, T0_NS + STEP_NS * np.arange(count, dtype=np.int64))


def assert_same_poses(found: Trajectory, expected: Trajectory) -> None:
    np.testing.assert_array_equal(found.stamps_ns, expected.stamps_ns)
    np.testing.assert_array_equal(found.positions, expected.positions)
    np.testing.assert_allclose(found.T_world_camera, expected.T_world_camera, rtol=0, atol=ROTATION_TOLERANCE)


def assert_same_frames(found: list[Frame], expected: list[Frame]) -> None:
    assert [x.stamp_ns for x in found] == [x.stamp_ns for x in expected]
    assert [x.index for x in found] == list(range(len(expected)))
    for a, b in zip(found, expected, strict=True):
        assert a.depth.dtype == np.float32
        np.testing.assert_array_equal(a.depth, b.depth)
        assert (a.colors is None) == (b.colors is None)
        if a.colors is not None:
            np.testing.assert_array_equal(a.colors, b.colors)


def bag_contents(path: Path) -> BagContents:
    with open_contents(path) as contents:
        return contents


def bag_trajectory(path: Path, topics: Sequence[str] = (), **options: Any) -> Trajectory:
    with open_contents(path, topics) as contents:
        return read_bag_trajectory(contents, **options)


def bag_cloud(path: Path) -> PointCloud:
    with open_contents(path) as contents:
        return read_bag_cloud(contents)


def bag_camera(path: Path, topics: Sequence[str] = ()) -> Camera | None:
    with open_contents(path, topics) as contents:
        return read_bag_camera(contents)


def bag_frames(path: Path, camera: Camera | None) -> FrameStream:
    with open_contents(path) as contents:
        return read_bag_frames(contents, camera=camera)


def read_everything(path: Path) -> None:
    bag_trajectory(path)
    bag_cloud(path)
    stream = bag_frames(path, camera=None)
    assert all(x.depth.shape == (CAMERA.height, CAMERA.width) for x in stream.read(True))


def whole_bag(folder: Path, kind: BagKind) -> Path:
    poses = some_poses(6)
    entries = bags.pose_messages(kind, "/pose", poses.stamps_ns.tolist(), poses.T_world_camera)
    for i, frame in enumerate(some_frames(6)):
        stamp = frame.stamp_ns
        entries += [
            ("/camera/depth/camera_info", stamp, bags.camera_info(kind, stamp, CAMERA)),
            ("/camera/depth/image", stamp, bags.depth_message(kind, stamp, frame.depth)),
            ("/camera/rgb/image", stamp, bags.color_message(kind, stamp, frame.colors)),
            ("/map", stamp, xyz_cloud(kind, stamp, [[i, 2.0, 3.0]])),
        ]
    path = write_bag(bag_path(folder, kind), kind, entries)
    read_everything(path)
    return path


def xyz_cloud(kind: BagKind, stamp_ns: int, points: list[list[float]]) -> object:
    data = b"".join(struct.pack("<fff", *p) for p in points)
    fields = [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32)]
    return bags.cloud_message(kind, stamp_ns, fields, data, width=len(points), point_step=12)
