"""Bags that the recorder writes, read back with other programs' readers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from maomaps_warp.errors import InputError
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.recorder import MAOMAPS_TOPICS, write_rgbd_bag

CAMERA = Camera(7, 5, 4.25, 4.5, 3.125, 1.875)
COUNT = 6
STAMPS = 1_700_000_000_900_000_001 + np.arange(COUNT, dtype=np.int64) * 100_000_000
# What `rosmsg md5` of ROS Noetic prints.
MD5 = {
    "sensor_msgs/msg/Image": "060021388200f6f0f447d0fcd9c64743",
    "sensor_msgs/msg/CameraInfo": "c9a58c1b0b154e0e6da7578cb991d214",
    "geometry_msgs/msg/PoseStamped": "d3812c3cbc69362b77dc0b19b345f8f5",
}
TOPICS = {
    "/camera/rgb/image_raw": "sensor_msgs/msg/Image",
    "/camera/rgb/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/depth/image_raw": "sensor_msgs/msg/Image",
    "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "/gt/pose": "geometry_msgs/msg/PoseStamped",
}
NAMES = {"ros1": "drive.bag", "ros2": "drive"}


def trajectory() -> Trajectory:
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, :3, :3] = Rotation.random(COUNT, rng=np.random.default_rng(2)).as_matrix()
    poses[:, :3, 3] = np.random.default_rng(3).normal(size=(COUNT, 3))
    return Trajectory(poses, STAMPS)


def frames() -> list[Frame]:
    rng = np.random.default_rng(1)
    shape = (CAMERA.height, CAMERA.width)
    return [
        Frame(
            i,
            int(STAMPS[i]),
            rng.uniform(0, 9, shape).astype(np.float32),
            rng.integers(0, 256, (*shape, 3), np.uint8),
        )
        for i in range(COUNT)
    ]


def stream_of(content: list[Frame]) -> FrameStream:
    return FrameStream(CAMERA, len(content), lambda with_colors: iter(content))


def read_back(path: Path, kind: str, topics: dict[str, str] = TOPICS) -> dict[str, list[tuple[int, Any]]]:
    """Messages by topic, each with the time the bag gives it."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_JAZZY)
    deserialize = store.deserialize_ros1 if kind == "ros1" else store.deserialize_cdr
    reader = rosbag1.Reader(path) if kind == "ros1" else rosbag2.Reader(path)
    found: dict[str, list[tuple[int, Any]]] = {}
    with reader:
        assert {c.topic: c.msgtype for c in reader.connections} == topics
        times = []
        for connection, time, data in reader.messages():
            times.append(time)
            found.setdefault(connection.topic, []).append((time, deserialize(data, connection.msgtype)))
        assert times == sorted(times) and len(times) == reader.message_count
    return found


@pytest.fixture(params=["ros1", "ros2"])
def kind(request: pytest.FixtureRequest) -> Any:
    return request.param


def test_bags_hold_every_byte_of_images_and_every_digit_of_poses(tmp_path: Path, kind: Any) -> None:
    path = tmp_path / NAMES[kind]
    write_rgbd_bag(path, stream_of(frames()), trajectory(), kind=kind)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    found = read_back(path, kind)
    assert {topic: len(messages) for topic, messages in found.items()} == dict.fromkeys(TOPICS, COUNT)
    for topic, messages in found.items():
        assert [time for time, _ in messages] == list(STAMPS)
        for time, message in messages:
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
            assert message.header.frame_id == ("world" if topic == "/gt/pose" else "camera_optical_frame")
    for frame, (_, depth), (_, rgb) in zip(
        frames(), found["/camera/depth/image_raw"], found["/camera/rgb/image_raw"], strict=True
    ):
        assert (depth.encoding, depth.height, depth.width, depth.step) == ("32FC1", 5, 7, 28)
        assert depth.data.tobytes() == frame.depth.tobytes() and not depth.is_bigendian
        assert frame.colors is not None
        assert (rgb.encoding, rgb.height, rgb.width, rgb.step) == ("rgb8", 5, 7, 21)
        assert rgb.data.tobytes() == frame.colors.tobytes()
    for pose, (_, message) in zip(trajectory().T_world_camera, found["/gt/pose"], strict=True):
        p, q = message.pose.position, message.pose.orientation
        assert [p.x, p.y, p.z] == list(pose[:3, 3])
        rotation = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        np.testing.assert_allclose(rotation, pose[:3, :3], rtol=0, atol=1e-14)


def test_both_cameras_have_the_streams_intrinsics(tmp_path: Path, kind: Any) -> None:
    path = tmp_path / NAMES[kind]
    write_rgbd_bag(path, stream_of(frames()), trajectory(), kind=kind)
    found = read_back(path, kind)
    for topic in ("/camera/rgb/camera_info", "/camera/depth/camera_info"):
        for _, info in found[topic]:
            K, P, D = (getattr(info, name if kind == "ros1" else name.lower()) for name in "KPD")
            assert list(K) == [4.25, 0, 3.125, 0, 4.5, 1.875, 0, 0, 1]
            assert list(P) == [4.25, 0, 3.125, 0, 0, 4.5, 1.875, 0, 0, 0, 1, 0]
            assert list(D) == [0.0] * 5 and info.distortion_model == "plumb_bob"
            assert (info.width, info.height) == (7, 5)


