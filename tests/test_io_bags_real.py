from __future__ import annotations

import struct
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_samples import ROTATION_TOLERANCE, bag_cloud, bag_contents, bag_frames, bag_trajectory, every_kind, some_poses
from bags import BagKind, bag_path, storage_file, write_rgbd_bag
from PIL import Image
from scipy.spatial.transform import Rotation
from shared_data import shared_data

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags import open_bag
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame


def tum_frames(count: int) -> tuple[list[Frame], list[np.ndarray]]:
    """Real frames whose 16-bit numbers are taken for millimetres, and those numbers."""
    folder = shared_data("rgbd_tum_fr1_rpy_a")
    names = [x.split() for x in (folder / "associations.txt").read_text().splitlines() if x[:1] not in ("#", "")]
    files = sorted((folder / "depth").iterdir())[:count]
    colors_of = {}
    for row in names:
        paths = [x for x in row if x.endswith(".png")]
        colors_of[next(x for x in paths if "depth" in x)] = next(x for x in paths if "rgb" in x)
    frames, raws = [], []
    for i, file in enumerate(files):
        raw = np.asarray(Image.open(file))
        colors = np.asarray(Image.open(folder / colors_of[f"depth/{file.name}"]))
        seconds, micros = file.stem.split(".")
        stamp_ns = int(seconds) * 10**9 + int(micros) * 1000
        frames.append(Frame(i, stamp_ns, (raw / 1000).astype(np.float32), colors))
        raws.append(raw)
    return frames, raws


@every_kind
def test_real_frames_survive_every_kind_of_bag(kind: BagKind, tmp_path: Path) -> None:
    check_real_frames(kind, 4, tmp_path)


@pytest.mark.slow
@every_kind
def test_a_hundred_real_frames_survive_every_kind_of_bag(kind: BagKind, tmp_path: Path) -> None:
    check_real_frames(kind, 100, tmp_path)


def check_real_frames(kind: BagKind, count: int, folder: Path) -> None:
    frames, raws = tum_frames(count)
    assert len(frames) == count
    poses = replace(some_poses(count), stamps_ns=np.array([x.stamp_ns for x in frames]))
    camera = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    for encoding in ("16UC1", "32FC1"):
        path = folder / encoding / bag_path(folder, kind).name
        path.parent.mkdir()
        write_rgbd_bag(path, kind, frames, poses, camera, depth_encoding=encoding)
        for found, frame, raw in zip(bag_frames(path, camera=None).read(True), frames, raws, strict=True):
            np.testing.assert_array_equal(found.depth, (raw / 1000).astype(np.float32))
            np.testing.assert_array_equal(found.colors, frame.colors)
            assert found.stamp_ns == frame.stamp_ns


@pytest.mark.parametrize(
    ("name", "topic", "count", "path_length"),
    [
        # Path lengths in metres, as evo 1.38 prints them (evo_traj bag --full_check).
        ("ROS_example.bag", "groundtruth", 12765, 304.207),
        ("ROS_example.bag", "/ORB-SLAM", 8362, 264.793),
        ("ROS_example.bag", "S-PTAM", 5439, 259.680),
        ("nav2_turtlebot.mcap", "/odom", 2639, 34.322),
        ("nav2_turtlebot.mcap", "/amcl_pose", 135, 34.450),
    ],
)
def test_real_trajectories_are_read_whole(name: str, topic: str, count: int, path_length: float) -> None:
    from rosbags.highlevel import AnyReader

    path = shared_data("bags_evo") / name
    found = bag_trajectory(path, topics=[topic], pose_frame="optical")
    assert len(found) == count
    assert found.path_length == pytest.approx(path_length, abs=5e-4)  # metres: evo prints three decimals
    with AnyReader([path]) as reader:
        wanted = [x for x in reader.connections if x.topic.strip("/") == topic.strip("/")]
        for i, (connection, _, data) in enumerate(reader.messages(wanted)):
            item = reader.deserialize(data, connection.msgtype)
            pose = item.pose.pose if hasattr(item.pose, "pose") else item.pose
            assert found.stamps_ns[i] == item.header.stamp.sec * 10**9 + item.header.stamp.nanosec
            np.testing.assert_array_equal(found.positions[i], [pose.position.x, pose.position.y, pose.position.z])
            if i % 100 == 0:
                q = pose.orientation
                R = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
                np.testing.assert_allclose(found.T_world_camera[i, :3, :3], R, rtol=0, atol=ROTATION_TOLERANCE)


@pytest.mark.parametrize("name", ["tf_example.bag", "tf_example", "tf_example/tf_example.db3"])
def test_a_bag_of_transforms_alone_has_no_trajectory_and_lists_its_topics(name: str) -> None:
    path = shared_data("bags_evo") / name
    with open_bag(path) as bag:
        counts = {x.name: x.count for x in bag.topics}
        assert sum(1 for _ in bag.messages(["/tf"])) == 517
    assert counts == {"/tf": 517, "/tf_static": 1}
    with pytest.raises(InputError, match=r"no topic with poses.*/tf \(tf2_msgs/TFMessage, 517 messages\)"):
        bag_trajectory(path)


def test_a_real_lidar_cloud_is_unpacked_as_struct_unpacks_it() -> None:
    from rosbags.highlevel import AnyReader

    path = shared_data("bags_pointcloud") / "embag_test.bag"
    found = bag_cloud(path)
    assert found.frame_id == "luminar_lidar"
    assert found.notes == ("/luminar_pointcloud: the last of 5 clouds is used",)
    with AnyReader([path]) as reader:
        wanted = [x for x in reader.connections if x.topic == "/luminar_pointcloud"]
        *_, (connection, _, data) = reader.messages(wanted)
        cloud = reader.deserialize(data, connection.msgtype)
    offsets = {x.name: x.offset for x in cloud.fields}
    raw = bytes(cloud.data)
    expected = [
        [struct.unpack_from("<f", raw, start + offsets[axis])[0] for axis in "xyz"]
        for start in range(0, len(raw), cloud.point_step)
    ]
    assert len(expected) == 36336
    np.testing.assert_array_equal(found.points, expected)


def test_a_real_coloured_cloud_and_real_images_are_recognised() -> None:
    path = shared_data("bags_pointcloud") / "ros_numpy_test.bag"
    cloud = bag_cloud(path)
    assert len(cloud) == 100 and cloud.colors is not None
    assert (cloud.colors[:, 2] == 255).all() and (cloud.colors[:, 1] == 0).all()
    contents = bag_contents(path)
    assert {x.name: x.encoding for x in contents.colors} == {"/image": "rgb8", "/compressedimage": "png"}
    with pytest.raises(InputError, match="no topic with depth images"):
        bag_frames(path, camera=None)


@pytest.mark.slow
def test_a_real_mcap_of_263_clouds_gives_its_last_one_from_folder_and_file(tmp_path: Path) -> None:
    archive = next(shared_data("bags_pointcloud").glob("*.tar.xz"))
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path, filter="data")
    folder = next(x for x in tmp_path.iterdir() if x.is_dir())
    cloud, alone = bag_cloud(folder), bag_cloud(storage_file(folder))
    assert len(cloud) == 38548 and cloud.frame_id == "d435_depth_optical_frame"
    assert cloud.notes == ("/point_cloud: the last of 263 clouds is used",)
    np.testing.assert_array_equal(cloud.points, alone.points)
