"""Bags that are written, read back with rosbags and mcap themselves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.writing import BagKind, Entry, MessageMaker, bag_kind, write_bag
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.occupancy import Cell, OccupancyGrid

STAMP = 1_700_000_000_900_000_001
NAMES: dict[BagKind, str] = {"ros1": "map.bag", "mcap": "map.mcap", "ros2": "map"}
every_kind = pytest.mark.parametrize("kind", NAMES)

RNG = np.random.default_rng(7)
CLOUD = PointCloud(RNG.normal(size=(300, 3)) * 20.0, RNG.integers(0, 256, (300, 3), dtype=np.uint8))
GRID = OccupancyGrid(
    np.array([[Cell.UNKNOWN, Cell.FREE, Cell.OCCUPIED], [Cell.FREE, Cell.FREE, Cell.UNKNOWN]], np.uint8),
    0.05,
    (-1.25, 3.5, 0.5),
)
#: What `rosmsg md5` of ROS Noetic prints.
MD5 = {
    "sensor_msgs/msg/PointCloud2": "1158d486dd51d683ce2f1be655c3c181",
    "nav_msgs/msg/Path": "6227e2b7e9cce15051f669a5e197bbf7",
    "nav_msgs/msg/OccupancyGrid": "3381f2d731d4076ec5c71b0759edbe4e",
}


def entries(kind: BagKind, count: int = 2) -> Iterator[Entry]:
    make = MessageMaker.of(kind)
    for number in range(count):
        stamp = STAMP + number * 10**9
        header = make.header(stamp, "map", number)
        pose = make.pose_stamped(header, (1.5, -2.5, 0.125), (0.0, 0.6, 0.0, 0.8))
        yield "/map", stamp, make.point_cloud(header, CLOUD)
        yield "/path", stamp, make.path(header, [pose, pose])
        yield "/grid", stamp, make.occupancy_grid(header, GRID)


def read_back(path: Path, kind: BagKind) -> dict[str, list[tuple[int, Any]]]:
    """Messages by topic, with their times: by rosbags, or for a lone file by mcap."""
    found: dict[str, list[tuple[int, Any]]] = {}
    if kind == "mcap":
        store = get_typestore(Stores.ROS2_JAZZY)
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
                item = store.deserialize_cdr(message.data, schema.name)
                found.setdefault(channel.topic, []).append((message.log_time, item))
        return found
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_JAZZY)
    deserialize = store.deserialize_ros1 if kind == "ros1" else store.deserialize_cdr
    with (rosbag1.Reader if kind == "ros1" else rosbag2.Reader)(path) as reader:
        for connection, time, data in reader.messages():
            found.setdefault(connection.topic, []).append((time, deserialize(data, connection.msgtype)))
    return found


@every_kind
def test_clouds_paths_and_grids_come_back(tmp_path: Path, kind: BagKind) -> None:
    path = tmp_path / NAMES[kind]
    assert bag_kind(path) == kind
    write_bag(path, kind, entries(kind))
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    found = read_back(path, kind)
    assert set(found) == {"/map", "/path", "/grid"}
    for messages in found.values():
        assert [time for time, _ in messages] == [STAMP, STAMP + 10**9]
        for time, message in messages:
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
            assert message.header.frame_id == "map"
    cloud = found["/map"][1][1]
    assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
        ("x", 0, 7, 1),
        ("y", 4, 7, 1),
        ("z", 8, 7, 1),
        ("rgb", 12, 7, 1),
    ]
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (1, 300, 16, 4800)
    assert cloud.is_dense and not cloud.is_bigendian
    rows = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(-1, 4)
    np.testing.assert_array_equal(rows[:, :3], CLOUD.points.astype(np.float32))
    bgra = np.frombuffer(cloud.data.tobytes(), np.uint8).reshape(-1, 16)[:, 12:]
    np.testing.assert_array_equal(bgra[:, 2::-1], CLOUD.colors)
    path_message = found["/path"][0][1]
    assert len(path_message.poses) == 2
    p, q = path_message.poses[1].pose.position, path_message.poses[1].pose.orientation
    assert (p.x, p.y, p.z, q.x, q.y, q.z, q.w) == (1.5, -2.5, 0.125, 0.0, 0.6, 0.0, 0.8)
    grid = found["/grid"][0][1]
    assert list(grid.data) == [-1, 0, 100, 0, 0, -1]
    assert (grid.info.width, grid.info.height, grid.info.resolution) == (3, 2, pytest.approx(0.05, rel=1e-7))
    origin = grid.info.origin
    assert (origin.position.x, origin.position.y, origin.position.z) == (-1.25, 3.5, 0.0)
    assert 2 * math.atan2(origin.orientation.z, origin.orientation.w) == pytest.approx(0.5, abs=1e-15)


def test_a_cloud_without_colours_has_three_fields() -> None:
    make = MessageMaker.of("ros1")
    message = make.point_cloud(make.header(STAMP, "map"), PointCloud(CLOUD.points))
    assert [field.name for field in message.fields] == ["x", "y", "z"] and message.point_step == 12


def test_ros_1_bags_state_the_checksums_of_noetic(tmp_path: Path) -> None:
    write_bag(tmp_path / "map.bag", "ros1", entries("ros1"))
    with rosbag1.Reader(tmp_path / "map.bag") as reader:
        assert {c.msgtype: c.digest for c in reader.connections} == MD5


def test_a_lone_mcap_file_has_the_profile_and_schemas_of_ros_2(tmp_path: Path) -> None:
    write_bag(tmp_path / "map.mcap", "mcap", entries("mcap"))
    with (tmp_path / "map.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None and summary.statistics is not None and summary.statistics.message_count == 6
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert channel.message_encoding == "cdr" and schema.encoding == "ros2msg"
        text = schema.data.decode()
        assert "MSG: std_msgs/Header" in text and "seq" not in text
    assert {schema.name for schema in summary.schemas.values()} == set(MD5)


@every_kind
def test_the_same_messages_give_the_same_bytes(tmp_path: Path, kind: BagKind) -> None:
    contents = []
    for folder in (tmp_path / "one", tmp_path / "two"):
        folder.mkdir()
        write_bag(folder / NAMES[kind], kind, entries(kind))
        files = sorted(file for file in folder.rglob("*") if file.is_file())
        contents.append([(file.name, file.read_bytes()) for file in files])
    assert contents[0] == contents[1] and contents[0]


@every_kind
def test_messages_are_taken_one_by_one(tmp_path: Path, kind: BagKind) -> None:
    seen: list[int] = []

    def counted() -> Iterator[Entry]:
        for entry in entries(kind, count=3):
            # A hidden folder holds the bag so far: nothing waits for the last message.
            seen.append(len([x for x in tmp_path.iterdir() if x.name.endswith(".part")]))
            yield entry

    write_bag(tmp_path / NAMES[kind], kind, counted())
    assert seen == [1] * 9


@every_kind
def test_nothing_is_left_when_the_messages_break_off(tmp_path: Path, kind: BagKind) -> None:
    def broken() -> Iterator[Entry]:
        yield from entries(kind, count=1)
        raise RuntimeError("out of messages")

    with pytest.raises(RuntimeError, match="out of messages"):
        write_bag(tmp_path / NAMES[kind], kind, broken())
    assert not list(tmp_path.iterdir())


@every_kind
def test_a_bag_is_replaced_only_on_request(tmp_path: Path, kind: BagKind) -> None:
    path = tmp_path / NAMES[kind]
    write_bag(path, kind, entries(kind, count=1))
    with pytest.raises(InputError, match="exists already"):
        write_bag(path, kind, entries(kind))
    assert len(read_back(path, kind)["/map"]) == 1
    write_bag(path, kind, entries(kind), overwrite=True)
    assert len(read_back(path, kind)["/map"]) == 2
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("name", ["replaced", "new", "former"])
def test_no_name_of_a_folder_stands_in_the_way_of_its_replacement(tmp_path: Path, name: str) -> None:
    for count in (1, 2):
        write_bag(tmp_path / name, "ros2", entries("ros2", count), overwrite=True)
    assert len(read_back(tmp_path / name, "ros2")["/map"]) == 2
    assert [entry.name for entry in tmp_path.iterdir()] == [name]


def test_a_bag_comes_back_if_the_new_one_cannot_take_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_bag(tmp_path / "map", "ros2", entries("ros2", 1))
    rename, failed = Path.rename, []

    def fail(self: Path, target: Path) -> Path:
        if self.parent.suffix == ".part":
            failed.append(self)
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(InputError, match="map: cannot be written: Input/output error"):
        write_bag(tmp_path / "map", "ros2", entries("ros2", 2), overwrite=True)
    assert len(failed) == 1
    assert len(read_back(tmp_path / "map", "ros2")["/map"]) == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["map"]


def test_a_link_is_followed_and_stays(tmp_path: Path) -> None:
    write_bag(tmp_path / "real.bag", "ros1", entries("ros1", 1))
    (tmp_path / "link.bag").symlink_to(tmp_path / "real.bag")
    write_bag(tmp_path / "link.bag", "ros1", entries("ros1", 2), overwrite=True)
    assert (tmp_path / "link.bag").is_symlink()
    assert len(read_back(tmp_path / "real.bag", "ros1")["/map"]) == 2


@every_kind
def test_a_bag_without_messages_is_refused(tmp_path: Path, kind: BagKind) -> None:
    with pytest.raises(ValueError, match="at least one message"):
        write_bag(tmp_path / NAMES[kind], kind, [])
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_no_bag_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match="no bag"):
        write_bag(tmp_path / "map", "ros2", entries("ros2"), overwrite=True)
    assert (tmp_path / "map" / "thesis.tex").read_text() == "precious"


def test_clouds_too_far_out_for_float32_are_refused_with_a_way_out() -> None:
    make = MessageMaker.of("mcap")
    points = CLOUD.points.copy()
    points[41, 1] = -10_001.0
    with pytest.raises(InputError, match=r"out\.pcd: point 42 lies at .* `transform`"):
        make.point_cloud(make.header(STAMP, "map"), PointCloud(points, source="out.pcd"))
    points[41, 1] = -9_999.0
    make.point_cloud(make.header(STAMP, "map"), PointCloud(points))


@pytest.mark.parametrize(
    ("kind", "stamp_ns"), [("ros1", 0), ("ros1", 2**32 * 10**9), ("mcap", 2**31 * 10**9), ("ros2", -5)]
)
def test_stamps_that_ros_cannot_hold_are_refused(kind: BagKind, stamp_ns: int) -> None:
    with pytest.raises(InputError, match="no time that a message can bear"):
        MessageMaker.of(kind).header(stamp_ns, "map")


def test_other_suffixes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"NAME\.bag .* NAME\.mcap"):
        bag_kind(tmp_path / "map.db3")