def test_a_ros_1_bag_states_the_checksums_and_definitions_of_noetic(tmp_path: Path) -> None:
    write_rgbd_bag(tmp_path / "drive.bag", stream_of(frames()), trajectory(), kind="ros1")
    assert (tmp_path / "drive.bag").read_bytes().startswith(b"#ROSBAG V2.0\n")
    with rosbag1.Reader(tmp_path / "drive.bag") as reader:
        for connection in reader.connections:
            assert connection.digest == MD5[connection.msgtype]
            assert "std_msgs/Header" in connection.msgdef.data


def test_an_mcap_bag_is_read_by_the_mcap_reader(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    write_rgbd_bag(tmp_path / "drive", stream_of(frames()), trajectory(), kind="ros2")
    assert sorted(p.name for p in (tmp_path / "drive").iterdir()) == ["drive.mcap", "metadata.yaml"]
    with (tmp_path / "drive" / "drive.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == 5 * COUNT
        schemas = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
        assert {topic: schema.name for topic, schema in schemas.items()} == TOPICS
        assert all(schema.encoding == "ros2msg" and schema.data for schema in schemas.values())
        depths = [m.data for _, _, m in reader.iter_messages(topics=["/camera/depth/image_raw"])]
    for data, frame in zip(depths, frames(), strict=True):
        assert data.endswith(frame.depth.tobytes())


def test_poses_with_stamps_of_their_own_are_written_in_between(tmp_path: Path, kind: Any) -> None:
    path = tmp_path / NAMES[kind]
    between = replace(trajectory(), stamps_ns=STAMPS + 50_000_000)
    write_rgbd_bag(path, stream_of(frames()), between, kind=kind)
    assert [time for time, _ in read_back(path, kind)["/gt/pose"]] == list(STAMPS + 50_000_000)


def test_something_that_exists_is_refused_and_left_alone(tmp_path: Path, kind: Any) -> None:
    path = tmp_path / NAMES[kind]
    path.write_text("precious")
    with pytest.raises(InputError, match=re.escape(f"{path}: exists already")):
        write_rgbd_bag(path, stream_of(frames()), trajectory(), kind=kind)
    assert path.read_text() == "precious"


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path, kind: Any) -> None:
    path = tmp_path / "nowhere" / NAMES[kind]
    with pytest.raises(InputError, match=re.escape(f"{path}: cannot be written")):
        write_rgbd_bag(path, stream_of(frames()), trajectory(), kind=kind)


def test_nothing_is_left_when_the_frames_break_off(tmp_path: Path, kind: Any) -> None:
    def read(with_colors: bool) -> Iterator[Frame]:
        yield from frames()[:2]
        raise RuntimeError("the camera fell off")

    with pytest.raises(RuntimeError, match="fell off"):
        write_rgbd_bag(tmp_path / NAMES[kind], FrameStream(CAMERA, None, read), trajectory(), kind=kind)
    assert not list(tmp_path.iterdir())


def test_frames_without_stamps_or_colours_and_poses_without_stamps_are_refused(tmp_path: Path, kind: Any) -> None:
    path = tmp_path / NAMES[kind]
    for lacking in ({"stamp_ns": None}, {"colors": None}):
        content = [*frames()[:3], replace(frames()[3], **lacking)]
        with pytest.raises(ValueError, match="frame 3"):
            write_rgbd_bag(path, stream_of(content), trajectory(), kind=kind)
    with pytest.raises(ValueError, match="poses with stamps"):
        write_rgbd_bag(path, stream_of(frames()), replace(trajectory(), stamps_ns=None), kind=kind)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("kind", "name"), [("ros1", "run.bag"), ("mcap", "run.mcap"), ("ros2", "run")])
def test_a_recording_in_the_form_of_maomaps_has_its_topics_and_body_poses(tmp_path: Path, kind: Any, name: str) -> None:
    from maomaps_warp.io.sources import SourceOptions, open_source

    write_rgbd_bag(tmp_path / name, stream_of(frames()), trajectory(), kind=kind, topics=MAOMAPS_TOPICS)
    source = open_source(tmp_path / name, SourceOptions(pose_frame="maomaps-c"), "gt")
    assert source.trajectory is not None and source.frames is not None and source.camera == CAMERA
    np.testing.assert_allclose(source.trajectory.T_world_camera, trajectory().T_world_camera, rtol=0, atol=1e-14)
    for frame, read in zip(frames(), source.frames.read(True), strict=True):
        np.testing.assert_array_equal(read.depth, frame.depth)
        np.testing.assert_array_equal(read.colors, frame.colors)
    if kind == "ros1":
        with rosbag1.Reader(tmp_path / name) as reader:
            assert {c.topic for c in reader.connections} == {
                "/habitat/rgb/image",
                "/habitat/depth/image",
                "/habitat/rgb/camera_info",
                "/true_pose",
            }


