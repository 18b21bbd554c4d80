"""Raw messages of a lone MCAP file, with ROS 1 or ROS 2 messages, through the mcap library."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from maomaps_warp.io.bags.storage import BagStorage, Channel

#: First and last eight bytes of every complete MCAP file.
MCAP_MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True, eq=False)
class McapStorage:
    """An open MCAP file.

    Attributes:
        stream: the file.
        channels: what it holds.
        indexed: whether it has an index of chunks; without one it is read from front to back.
    """

    stream: IO[bytes]
    channels: tuple[Channel, ...]
    indexed: bool

    def raw(self, channels: Sequence[Channel]) -> Iterator[tuple[Channel, int, bytes]]:
        """Messages of `channels`, streamed in log-time order, chunk by chunk; checksums are verified."""
        from mcap.exceptions import McapError

        by_id = {channel.id: channel for channel in channels}
        topics = {channel.topic for channel in channels}
        latest = 0
        for _, record, message in self._records(topics):
            if record.id not in by_id:
                continue
            if message.log_time < latest:
                # Sorting would need all of it in memory.
                raise McapError("its messages are neither indexed nor in the order of time")
            latest = message.log_time
            yield by_id[record.id], message.log_time, message.data

    def _records(self, topics: set[str]) -> Iterator[tuple[Any, Any, Any]]:
        from mcap.reader import NonSeekingReader, SeekingReader

        self.stream.seek(0)
        if self.indexed:
            return iter(SeekingReader(self.stream, validate_crcs=True).iter_messages(topics=topics))
        return iter(
            NonSeekingReader(self.stream, validate_crcs=True).iter_messages(topics=topics, log_time_order=False)
        )


def open_mcap_file(path: Path, stack: ExitStack) -> BagStorage:
    """Open a lone MCAP file; `stack` closes it."""
    from mcap.exceptions import McapError
    from mcap.reader import SeekingReader

    stream = stack.enter_context(path.open("rb"))
    stream.seek(-len(MCAP_MAGIC), os.SEEK_END)
    if stream.read() != MCAP_MAGIC:
        raise McapError("its end is missing, the recording was cut short")
    stream.seek(0)
    summary = SeekingReader(stream).get_summary()
    if summary is None or not _is_complete(summary):
        return McapStorage(stream, _scan(stream), indexed=False)
    counts = summary.statistics.channel_message_counts
    channels = tuple(
        _channel(x, summary.schemas.get(x.schema_id), counts.get(x.id, 0)) for x in summary.channels.values()
    )
    return McapStorage(stream, channels, indexed=True)


def _is_complete(summary: Any) -> bool:
    """Whether the summary says all that random access needs; each part of it is optional in the format."""
    schemas = all(x.schema_id == 0 or x.schema_id in summary.schemas for x in summary.channels.values())
    return bool(summary.statistics and summary.channels and summary.chunk_indexes and schemas)


def _scan(stream: IO[bytes]) -> tuple[Channel, ...]:
    """Channels that hold messages, found by reading the whole file."""
    from mcap.reader import NonSeekingReader

    stream.seek(0)
    found: dict[int, tuple[Any, Any]] = {}
    counts: Counter[int] = Counter()
    for schema, channel, _ in NonSeekingReader(stream).iter_messages(log_time_order=False):
        found[channel.id] = (channel, schema)
        counts[channel.id] += 1
    return tuple(_channel(channel, schema, counts[number]) for number, (channel, schema) in found.items())


def _channel(channel: Any, schema: Any, count: int) -> Channel:
    return Channel(
        id=channel.id,
        topic=channel.topic,
        type=_ros2_notation("" if schema is None else schema.name),
        count=count,
        encoding=channel.message_encoding,
        md5=channel.metadata.get("md5sum", ""),
        definition=schema.data.decode() if schema is not None and schema.encoding.endswith("msg") else "",
    )


def _ros2_notation(name: str) -> str:
    """ROS 1 writes a type "sensor_msgs/Image", ROS 2 "sensor_msgs/msg/Image"."""
    package, slash, rest = name.partition("/")
    return f"{package}/msg/{rest}" if slash and "/" not in rest else name
