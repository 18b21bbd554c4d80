"""Raw messages of every kind of bag that rosbags reads, behind one small interface."""

from __future__ import annotations

import copy
import heapq
import io
import struct
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from maomaps_warp.io.read_ahead import ahead


@dataclass(frozen=True)
class Channel:
    """One recorded stream of messages; a topic may have several.

    Attributes:
        id: its number in the bag.
        topic: name.
        type: in ROS 2 notation ("sensor_msgs/msg/Image"), for ROS 1 too.
        count: messages.
        encoding: "ros1", "cdr", or something that we do not read.
        md5: ROS 1's fingerprint of the message definition; empty where the bag does not state it.
        definition: the message definition in ROS's .msg notation; empty where the bag does not hold it.
    """

    id: int
    topic: str
    type: str
    count: int
    encoding: str
    md5: str = ""
    definition: str = ""


class BagStorage(Protocol):
    """An open bag."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What it holds."""

    def raw(self, channels: Sequence[Channel]) -> Iterator[tuple[Channel, int, bytes]]:
        """Messages of `channels` as (channel, log time in ns, serialised message), in log-time order."""


@dataclass(frozen=True, eq=False)
class RosbagsStorage:
    """A bag opened by one of rosbags' readers."""

    reader: Any
    channels: tuple[Channel, ...]

    def raw(self, channels: Sequence[Channel]) -> Iterator[tuple[Channel, int, bytes]]:
        """Messages of `channels`, streamed in log-time order."""
        by_id = {channel.id: channel for channel in channels}
        connections = [x for x in self.reader.connections if x.id in by_id]
        if not connections:  # rosbags takes an empty list for "all".
            return
        for connection, log_ns, data in self.reader.messages(connections):
            yield by_id[connection.id], log_ns, data


@dataclass(frozen=True, eq=False)
class Ros1Storage:
    """A ROS 1 bag opened by rosbags' reader."""

    reader: Any
    channels: tuple[Channel, ...]

    def raw(self, channels: Sequence[Channel]) -> Iterator[tuple[Channel, int, bytes]]:
        """Messages of `channels`, streamed in log-time order; compressed chunks are unpacked ahead, on all cores."""
        wanted = {channel.id for channel in channels}
        indexes = [self.reader.indexes[x.id] for x in self.reader.connections if x.id in wanted]
        # The reader reads messages out of chunks that `decompressor` unpacks: here it finds them unpacked already. It
        # still reads the packed bytes itself, from the file's cache: that costs nothing beside unpacking them.
        with closing(ahead(self._unpacked, _compressed_chunks(self.reader.chunks, indexes))) as unpacked:
            own = copy.copy(self.reader)
            own.current_chunk = (-1, io.BytesIO())
            own.chunks = {
                place: chunk if _is_plain(chunk) else chunk._replace(decompressor=lambda _: next(unpacked))
                for place, chunk in self.reader.chunks.items()
            }
            yield from RosbagsStorage(own, self.channels).raw(channels)

    def _unpacked(self, chunk: Any) -> bytes:
        # A file object of its own: the position of the reader's belongs to the caller's thread.
        with self.reader.path.open("rb") as file:
            file.seek(chunk.datapos)
            data: bytes = chunk.decompressor(file.read(chunk.datasize))
        return data


def _is_plain(chunk: Any) -> bool:
    from rosbags.rosbag1.reader import Compression, decompressors

    return chunk.decompressor is decompressors[Compression.NONE.value]


def _compressed_chunks(chunks: dict[int, Any], indexes: list[Any]) -> Iterator[Any]:
    """The compressed chunks of messages in log-time order; again where it comes back to one, as the reader does."""
    last = -1
    for entry in heapq.merge(*indexes):
        if entry.chunk_pos != last and not _is_plain(chunks[entry.chunk_pos]):
            yield chunks[entry.chunk_pos]
        last = entry.chunk_pos


def open_ros1_bag(path: Path, stack: ExitStack) -> BagStorage:
    """Open a ROS 1 bag of version 2.0; `stack` closes it."""
    from rosbags.rosbag1 import Reader

    reader = stack.enter_context(Reader(path))
    return Ros1Storage(
        reader,
        tuple(
            Channel(x.id, x.topic, x.msgtype, x.msgcount, "ros1", x.digest, x.msgdef.data) for x in reader.connections
        ),
    )


def open_ros2_folder(path: Path, stack: ExitStack) -> BagStorage:
    """Open a ROS 2 bag folder, whatever its storage; `stack` closes it."""
    from rosbags.rosbag2 import Reader

    for file in path.glob("*.db3"):
        _check_whole(file)
    return _ros2_storage(stack.enter_context(Reader(path)))


def open_sqlite_file(path: Path, stack: ExitStack) -> BagStorage:
    """Open a ROS 2 storage file without its folder's metadata; `stack` closes it."""
    # rosbags' unified reader goes by the file's suffix; the storage reader beneath it does not.
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    _check_whole(path)
    reader = Sqlite3Reader(path)
    reader.open()
    stack.callback(reader.close)
    return _ros2_storage(reader)


def _ros2_storage(reader: Any) -> RosbagsStorage:
    from rosbags.interfaces import MessageDefinitionFormat

    return RosbagsStorage(
        reader,
        tuple(
            Channel(
                id=x.id,
                topic=x.topic,
                type=x.msgtype,
                count=x.msgcount,
                encoding=x.ext.serialization_format,
                definition=x.msgdef.data if x.msgdef.format == MessageDefinitionFormat.MSG else "",
            )
            for x in reader.connections
        ),
    )


def _check_whole(path: Path) -> None:
    """Raise EOFError if an SQLite file is shorter than its header says: SQLite reads zeros beyond the end."""
    with path.open("rb") as file:
        header = file.read(100)
    if len(header) < 100:
        raise EOFError(f"{len(header)} bytes are no SQLite database")
    # https://www.sqlite.org/fileformat.html, section 1.3: page size (1 stands for 65536), number of pages,
    # and the two counters that agree where that number is up to date.
    (page_size,) = struct.unpack_from(">H", header, 16)
    changes, pages = struct.unpack_from(">II", header, 24)
    (valid_for,) = struct.unpack_from(">I", header, 92)
    stated = pages * (65536 if page_size == 1 else page_size)
    size = path.stat().st_size
    if changes == valid_for and size < stated:
        raise EOFError(f"{size} of {stated} bytes are there")