MAOMAPS_WITH_EXTRAS = {
    "/habitat/rgb/image": "sensor_msgs/msg/Image",
    "/habitat/rgb/camera_info": "sensor_msgs/msg/CameraInfo",
    "/habitat/depth/image": "sensor_msgs/msg/Image",
    "/habitat/normals/image": "sensor_msgs/msg/Image",
    "/habitat/semantic/image": "sensor_msgs/msg/Image",
    "/habitat/semantic/parts": "std_msgs/msg/String",
    "/true_depth/image": "sensor_msgs/msg/Image",
    "/true_pose": "geometry_msgs/msg/PoseStamped",
}


def with_extras() -> list[Frame]:
    rng = np.random.default_rng(4)
    shape = (CAMERA.height, CAMERA.width)
    extras = {
        "normals": rng.normal(size=(*shape, 3)).astype(np.float32),
        "parts": rng.integers(-1, 3, shape).astype(np.int32),
        "exact_depth": rng.uniform(0, 9, shape).astype(np.float32),
    }
    return [replace(frame, extras=extras) for frame in frames()]


def test_further_images_have_topics_of_their_own(tmp_path: Path, kind: Any) -> None:
    path, names = tmp_path / NAMES[kind], ("floor", "wall", "chair")
    write_rgbd_bag(path, stream_of(with_extras()), trajectory(), kind=kind, topics=MAOMAPS_TOPICS, part_names=names)
    read = read_back(path, kind, MAOMAPS_WITH_EXTRAS)
    assert [message.data for _, message in read["/habitat/semantic/parts"]] == ['["floor", "wall", "chair"]']
    expected = with_extras()[0].extras
    for topic, encoding, name in (
        ("/habitat/normals/image", "32FC3", "normals"),
        ("/habitat/semantic/image", "32SC1", "parts"),
        ("/true_depth/image", "32FC1", "exact_depth"),
    ):
        messages = read[topic]
        assert [stamp for stamp, _ in messages] == list(STAMPS)
        _, image = messages[2]
        assert image.encoding == encoding and image.step == expected[name][0].nbytes
        np.testing.assert_array_equal(
            image.data.view(expected[name].dtype).reshape(expected[name].shape), expected[name]
        )


def test_further_images_without_a_topic_or_of_another_type_are_refused(tmp_path: Path) -> None:
    shape = (CAMERA.height, CAMERA.width)
    for extras, words in (
        ({"heat": np.zeros(shape, np.float32)}, "no topic for images named 'heat'"),
        ({"parts": np.zeros(shape, np.int64)}, "float32 or int32"),
        ({"parts": np.zeros((*shape, 2), np.int32)}, "float32 or int32"),
    ):
        spoilt = [replace(frame, extras=extras) for frame in frames()]
        with pytest.raises(ValueError, match=words):
            write_rgbd_bag(tmp_path / "run.bag", stream_of(spoilt), trajectory(), kind="ros1", topics=MAOMAPS_TOPICS)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("after", [1, 3])
def test_a_bag_that_is_stopped_ends_with_the_pose_of_its_last_frame(tmp_path: Path, kind: Any, after: int) -> None:
    from threading import Event

    stop = Event()

    def read(with_colors: bool) -> Iterator[Frame]:
        for frame in frames():
            if frame.index == after - 1:
                stop.set()
            yield frame

    path = tmp_path / NAMES[kind]
    write_rgbd_bag(path, FrameStream(CAMERA, None, read), trajectory(), kind=kind, stop=stop)
    times = {topic: [stamp for stamp, _ in messages] for topic, messages in read_back(path, kind).items()}
    assert times == {topic: list(STAMPS[:after]) for topic in TOPICS}


#: Debian's package python3-rosbag is for the system's Python.
SYSTEM_PYTHON = "/usr/bin/python3"
READ_BY_ROS = """
import sys, rosbag
for topic, message, stamp in rosbag.Bag(sys.argv[1]).read_messages():
    extra = (message.encoding, message.step, len(message.data)) if message._type == "sensor_msgs/Image" else ()
    print(topic, message._type, message._md5sum, stamp.to_nsec(), *extra)
"""


def test_ros_1_itself_reads_a_bag(tmp_path: Path) -> None:
    import subprocess

    if not Path(SYSTEM_PYTHON).exists() or subprocess.run([SYSTEM_PYTHON, "-c", "import rosbag"]).returncode:
        pytest.skip("python3-rosbag is not installed")
    write_rgbd_bag(tmp_path / "run.bag", stream_of(with_extras()), trajectory(), kind="ros1", topics=MAOMAPS_TOPICS)
    command = [SYSTEM_PYTHON, "-c", READ_BY_ROS, str(tmp_path / "run.bag")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    assert len(lines) == 7 * COUNT
    for topic, kind, md5, stamp, *image in lines:
        assert md5 == MD5[kind.replace("/", "/msg/")] and int(stamp) in STAMPS
        if topic == "/habitat/depth/image":
            assert image == ["32FC1", str(4 * CAMERA.width), str(4 * CAMERA.width * CAMERA.height)]
