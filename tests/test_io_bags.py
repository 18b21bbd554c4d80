from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import bags
import pytest
from bag_samples import (
    CAMERA,
    STEP_NS,
    T0_NS,
    assert_same_frames,
    assert_same_poses,
    bag_camera,
    bag_contents,
    bag_frames,
    bag_trajectory,
    every_kind,
    some_frames,
    some_poses,
    whole_bag,
)
from bags import BAG_KINDS, BagKind, bag_path, storage_file, write_bag, write_rgbd_bag

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import recognise_bag
from maomaps_warp.io.bags import open_bag


@every_kind
@pytest.mark.parametrize("encoding", ["32FC1", "16UC1", "mono16", "16UC1; compressedDepth png"])
def test_what_is_written_into_a_bag_is_read_back_bit_by_bit(kind: BagKind, encoding: str, tmp_path: Path) -> None:
    frames, poses = some_frames(7), some_poses(7)
    path = write_rgbd_bag(bag_path(tmp_path, kind), kind, frames, poses, CAMERA, depth_encoding=encoding)
    assert recognise_bag(path)
    assert_same_poses(bag_trajectory(path), poses)
    assert bag_camera(path) == CAMERA
    stream = bag_frames(path, camera=None)
    assert (stream.camera, stream.count) == (CAMERA, 7)
    assert_same_frames(list(stream.read(True)), frames)
    assert_same_frames(list(stream.read(False)), [replace(x, colors=None) for x in frames])


@pytest.mark.parametrize("kind", ["ros2-sqlite3", "ros2-mcap"])
def test_the_storage_file_of_a_ros2_bag_can_be_read_alone_under_any_name(kind: BagKind, tmp_path: Path) -> None:
    frames, poses = some_frames(3), some_poses(3)
    folder = write_rgbd_bag(bag_path(tmp_path, kind), kind, frames, poses, CAMERA)
    path = Path(shutil.copy(storage_file(folder), tmp_path / "recording.data"))
    assert recognise_bag(path)
    assert_same_poses(bag_trajectory(path), poses)
    assert_same_frames(list(bag_frames(path, camera=None).read(True)), frames)


@pytest.mark.parametrize(
    ("kind", "compression"),
    [("ros1", "bz2"), ("ros1", "lz4"), ("ros2-sqlite3", "zstd"), ("ros2-mcap", "zstd"), ("mcap-ros1", "lz4")],
)
def test_compressed_bags_are_read(kind: BagKind, compression: str, tmp_path: Path) -> None:
    poses = some_poses(5)
    entries = bags.pose_messages(kind, "/pose", poses.stamps_ns.tolist(), poses.T_world_camera)
    path = write_bag(bag_path(tmp_path, kind), kind, entries, compression=compression)
    assert_same_poses(bag_trajectory(path), poses)


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"use_statistics": False},
        {
            "use_statistics": False,
            "repeat_channels": False,
            "repeat_schemas": False,
            "use_summary_offsets": False,
        },
    ],
)
def test_an_mcap_without_parts_of_its_summary_is_read(options: dict[str, bool], tmp_path: Path) -> None:
    poses = some_poses(9)
    entries = bags.pose_messages("mcap-ros1", "/pose", poses.stamps_ns.tolist(), poses.T_world_camera)
    path = bags.write_mcap_ros1(tmp_path / "run.mcap", entries, **options)
    assert bag_contents(path).poses[0].count == 9
    assert_same_poses(bag_trajectory(path), poses)


