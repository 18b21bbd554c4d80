"""Writes RGB-D recordings as bags."""

from __future__ import annotations

import heapq
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.rotations import quaternions_from_matrices
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import FrameStream
from maomaps_warp.model.trajectory import Trajectory

#: Topics of a recording; depth is registered to the colour image, so both have the same camera.
RGB_TOPIC = "/camera/rgb/image_raw"
RGB_INFO_TOPIC = "/camera/rgb/camera_info"
DEPTH_TOPIC = "/camera/depth/image_raw"
DEPTH_INFO_TOPIC = "/camera/depth/camera_info"
POSE_TOPIC = "/gt/pose"
CAMERA_FRAME = "camera_optical_frame"
WORLD_FRAME = "world"

_IMAGE, _INFO, _POSE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "geometry_msgs/msg/PoseStamped"
_TYPES = {
    RGB_TOPIC: _IMAGE,
    RGB_INFO_TOPIC: _INFO,
    DEPTH_TOPIC: _IMAGE,
    DEPTH_INFO_TOPIC: _INFO,
    POSE_TOPIC: _POSE,
}

_Kind = Literal["ros1", "mcap"]
_Message = tuple[int, str, Any]


def write_rgbd_bag(path: Path, stream: FrameStream, trajectory: Trajectory, *, kind: _Kind) -> None:
    """Writes frames and their ground truth as a bag, uncompressed, in the order of the stamps.

    Topics: `/camera/rgb/image_raw` (rgb8), `/camera/depth/image_raw` (32FC1, metres, 0 = missing),
    `/camera/rgb/camera_info`, `/camera/depth/camera_info`, `/gt/pose` (PoseStamped of the optical frame in
    "world"). Every message's time is the stamp of its header.

    Args:
        path: what to make: a ".bag" file for "ros1", a folder (metadata.yaml and one .mcap file) for "mcap".
            It appears when it is complete, never before.
        stream: frames with stamps and colours.
        trajectory: poses with stamps, their own or the frames'.
        kind: "ros1" (bag format 2.0) or "mcap" (ROS 2 bag with MCAP storage).

    Raises:
        InputError: something is at `path` already, or it cannot be written.
        ValueError: frames or poses lack stamps, or frames lack colours.
    """
    if trajectory.stamps_ns is None:
        raise ValueError("a bag needs poses with stamps")
    if path.exists():
        raise InputError(path, "exists already", "delete it or choose another path")
    try:
        # Inside the target folder, so that the last step is a rename on one file system.
        work = Path(tempfile.mkdtemp(prefix=".unfinished-", dir=path.parent))
    except OSError as error:
        raise InputError(
            path, f"cannot be written: {error.strerror}", "choose a writable folder that exists"
        ) from error
    try:
        _write(work / path.name, stream, trajectory, kind)
        (work / path.name).rename(path)
    except OSError as error:
        raise InputError(path, f"cannot be written: {error.strerror}", "is the disk full?") from error
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _write(path: Path, stream: FrameStream, trajectory: Trajectory, kind: _Kind) -> None:
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    # Humble: the oldest ROS 2 release in use; these messages are the same in all later ones.
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    serialize = store.serialize_ros1 if kind == "ros1" else store.serialize_cdr
    make = _MessageMaker(store.types, kind)
    messages = heapq.merge(
        _frame_messages(stream, make), _pose_messages(trajectory, make), key=lambda message: message[0]
    )
    writer: Any
    if kind == "ros1":
        writer = rosbag1.Writer(path)
    else:
        writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
    with writer:
        connections = {topic: writer.add_connection(topic, name, typestore=store) for topic, name in _TYPES.items()}
        for stamp_ns, topic, message in messages:
            writer.write(connections[topic], stamp_ns, serialize(message, _TYPES[topic]))


def _frame_messages(stream: FrameStream, make: _MessageMaker) -> Iterator[_Message]:
    for frame in stream.read(True):
        if frame.stamp_ns is None or frame.colors is None:
            raise ValueError(f"a bag needs frames with stamps and colours; frame {frame.index} lacks them")
        header = make.header(frame.index, frame.stamp_ns, CAMERA_FRAME)
        info = make.camera_info(header, stream.camera)
        yield frame.stamp_ns, RGB_INFO_TOPIC, info
        yield frame.stamp_ns, RGB_TOPIC, make.image(header, "rgb8", frame.colors)
        yield frame.stamp_ns, DEPTH_INFO_TOPIC, info
        yield frame.stamp_ns, DEPTH_TOPIC, make.image(header, "32FC1", frame.depth)


def _pose_messages(trajectory: Trajectory, make: _MessageMaker) -> Iterator[_Message]:
    assert trajectory.stamps_ns is not None
    quaternions = quaternions_from_matrices(trajectory.T_world_camera[:, :3, :3]).tolist()
    poses = zip(trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), quaternions, strict=True)
    for index, (stamp, position, xyzw) in enumerate(poses):
        yield stamp, POSE_TOPIC, make.pose(make.header(index, stamp, WORLD_FRAME), position, xyzw)


@dataclass(frozen=True)
class _MessageMaker:
    """Makes messages of one ROS version; `types` are its message classes by name."""

    types: dict[str, Any]
    kind: _Kind

    def header(self, index: int, stamp_ns: int, frame_id: str) -> Any:
        stamp = self.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        number = {"seq": index} if self.kind == "ros1" else {}
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id, **number)

    def image(self, header: Any, encoding: str, pixels: NDArray[Any]) -> Any:
        data = np.ascontiguousarray(pixels)
        return self.types[_IMAGE](
            header=header,
            height=data.shape[0],
            width=data.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=data.strides[0],
            data=data.reshape(-1).view(np.uint8),
        )

    def camera_info(self, header: Any, camera: Camera) -> Any:
        row_x, row_y = [camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy]
        matrices = {
            "D": np.zeros(5),
            "K": np.array([*row_x, *row_y, 0.0, 0.0, 1.0]),
            "R": np.eye(3).reshape(-1),
            "P": np.array([*row_x, 0.0, *row_y, 0.0, 0.0, 0.0, 1.0, 0.0]),
        }
        # ROS 2 names these fields in small letters.
        named = matrices if self.kind == "ros1" else {name.lower(): value for name, value in matrices.items()}
        return self.types[_INFO](
            header=header,
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=self.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
            **named,
        )

    def pose(self, header: Any, position: list[float], xyzw: list[float]) -> Any:
        pose = self.types["geometry_msgs/msg/Pose"](
            position=self.types["geometry_msgs/msg/Point"](*position),
            orientation=self.types["geometry_msgs/msg/Quaternion"](*xyzw),
        )
        return self.types[_POSE](header=header, pose=pose)
