"""Writes bags of every kind for the tests, through the writers of rosbags and mcap."""

from __future__ import annotations

import functools
import io
import struct
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from bag_writers import Entry, write_mcap, write_ros1, write_ros2
from scipy.spatial.transform import Rotation

from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame
from maomaps_warp.model.trajectory import Trajectory

BagKind = Literal["ros1", "ros2-sqlite3", "ros2-mcap", "mcap-ros1"]
BAG_KINDS: tuple[BagKind, ...] = get_args(BagKind)

_PATHS = {
    "ros1": "run.bag",
    "ros2-sqlite3": "run_sqlite3",
    "ros2-mcap": "run_mcap",
    "mcap-ros1": "run_ros1.mcap",
}


def bag_path(folder: Path, kind: BagKind) -> Path:
    """A usual path for a bag of this kind: a file, or a folder for ROS 2."""
    return folder / _PATHS[kind]


def storage_file(path: Path) -> Path:
    """The file that holds the messages of a bag: the bag itself, or the one in its folder."""
    return path if path.is_file() else next(x for x in path.iterdir() if x.suffix in (".db3", ".mcap"))


@functools.cache
def typestore(kind: BagKind) -> Any:
    """Standard message types of the ROS version of `kind`."""
    return new_typestore(kind)


def new_typestore(kind: BagKind) -> Any:
    """The same, to register more types in."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if "ros1" in kind else Stores.LATEST)


def write_bag(path: Path, kind: BagKind, entries: Iterable[Entry], *, compression: str = "", store: Any = None) -> Path:
    """Write messages into a new bag.

    Args:
        path: the bag; see `bag_path`.
        kind: what to write.
        entries: (topic, log time in ns, message), the messages made for this kind.
        compression: of chunks: "bz2" or "lz4" for ros1; of messages: "zstd" for ROS 2.
        store: message types, if others than the standard ones are among them.
    """
    writers = {"ros1": write_ros1, "mcap-ros1": write_mcap}
    store = store or typestore(kind)
    if kind in writers:
        writers[kind](path, entries, compression, store)
    else:
        write_ros2(path, kind, entries, compression, store)
    return path


def write_rgbd_bag(
    path: Path,
    kind: BagKind,
    frames: Iterable[Frame],
    trajectory: Trajectory,
    camera: Camera,
    *,
    depth_encoding: str = "32FC1",
    pose_topic: str = "/pose",
) -> Path:
    """Write frames, their camera and poses of the optical frame into a new bag.

    Topics: /camera/depth/image, /camera/rgb/image (rgb8, where a frame has colours),
    /camera/depth/camera_info, and PoseStamped on `pose_topic`. A compressed depth_encoding
    ("16UC1; compressedDepth png") goes to /camera/depth/image/compressedDepth. 16 bits store millimetres.
    """
    depth_topic = "/camera/depth/image" + ("/compressedDepth" if ";" in depth_encoding else "")

    def images() -> Iterator[Entry]:
        for frame in frames:
            assert frame.stamp_ns is not None
            yield "/camera/depth/camera_info", frame.stamp_ns, camera_info(kind, frame.stamp_ns, camera)
            yield (
                depth_topic,
                frame.stamp_ns,
                depth_message(kind, frame.stamp_ns, frame.depth, depth_encoding),
            )
            if frame.colors is not None:
                yield "/camera/rgb/image", frame.stamp_ns, color_message(kind, frame.stamp_ns, frame.colors)

    assert trajectory.stamps_ns is not None
    poses = pose_messages(kind, pose_topic, trajectory.stamps_ns.tolist(), trajectory.T_world_camera)
    return write_bag(path, kind, [*poses, *images()])


def pose_messages(kind: BagKind, topic: str, stamps_ns: Sequence[int], T_world_camera: np.ndarray) -> list[Entry]:
    """PoseStamped entries of (N, 4, 4) poses."""
    quaternions = Rotation.from_matrix(T_world_camera[:, :3, :3]).as_quat()
    return [
        (topic, stamp, pose_stamped(kind, stamp, T[:3, 3], q))
        for stamp, T, q in zip(stamps_ns, T_world_camera, quaternions, strict=True)
    ]


def message(kind: BagKind, name: str, *values: Any) -> Any:
    """A message by its ROS name ("geometry_msgs/Pose") with its fields in order."""
    return typestore(kind).types[name.replace("/", "/msg/")](*values)


def header(kind: BagKind, stamp_ns: int, frame_id: str = "map") -> Any:
    stamp = message(kind, "builtin_interfaces/Time", stamp_ns // 10**9, stamp_ns % 10**9)
    return message(kind, "std_msgs/Header", *([0] if "ros1" in kind else []), stamp, frame_id)


def pose(kind: BagKind, position: Sequence[float], xyzw: Sequence[float]) -> Any:
    return message(
        kind,
        "geometry_msgs/Pose",
        message(kind, "geometry_msgs/Point", *map(float, position)),
        message(kind, "geometry_msgs/Quaternion", *map(float, xyzw)),
    )


def pose_stamped(
    kind: BagKind,
    stamp_ns: int,
    position: Sequence[float],
    xyzw: Sequence[float] = (0, 0, 0, 1),
    frame_id: str = "map",
) -> Any:
    return message(kind, "geometry_msgs/PoseStamped", header(kind, stamp_ns, frame_id), pose(kind, position, xyzw))


def pose_with_covariance_stamped(
    kind: BagKind, stamp_ns: int, position: Sequence[float], xyzw: Sequence[float] = (0, 0, 0, 1)
) -> Any:
    covered = message(kind, "geometry_msgs/PoseWithCovariance", pose(kind, position, xyzw), np.zeros(36))
    return message(kind, "geometry_msgs/PoseWithCovarianceStamped", header(kind, stamp_ns), covered)


def transform_stamped(
    kind: BagKind, stamp_ns: int, position: Sequence[float], xyzw: Sequence[float] = (0, 0, 0, 1)
) -> Any:
    transform = message(
        kind,
        "geometry_msgs/Transform",
        message(kind, "geometry_msgs/Vector3", *map(float, position)),
        message(kind, "geometry_msgs/Quaternion", *map(float, xyzw)),
    )
    return message(kind, "geometry_msgs/TransformStamped", header(kind, stamp_ns), "camera", transform)


def odometry(
    kind: BagKind,
    stamp_ns: int,
    position: Sequence[float],
    xyzw: Sequence[float] = (0, 0, 0, 1),
    child_frame_id: str = "base_link",
) -> Any:
    zero = message(kind, "geometry_msgs/Vector3", 0.0, 0.0, 0.0)
    twist = message(
        kind,
        "geometry_msgs/TwistWithCovariance",
        message(kind, "geometry_msgs/Twist", zero, zero),
        np.zeros(36),
    )
    covered = message(kind, "geometry_msgs/PoseWithCovariance", pose(kind, position, xyzw), np.zeros(36))
    return message(kind, "nav_msgs/Odometry", header(kind, stamp_ns, "odom"), child_frame_id, covered, twist)


def path_message(kind: BagKind, stamp_ns: int, poses: list[Any], frame_id: str = "map") -> Any:
    return message(kind, "nav_msgs/Path", header(kind, stamp_ns, frame_id), poses)


def camera_info(kind: BagKind, stamp_ns: int, camera: Camera, distortion: Sequence[float] = (0,) * 5) -> Any:
    K = np.array([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1], dtype=np.float64)
    P = np.insert(K.reshape(3, 3), 3, 0, axis=1).ravel()
    region = message(kind, "sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False)
    return message(
        kind,
        "sensor_msgs/CameraInfo",
        header(kind, stamp_ns, "camera_optical"),
        camera.height,
        camera.width,
        "plumb_bob",
        np.array(distortion, dtype=np.float64),
        K,
        np.eye(3).ravel(),
        P,
        0,
        0,
        region,
    )


def depth_message(kind: BagKind, stamp_ns: int, depth: np.ndarray, encoding: str = "32FC1") -> Any:
    """(H, W) float32 metres as an Image, or as a CompressedImage if the encoding has a ";"."""
    if encoding.startswith("32FC1;"):
        blob = _compressed_depth(*_inverse_depth(depth))
    elif ";" in encoding:
        blob = _compressed_depth(np.rint(depth * 1000).astype(np.uint16), 0.0, 0.0)
    elif encoding == "32FC1":
        return image(kind, stamp_ns, depth.astype("<f4"), encoding)
    else:
        return image(kind, stamp_ns, np.rint(depth * 1000).astype("<u2"), encoding)
    return compressed_image(kind, stamp_ns, blob, encoding)


def color_message(kind: BagKind, stamp_ns: int, colors: np.ndarray, encoding: str = "rgb8") -> Any:
    return image(kind, stamp_ns, np.ascontiguousarray(colors), encoding)


def image(kind: BagKind, stamp_ns: int, pixels: np.ndarray, encoding: str) -> Any:
    """An Image of these pixels as they lie in memory."""
    data = np.frombuffer(pixels.tobytes(), np.uint8)
    height, width = pixels.shape[:2]
    big = int(pixels.dtype.byteorder == ">")
    head = header(kind, stamp_ns, "camera_optical")
    return message(kind, "sensor_msgs/Image", head, height, width, encoding, big, len(data) // height, data)


def compressed_image(kind: BagKind, stamp_ns: int, blob: bytes, image_format: str) -> Any:
    data = np.frombuffer(blob, np.uint8)
    return message(kind, "sensor_msgs/CompressedImage", header(kind, stamp_ns, "camera_optical"), image_format, data)


def cloud_message(
    kind: BagKind, stamp_ns: int, fields: Sequence[tuple[str, int, int]], data: bytes, **layout: int
) -> Any:
    """A PointCloud2 of `fields` (name, offset, datatype).

    The layout names height, width, point_step, row_step and is_bigendian, as the message does.
    """
    described = [message(kind, "sensor_msgs/PointField", name, offset, kind_, 1) for name, offset, kind_ in fields]
    return message(
        kind,
        "sensor_msgs/PointCloud2",
        header(kind, stamp_ns),
        layout.get("height", 1),
        layout["width"],
        described,
        bool(layout.get("is_bigendian", 0)),
        layout["point_step"],
        layout.get("row_step", layout["width"] * layout["point_step"]),
        np.frombuffer(data, np.uint8),
        False,
    )


def png(pixels: np.ndarray) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def _compressed_depth(pixels: np.ndarray, quant_a: float, quant_b: float) -> bytes:
    return struct.pack("<iff", 0, quant_a, quant_b) + png(pixels)


def _inverse_depth(depth: np.ndarray, depth_max: float = 10.0) -> tuple[np.ndarray, float, float]:
    """Quantised inverse depth, as compressed_depth_image_transport writes it: value = A / depth + B."""
    quant_a = 100.0 * 101.0
    quant_b = 1.0 - quant_a / depth_max
    with np.errstate(divide="ignore"):
        values = np.where(depth > 0, quant_a / depth + quant_b, 0.0)
    return np.rint(values).astype(np.uint16), quant_a, quant_b


def write_mcap_ros1(path: Path, entries: Iterable[Entry], **options: Any) -> Path:
    """An MCAP with ROS 1 messages; options are those of mcap's writer (use_chunking, ...)."""
    write_mcap(path, entries, "", typestore("mcap-ros1"), **options)
    return path