def test_messages_come_in_log_time_order_from_every_kind(tmp_path: Path) -> None:
    for kind in BAG_KINDS:
        stamps = [T0_NS + i * STEP_NS for i in (3, 1, 2, 5, 4)]
        entries = [("/b" if i % 2 else "/a", t, bags.pose_stamped(kind, t, (i, 0, 0))) for i, t in enumerate(stamps)]
        with open_bag(write_bag(bag_path(tmp_path, kind), kind, entries)) as bag:
            assert [(x.name, x.type, x.count) for x in bag.topics] == [
                ("/a", "geometry_msgs/msg/PoseStamped", 3),
                ("/b", "geometry_msgs/msg/PoseStamped", 2),
            ]
            assert [t for _, t, _ in bag.messages(["/a", "/b"])] == sorted(stamps), kind
            assert [(name, m.pose.position.x) for name, _, m in bag.messages(["/b"])] == [
                ("/b", 1),
                ("/b", 3),
            ]
            assert list(bag.messages([])) == []


@every_kind
def test_custom_message_types_do_not_disturb_the_standard_ones(kind: BagKind, tmp_path: Path) -> None:
    from rosbags.typesys import get_types_from_msg

    store = bags.new_typestore(kind)
    store.register(get_types_from_msg("float64 x\nstring[] names", "lab_msgs/msg/Odd"))
    odd = store.types["lab_msgs/msg/Odd"](1.0, ["a"])
    poses = some_poses(3)
    entries = bags.pose_messages(kind, "/pose", poses.stamps_ns.tolist(), poses.T_world_camera)
    path = write_bag(bag_path(tmp_path, kind), kind, [("/odd", T0_NS, odd), *entries], store=store)
    assert_same_poses(bag_trajectory(path), poses)
    assert [x.name for x in bag_contents(path).others] == ["/odd"]
    with open_bag(path) as bag:
        ((_, _, found),) = bag.messages(["/odd"])
    assert (found.x, found.names) == (1.0, ["a"])


def test_of_several_candidates_the_named_one_is_read_and_else_all_are_listed(tmp_path: Path) -> None:
    entries = [
        (name, T0_NS + i, bags.pose_stamped("ros1", T0_NS + i, (i, 0, 0))) for i, name in enumerate(["/a", "/b"])
    ]
    path = write_bag(tmp_path / "run.bag", "ros1", entries)
    assert bag_trajectory(path, topics=["/b"]).positions[0, 0] == 1
    assert bag_trajectory(path, topics=["b"]).positions[0, 0] == 1
    listing = r"/a \(geometry_msgs/PoseStamped, 1 message\); /b \(geometry_msgs/PoseStamped, 1 message\)"
    for topics in ([], ["/a", "/b"]):
        with pytest.raises(InputError, match=rf"2 topics.*--topic NAME: {listing}"):
            bag_trajectory(path, topics=topics)
    with pytest.raises(InputError, match=rf"no topic /c.*{listing}"):
        bag_trajectory(path, topics=["/c"])


def test_a_named_topic_of_no_use_is_refused(tmp_path: Path) -> None:
    stamp = bags.message("ros1", "builtin_interfaces/Time", 1, 0)
    clock = bags.message("ros1", "rosgraph_msgs/Clock", stamp)
    entries = [("/clock", T0_NS, clock), ("/pose", T0_NS, bags.pose_stamped("ros1", T0_NS, (0, 0, 0)))]
    path = write_bag(tmp_path / "run.bag", "ros1", entries)
    with pytest.raises(InputError, match=r"topic /clock.*nothing that can be scored.*/pose"):
        bag_trajectory(path, topics=["/clock"])


def test_a_bag_is_described_by_what_its_topics_can_serve_as(tmp_path: Path) -> None:
    contents = bag_contents(whole_bag(tmp_path, "ros2-mcap"))
    names = {
        role: [x.name for x in getattr(contents, role)]
        for role in ("poses", "clouds", "depths", "colors", "camera_infos", "others")
    }
    assert names == {
        "poses": ["/pose"],
        "clouds": ["/map"],
        "depths": ["/camera/depth/image"],
        "colors": ["/camera/rgb/image"],
        "camera_infos": ["/camera/depth/camera_info"],
        "others": [],
    }
    assert contents.depths[0].encoding == "32FC1" and contents.depths[0].count == 6
