from __future__ import annotations

import random
import struct
from pathlib import Path

import bags
import pytest
from bag_samples import T0_NS, bag_contents, bag_trajectory, every_kind, read_everything, whole_bag
from bags import BagKind, bag_path, storage_file, write_bag

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import recognise_bag
from maomaps_warp.io.bags import open_bag


@every_kind
def test_a_bag_cut_anywhere_is_refused_with_its_name_or_read(kind: BagKind, tmp_path: Path) -> None:
    path = whole_bag(tmp_path, kind)
    file = storage_file(path)
    data = file.read_bytes()
    cuts = {0, 1, 8, 13, 40, 4096, 4117, len(data) - 1, len(data) - 8, len(data) - 37}
    cuts |= {len(data) * i // 40 for i in range(40)}
    refused = 0
    for cut in sorted(cuts):
        file.write_bytes(data[:cut])
        try:
            read_everything(path)
        except InputError as error:
            refused += 1
            assert str(path) in error.where and error.found
    assert refused == len(cuts), "a cut bag was taken for a whole one"


@every_kind
@pytest.mark.parametrize("trials", [12, pytest.param(200, marks=pytest.mark.slow)])
def test_flipped_bits_never_escape_as_an_error_of_a_library(kind: BagKind, trials: int, tmp_path: Path) -> None:
    path = whole_bag(tmp_path, kind)
    file = storage_file(path)
    data = file.read_bytes()
    rng = random.Random(4)
    for _ in range(trials):
        damaged = bytearray(data)
        for _ in range(rng.choice([1, 1, 8])):
            damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        file.write_bytes(damaged)
        try:
            read_everything(path)
        except InputError as error:
            assert error.where and error.found


def test_an_unindexed_bag_is_refused_with_the_command_that_repairs_it(tmp_path: Path) -> None:
    path = whole_bag(tmp_path, "ros1")
    data = path.read_bytes()
    start = data.index(b"index_pos=") + len(b"index_pos=")
    active = tmp_path / "run.bag.active"
    active.write_bytes(data[:start] + bytes(8) + data[start + 8 :])
    with pytest.raises(InputError, match=rf"{active}.*not indexed.*rosbag reindex"):
        bag_contents(active)


def test_an_mcap_without_its_end_is_refused_with_the_command_that_repairs_it(tmp_path: Path) -> None:
    path = whole_bag(tmp_path, "mcap-ros1")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=rf"{path}.*cut short.*mcap recover"):
        bag_contents(path)


def test_a_ros2_folder_that_lost_its_metadata_is_refused_with_the_command_that_repairs_it(
    tmp_path: Path,
) -> None:
    path = whole_bag(tmp_path, "ros2-sqlite3")
    (path / "metadata.yaml").unlink()
    assert recognise_bag(path)
    with pytest.raises(InputError, match=rf"{path}.*metadata.*ros2 bag reindex"):
        bag_contents(path)


def test_a_broken_chunk_is_refused(tmp_path: Path) -> None:
    entries = [("/pose", T0_NS + i, bags.pose_stamped("ros1", T0_NS + i, (0, 0, 0))) for i in range(50)]
    for compression in ("bz2", "lz4"):
        path = write_bag(tmp_path / f"{compression}.bag", "ros1", entries, compression=compression)
        data = bytearray(path.read_bytes())
        chunk = data.index(b"compression=") + 60
        data[chunk : chunk + 40] = bytes(40)
        path.write_bytes(data)
        with pytest.raises(InputError, match=str(path)):
            bag_trajectory(path)


@every_kind
def test_an_empty_bag_has_no_topics_and_says_so(kind: BagKind, tmp_path: Path) -> None:
    path = write_bag(bag_path(tmp_path, kind), kind, [])
    assert bag_contents(path).all == ()
    with pytest.raises(InputError, match=r"no topic with poses.*holds no messages"):
        bag_trajectory(path)


def test_what_is_not_a_bag_is_refused_and_told_apart(tmp_path: Path) -> None:
    text, empty, folder = tmp_path / "a.bag", tmp_path / "b.bag", tmp_path / "c"
    text.write_text("1 2 3\n")
    empty.touch()
    folder.mkdir()
    (folder / "first.bag").touch()
    for path, found in (
        (text, "not a bag"),
        (empty, "empty"),
        (folder, "folder"),
        (tmp_path / "d", "no such file"),
    ):
        assert not recognise_bag(path)
        with pytest.raises(InputError, match=found) as caught, open_bag(path):
            pass
        assert caught.value.where == str(path)


def test_a_topic_with_messages_of_another_definition_is_refused(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer

    path = tmp_path / "old.bag"
    with Writer(path) as writer:
        connection = writer.add_connection(
            "/pose", "geometry_msgs/msg/PoseStamped", msgdef="float64 x", md5sum="0" * 32
        )
        writer.write(connection, T0_NS, struct.pack("<d", 1.0))
    with pytest.raises(InputError, match=r"topic /pose.*md5 0000.*rosbag fix"):
        bag_trajectory(path)


def test_a_damaged_message_is_refused_with_its_topic(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer

    path = tmp_path / "bad.bag"
    with Writer(path) as writer:
        connection = writer.add_connection("/pose", "geometry_msgs/msg/PoseStamped", typestore=bags.typestore("ros1"))
        writer.write(connection, T0_NS, b"\x01\x02\x03")
    with pytest.raises(InputError, match=r"topic /pose"):
        bag_trajectory(path)
