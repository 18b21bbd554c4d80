"""Opening a bag of any kind and streaming its messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import BagFormat, bag_format
from maomaps_warp.io.bags.decoding import deserialise
from maomaps_warp.io.bags.errors import bag_errors
from maomaps_warp.io.bags.mcap_storage import open_mcap_file
from maomaps_warp.io.bags.storage import BagStorage, Channel, open_ros1_bag, open_ros2_folder, open_sqlite_file

#: How each kind of bag is opened, and how a damaged one is repaired.
_OPENERS: dict[BagFormat, tuple[Callable[[Path, ExitStack], BagStorage], str]] = {
    "ros1": (open_ros1_bag, "repair it with `rosbag reindex {path}`"),
    "ros2": (open_ros2_folder, "repair it with `ros2 bag reindex {path}`"),
    "sqlite": (open_sqlite_file, "repair it with `ros2 bag reindex` on its folder"),
    "mcap": (open_mcap_file, "repair it with `mcap recover {path} -o recovered.mcap`"),
}


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name: as recorded; ROS 1 allows names without a leading slash.
        type: in ROS 2 notation ("sensor_msgs/msg/Image"), for ROS 1 too.
        count: messages.
        encoding: what an image topic's first message states; empty for other topics.
    """

    name: str
    type: str
    count: int
    encoding: str = ""

    def __str__(self) -> str:
        count = "1 message" if self.count == 1 else f"{self.count} messages"
        details = (self.type.replace("/msg/", "/"), self.encoding, count)
        return f"{self.name} ({', '.join(x for x in details if x)})"

    def is_named(self, name: str) -> bool:
        """Whether a user who writes `name` means this topic: the leading slash does not matter."""
        return self.name.strip("/") == name.strip("/")


@dataclass(frozen=True, eq=False)
class Bag:
    """An open bag.

    Attributes:
        path: where it lies.
        topics: what it holds, by name.
        storage: its raw messages.
        repair_hint: how a damaged bag of this kind is repaired, for messages.
    """

    path: Path
    topics: tuple[Topic, ...]
    storage: BagStorage
    repair_hint: str

    def messages(self, topics: Sequence[str]) -> Generator[tuple[str, int, Any]]:
        """Stream the messages of `topics` in log-time order.

        Types that come with ROS are read by their standard definition, others by the one in the bag.

        Yields:
            Topic name, log time in ns, and the message, whose fields are named as in its definition (times
            have sec and nanosec in ROS 1 too).

        Raises:
            InputError: damaged or missing data, a topic of several types, an unknown definition.
        """
        channels = self._channels(topics)
        for channel, log_ns, data in self._raw(channels):
            yield channel.topic, log_ns, self._deserialised(channel, data)

    def first_message(self, topic: Topic) -> Any:
        """The first message of a topic that has some."""
        with closing(self.messages([topic.name])) as messages:
            for _, _, message in messages:
                return message
        raise InputError(f"{self.path}, topic {topic.name}", "no messages", self.repair_hint)

    def last_message(self, topic: Topic) -> Any:
        """The last message of a topic that has some; the ones before it are not deserialised."""
        newest = deque(self._raw(self._channels([topic.name])), maxlen=1)
        if not newest:
            raise InputError(f"{self.path}, topic {topic.name}", "no messages", self.repair_hint)
        channel, _, data = newest[0]
        return self._deserialised(channel, data)

    def _channels(self, topics: Sequence[str]) -> list[Channel]:
        channels = [channel for channel in self.storage.channels if channel.topic in topics]
        for name in topics:
            types = sorted({channel.type for channel in channels if channel.topic == name})
            if len(types) > 1:
                where = f"{self.path}, topic {name}"
                raise InputError(where, f"several types: {', '.join(types)}", "filter the bag to one of them")
        return channels

    def _raw(self, channels: Sequence[Channel]) -> Iterator[tuple[Channel, int, bytes]]:
        messages = self.storage.raw(channels)
        missing = sum(channel.count for channel in channels)
        while True:
            with bag_errors(self.path, self.repair_hint):
                item = next(messages, None)
            if item is None:
                break
            missing -= 1
            yield item
        if missing > 0:
            names = ", ".join(sorted({channel.topic for channel in channels}))
            found = f"{missing} messages that the bag's index counts are not there"
            raise InputError(f"{self.path}, topic {names}", found, self.repair_hint)

    def _deserialised(self, channel: Channel, data: bytes) -> Any:
        where = f"{self.path}, topic {channel.topic}"
        with bag_errors(where, self.repair_hint):
            return deserialise(channel, data, where)


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag of any kind that `recognise_bag` knows.

    Raises:
        InputError: absent, empty, not a bag, not indexed, or damaged; says how to repair it.
    """
    kind = bag_format(path)
    if kind is None:
        raise _not_a_bag(path)
    opener, repair = _OPENERS[kind]
    hint = repair.format(path=path)
    with ExitStack() as stack:
        with bag_errors(path, hint):
            storage = opener(path, stack)
        yield Bag(path, _topics_of(storage), storage, hint)


def _topics_of(storage: BagStorage) -> tuple[Topic, ...]:
    counts: dict[tuple[str, str], int] = {}
    for channel in storage.channels:
        key = (channel.topic, channel.type)
        counts[key] = counts.get(key, 0) + channel.count
    return tuple(Topic(name, message_type, count) for (name, message_type), count in sorted(counts.items()))


def _not_a_bag(path: Path) -> InputError:
    kinds = "a bag is a ROS 1 .bag, a ROS 2 folder with metadata.yaml, a .db3 or an .mcap"
    if not path.exists():
        return InputError(path, "no such file", kinds)
    if path.is_dir():
        return InputError(path, "a folder without a ROS 2 metadata.yaml", kinds)
    try:
        with path.open("rb") as file:
            empty = not file.read(1)
    except OSError as error:
        return InputError(path, f"cannot be opened: {error.strerror}")
    return InputError(path, "the file is empty" if empty else "not a bag", kinds)
