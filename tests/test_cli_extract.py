"""`maomaps-warp extract` on real bags and on made ones."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import bags
import numpy as np
import pytest
from bag_samples import FLOAT32, T0_NS, UINT32, every_kind, xyz_cloud
from rosbags.highlevel import AnyReader
from shared_data import shared_data
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.io.clouds import read_cloud
from maomaps_warp.jobs.extract import file_stems

STEP_NS = 100_000_000
NAN = float("nan")
#: Dimensionless: quaternions go through matrices of float64 and may change their sign.
QUATERNION_TOLERANCE = 1e-12
#: Metres per coordinate of float64 that goes through text unchanged.
EXACT = 0.0


def extract(*arguments: object) -> Any:
    result = CliRunner().invoke(app, ["extract", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def names_in(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def refused(result: Any, *words: str) -> None:
    assert result.exit_code == 2 and result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("maomaps-warp: error: ")
    for word in words:
        assert word in line, line


def pcd_points(path: Path) -> np.ndarray:
    """x, y, z of a binary PCD that we wrote, read without our reader."""
    header, _, body = path.read_bytes().partition(b"DATA binary\n")
    fields = next(line.split()[1:] for line in header.decode().splitlines() if line.startswith("FIELDS"))
    return np.frombuffer(body, "<f4").reshape(-1, len(fields))[:, :3]


def recorded(path: Path, topic: str) -> list[Any]:
    """Every message of a topic, by rosbags."""
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        return [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(connections)]


def lidar_points(message: Any) -> np.ndarray:
    offsets = {field.name: field.offset for field in message.fields}
    dtype = np.dtype({"names": list("xyz"), "formats": ["<f4"] * 3, "offsets": [offsets[a] for a in "xyz"],
                      "itemsize": message.point_step})  # fmt: skip
    records = np.frombuffer(message.data.tobytes(), dtype)
    points = np.stack([records[axis] for axis in "xyz"], axis=1)
    return points[np.isfinite(points).all(axis=1)]


def test_the_last_cloud_and_the_odometry_of_a_real_lidar_bag(tmp_path: Path) -> None:
    path = shared_data("bags_pointcloud") / "embag_test.bag"
    result = extract(path, "-o", tmp_path / "out")
    assert result.exit_code == 0, result.stderr
    assert names_in(tmp_path / "out") == ["base_pose_ground_truth.txt", "luminar_pointcloud.pcd"]
    expected = lidar_points(recorded(path, "/luminar_pointcloud")[-1])
    np.testing.assert_array_equal(pcd_points(tmp_path / "out" / "luminar_pointcloud.pcd"), expected)
    rows = np.loadtxt(tmp_path / "out" / "base_pose_ground_truth.txt")
    positions = [m.pose.pose.position for m in recorded(path, "/base_pose_ground_truth")]
    np.testing.assert_array_equal(rows[:, 1:4], [[p.x, p.y, p.z] for p in positions])
    for words in ("/luminar_pointcloud", "sensor_msgs/PointCloud2", f"{len(expected)} points", "5 poses", ".pcd"):
        assert words in result.stdout
    assert "the last of 5 clouds is used" in result.stdout


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["ply", "txt"])
def test_every_cloud_of_a_real_bag_is_numbered_and_stamped(tmp_path: Path, suffix: str) -> None:
    path = shared_data("bags_pointcloud") / "embag_test.bag"
    arguments = ("--topic", "luminar_pointcloud", "--every", "--cloud-format", suffix)
    result = extract(path, "-o", tmp_path / "out", *arguments)
    assert result.exit_code == 0, result.stderr
    messages = recorded(path, "/luminar_pointcloud")
    stamps = [m.header.stamp for m in messages]
    assert names_in(tmp_path / "out") == [
        f"luminar_pointcloud_{i:06d}_{s.sec}.{s.nanosec:09d}.{suffix}" for i, s in enumerate(stamps, start=1)
    ]
    for name, message in zip(names_in(tmp_path / "out"), messages, strict=True):
        np.testing.assert_array_equal(read_cloud(tmp_path / "out" / name).points, lidar_points(message))
    assert "(5 files)" in result.stdout


def test_a_grid_without_a_resolution_is_told_and_the_cloud_is_written(tmp_path: Path) -> None:
    path = shared_data("bags_pointcloud") / "ros_numpy_test.bag"
    result = extract(path, "-o", tmp_path / "out")
    assert result.exit_code == 3
    assert names_in(tmp_path / "out") == ["pointcloud.pcd"]
    (line,) = result.stderr.splitlines()
    assert line.startswith("maomaps-warp: error: ") and "/occupancygrid: its cells have a size of 0 m" in line
    expected = lidar_points(recorded(path, "/pointcloud")[-1])
    np.testing.assert_array_equal(pcd_points(tmp_path / "out" / "pointcloud.pcd"), expected)


@pytest.mark.parametrize("pose_frame", ["auto", "optical"])
def test_poses_of_a_real_robot(tmp_path: Path, pose_frame: str) -> None:
    path = shared_data("bags_evo") / "nav2_turtlebot.mcap"
    result = extract(path, "-o", tmp_path / "out", "--pose-frame", pose_frame)
    assert result.exit_code == 0, result.stderr
    assert names_in(tmp_path / "out") == ["amcl_pose.txt", "odom.txt"]
    assert "2639 poses" in result.stdout and "135 poses" in result.stdout
    messages = recorded(path, "/odom")
    rows = np.loadtxt(tmp_path / "out" / "odom.txt")
    poses = [m.pose.pose for m in messages]
    np.testing.assert_allclose(
        rows[:, 1:4], [[p.position.x, p.position.y, p.position.z] for p in poses], rtol=0, atol=EXACT
    )
    lines = (tmp_path / "out" / "odom.txt").read_text().splitlines()[1:]
    stamps = [m.header.stamp for m in messages]
    assert [line.split()[0] for line in lines] == [f"{s.sec}.{s.nanosec:09d}" for s in stamps]
    if pose_frame == "optical":  # as recorded
        q = np.array([[getattr(p.orientation, axis) for axis in "xyzw"] for p in poses])
        np.testing.assert_allclose(np.abs((rows[:, 4:] * q).sum(axis=1)), 1.0, rtol=0, atol=QUATERNION_TOLERANCE)


def test_names_without_a_slash_and_named_topics_of_a_real_bag(tmp_path: Path) -> None:
    path = shared_data("bags_evo") / "ROS_example.bag"
    arguments = ("--topic", "/S-PTAM", "--trajectory-format", "maomaps")
    result = extract(path, "-o", tmp_path / "out", *arguments)
    assert result.exit_code == 0, result.stderr
    assert names_in(tmp_path / "out") == ["S-PTAM.txt", "S-PTAM_timestamps.txt"]
    p = recorded(path, "S-PTAM")[0].pose.position
    first = (tmp_path / "out" / "S-PTAM.txt").read_text().splitlines()[0].split()
    assert [float(word) for word in first[:3]] == [p.x, p.y, p.z]


def some_bag(folder: Path, kind: bags.BagKind, entries: list[Any]) -> Path:
    return bags.write_bag(bags.bag_path(folder, kind), kind, entries)


@every_kind
def test_a_pose_topic_without_stamps_is_told_and_the_rest_goes_on(tmp_path: Path, kind: bags.BagKind) -> None:
    entries = [
        ("/bad/pose", T0_NS, bags.pose_stamped(kind, 0, (1, 2, 3))),
        ("/good/pose", T0_NS, bags.pose_stamped(kind, T0_NS, (1, 2, 3))),
        ("/map", T0_NS, xyz_cloud(kind, T0_NS, [[1, 2, 3]])),
    ]
    result = extract(some_bag(tmp_path, kind, entries), "-o", tmp_path / "out")
    assert result.exit_code == 3
    assert names_in(tmp_path / "out") == ["good_pose.txt", "map.pcd"]
    (line,) = result.stderr.splitlines()
    assert "topic /bad/pose, message 1" in line and "never set" in line


@every_kind
def test_empty_clouds_among_many_are_counted_and_left_out(tmp_path: Path, kind: bags.BagKind) -> None:
    contents = [[], [[1, 2, 3], [NAN, 0, 0]], [[NAN, NAN, NAN]], [[4, 5, 6]]]
    entries = [
        ("/map", T0_NS + i * STEP_NS, xyz_cloud(kind, T0_NS + i * STEP_NS, points)) for i, points in enumerate(contents)
    ]
    result = extract(some_bag(tmp_path, kind, entries), "-o", tmp_path / "out", "--every")
    assert result.exit_code == 0, result.stderr
    assert [name[:10] for name in names_in(tmp_path / "out")] == ["map_000002", "map_000004"]
    assert "2 of 4 clouds have no finite point" in result.stdout
    assert "1 points that are NaN or infinite were dropped" in result.stdout


def test_a_topic_of_empty_clouds_is_told_with_every_and_without(tmp_path: Path) -> None:
    entries = [
        ("/empty", T0_NS, xyz_cloud("ros1", T0_NS, [])),
        ("/map", T0_NS, xyz_cloud("ros1", T0_NS, [[1, 2, 3]])),
    ]
    path = some_bag(tmp_path, "ros1", entries)
    for folder, more in ((tmp_path / "last", ()), (tmp_path / "every", ("--every",))):
        result = extract(path, "-o", folder, *more)
        assert result.exit_code == 3 and len(names_in(folder)) == 1
        assert "topic /empty: " in result.stderr


def test_colours_come_out_exactly(tmp_path: Path) -> None:
    points, rgb = [(1.5, 2.5, -3.5), (0.1, 0.2, 0.3)], [(255, 1, 2), (3, 200, 5)]
    data = b"".join(struct.pack("<3fI", *p, r << 16 | g << 8 | b) for p, (r, g, b) in zip(points, rgb, strict=True))
    fields = [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("rgb", 12, UINT32)]
    cloud = bags.cloud_message("ros1", T0_NS, fields, data, width=2, point_step=16)
    path = some_bag(tmp_path, "ros1", [("/map", T0_NS, cloud)])
    assert extract(path, "-o", tmp_path / "out", "--cloud-format", "txt").exit_code == 0
    rows = np.loadtxt(tmp_path / "out" / "map.txt")
    np.testing.assert_array_equal(rows[:, :3], np.array(points, np.float32))
    np.testing.assert_array_equal(rows[:, 3:], rgb)


def test_topics_whose_names_would_collide_get_files_of_their_own() -> None:
    topics = ["/a/b", "a_b", "/A/B", "/pose", "/pose/timestamps", "/~tf", "/.hidden", "/"]
    stems = file_stems(topics)
    assert stems[:3] == ["a_b", "a_b_2", "A_B_3"]
    assert stems[3:5] == ["pose", "pose_timestamps_2"]
    assert all(stem and stem[0] not in "./" and "/" not in stem for stem in stems)
    assert len({stem.lower() for stem in stems}) == len(topics)


def test_folders_in_use_are_left_alone_unless_told_otherwise(tmp_path: Path) -> None:
    path = some_bag(tmp_path, "ros1", [("/map", T0_NS, xyz_cloud("ros1", T0_NS, [[1, 2, 3]]))])
    out = tmp_path / "out"
    out.mkdir()
    assert extract(path, "-o", out).exit_code == 0
    (out / "notes.txt").write_text("precious")
    (out / "map.pcd").write_text("old")
    refused(extract(path, "-o", out), "is not empty", "--overwrite")
    assert (out / "map.pcd").read_text() == "old"
    assert extract(path, "-o", out, "--overwrite").exit_code == 0
    assert (out / "notes.txt").read_text() == "precious"
    assert pcd_points(out / "map.pcd").tolist() == [[1, 2, 3]]
    refused(extract(path, "-o", out / "notes.txt"), "is a file")


def test_bags_without_anything_to_take_are_refused_and_leave_no_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    refused(extract(shared_data("bags_evo") / "tf_example.bag", "-o", out), "/tf (tf2_msgs/TFMessage, 517 messages)")
    path = some_bag(tmp_path, "ros1", [("/pose", T0_NS, bags.pose_stamped("ros1", 0, (1, 2, 3)))])
    refused(extract(path, "-o", out), "nothing could be taken out", "never set")
    refused(extract(path, "-o", out, "--topic", "/map"), "no topic /map", "/pose")
    refused(extract(path, "-o", out, "--pose-frame", "sideways"), "--pose-frame sideways")
    refused(extract(tmp_path / "nothing.bag", "-o", out), "no such file")
    refused(extract(Path(__file__), "-o", out), "not a bag")
    refused(extract(shared_data("bags_evo") / "tf_example.bag", "-o", out, "--topic", "/tf"), "no clouds, poses")
    assert not out.exists()


def test_a_bag_that_was_cut_short_is_refused(tmp_path: Path) -> None:
    path = some_bag(tmp_path, "ros1", [("/map", T0_NS, xyz_cloud("ros1", T0_NS, [[1, 2, 3]]))])
    path.write_bytes(path.read_bytes()[:-200])
    refused(extract(path, "-o", tmp_path / "out"), "run.bag")
    assert not (tmp_path / "out").exists()
