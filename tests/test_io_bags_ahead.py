"""Bags whose chunks are unpacked ahead: every message, in the order of the libraries' own readers."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from bags import header, message, write_bag
from mcap.reader import SeekingReader
from rosbags.rosbag1 import Reader

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.reading import open_bag

#: Messages of 60 kB: several for each chunk of either kind of bag.
COUNT, BYTES = 80, 60_000


def entries(kind):
    """Two topics; some log times jump back, into the chunk before or to an equal one. The same ones each time."""
    rng = np.random.default_rng(7)
    for number in range(COUNT):
        log_ns = 10**9 + number * 30_000_000 - (450_000_000 if number % 20 == 19 else 0)
        pixels = np.full(BYTES, number, np.uint8)
        pixels[::100] = rng.integers(0, 256, BYTES // 100)
        values = (header(kind, 1 + number), 1, BYTES, "mono8", 0, BYTES, pixels)
        yield ("/a", "/b")[number % 2], log_ns, message(kind, "sensor_msgs/Image", *values)


def by_library(path, topics):
    """Topic, time and bytes of messages, as the bag's own library streams them."""
    if path.suffix == ".bag":
        with Reader(path) as reader:
            chosen = [x for x in reader.connections if x.topic in topics]
            return [(x.topic, log_ns, bytes(data)) for x, log_ns, data in reader.messages(chosen)]
    with path.open("rb") as stream:
        found = SeekingReader(stream, validate_crcs=True).iter_messages(topics=topics)
        return [(channel.topic, item.log_time, bytes(item.data)) for _, channel, item in found]


every_kind = pytest.mark.parametrize(
    ("kind", "compression"),
    [("ros1", ""), ("ros1", "bz2"), ("ros1", "lz4"), ("mcap-ros1", ""), ("mcap-ros1", "lz4"), ("mcap-ros1", "zstd")],
)


@every_kind
@pytest.mark.parametrize("topics", [["/a", "/b"], ["/b"]], ids=["both", "one"])
def test_messages_come_as_the_library_streams_them(tmp_path, monkeypatch, kind, compression, topics):
    suffix = ".bag" if kind == "ros1" else ".mcap"
    path = write_bag(tmp_path / f"run{suffix}", kind, entries(kind), compression=compression)
    expected = by_library(path, topics)
    assert len(expected) == COUNT * len(topics) // 2
    for threads in ("1", "3"):
        monkeypatch.setenv("MAOMAPS_THREADS", threads)
        with open_bag(path) as bag:
            raw = bag.storage.raw(bag._channels(topics))
            assert [(channel.topic, log_ns, bytes(data)) for channel, log_ns, data in raw] == expected


@every_kind
def test_two_streams_of_one_bag_do_not_disturb_each_other_and_end_early(tmp_path, kind, compression):
    suffix = ".bag" if kind == "ros1" else ".mcap"
    path = write_bag(tmp_path / f"run{suffix}", kind, entries(kind), compression=compression)
    before = threading.active_count()
    with open_bag(path) as bag:
        one, other = bag.messages(["/a"]), bag.messages(["/a", "/b"])
        stamps = []
        for _ in range(20):
            stamps.append(next(one)[1])
            next(other)
        assert stamps == [log_ns for _, log_ns, _ in by_library(path, ["/a"])][:20]
        one.close()
        other.close()
    assert threading.active_count() == before


@pytest.mark.parametrize(("kind", "compression"), [("ros1", "bz2"), ("ros1", "lz4"), ("mcap-ros1", "zstd")])
def test_a_damaged_chunk_in_the_middle_is_told_behind_the_messages_before_it(tmp_path, kind, compression):
    suffix = ".bag" if kind == "ros1" else ".mcap"
    path = write_bag(tmp_path / f"run{suffix}", kind, entries(kind), compression=compression)
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 64] = bytes(64)
    path.write_bytes(content)
    count = 0
    with open_bag(path) as bag, pytest.raises(InputError, match=path.name):
        for _ in bag.messages(["/a", "/b"]):
            count += 1
    assert 0 < count < COUNT
