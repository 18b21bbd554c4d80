"""Raw messages of a lone MCAP file, with ROS 1 or ROS 2 messages, through the mcap library."""

from __future__ import annotations

import heapq
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from maomaps_warp.io.bag_formats import MCAP_MAGIC
from maomaps_warp.io.bags.storage import BagStorage, Channel
from maomaps_warp.io.read_ahead import ahead

#: The opcode and the length that a record starts with.
_RECORD_HEADER_BYTES = 1 + 8


@dataclass(frozen=True, eq=False)
class McapStorage:
    """An open MCAP file.

    Attributes:
        stream: the file.
        channels: what it holds.
        summary: its summary, with an index of chunks; None if it is read from front to back for lack of one.
    """

    stream: IO[bytes]
    channels: tuple[Channel, ...]
    summary: Any | None

    def raw(self, channels: Sequence[Channel]) -> Iterator[tuple[Channel, int, bytes]]:
        """Messages of `channels`, streamed in log-time order, chunk by chunk; checksums are verified."""
        from mcap.exceptions import McapError

        by_id = {channel.id: channel for channel in channels}
        topics = {channel.topic for channel in channels}
        latest = 0
        for record, message in self._records(topics):
            if record.id not in by_id:
                continue
            if message.log_time < latest:
                # Sorting would need all of it in memory.
                raise McapError("its messages are neither indexed nor in the order of time")
            latest = message.log_time
            yield by_id[record.id], message.log_time, message.data

    def _records(self, topics: set[str]) -> Iterator[tuple[Any, Any]]:
        from mcap.reader import NonSeekingReader

        self.stream.seek(0)
        if self.summary is not None:
            return self._indexed_records(self.summary, topics)
        reader = NonSeekingReader(self.stream, validate_crcs=True)
        return ((channel, message) for _, channel, message in reader.iter_messages(topics, log_time_order=False))

    def _indexed_records(self, summary: Any, topics: set[str]) -> Iterator[tuple[Any, Any]]:
        """Channel and message of every message of `topics`, by time, then place; chunks are unpacked ahead."""
        wanted = {number for number, channel in summary.channels.items() if channel.topic in topics}
        # A chunk without an index of its messages may hold any.
        chunks = [
            x for x in summary.chunk_indexes if not x.message_index_offsets or wanted & {*x.message_index_offsets}
        ]
        chunks.sort(key=lambda x: (x.message_start_time, x.chunk_start_offset))
        waiting: list[tuple[int, int, int, Any]] = []
        with closing(ahead(self._messages, iter(chunks))) as unpacked:
            for chunk in chunks:
                start = (chunk.message_start_time, chunk.chunk_start_offset)
                while waiting and waiting[0][:2] < start:
                    message = heapq.heappop(waiting)[-1]
                    yield summary.channels[message.channel_id], message
                for index, message in next(unpacked):
                    if summary.channels[message.channel_id].topic in topics:
                        heapq.heappush(waiting, (message.log_time, chunk.chunk_start_offset, index, message))
        while waiting:
            message = heapq.heappop(waiting)[-1]
            yield summary.channels[message.channel_id], message

    def _messages(self, chunk_index: Any) -> list[tuple[int, Any]]:
        """The messages of a chunk, each with its place among the chunk's records; its checksum is verified."""
        from mcap.data_stream import ReadDataStream
        from mcap.records import Chunk, Message
        from mcap.stream_reader import breakup_chunk

        # A file object of its own: the position of the stream belongs to the caller's thread.
        with Path(self.stream.name).open("rb") as file:
            file.seek(chunk_index.chunk_start_offset + _RECORD_HEADER_BYTES)
            records = breakup_chunk(Chunk.read(ReadDataStream(file)), validate_crc=True)
        return [(index, record) for index, record in enumerate(records) if isinstance(record, Message)]


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
        return McapStorage(stream, _scan(stream), None)
    counts = summary.statistics.channel_message_counts
    channels = tuple(
        _channel(x, summary.schemas.get(x.schema_id), counts.get(x.id, 0)) for x in summary.channels.values()
    )
    return McapStorage(stream, channels, summary)


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
