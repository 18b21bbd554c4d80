"""Bags of every kind that are written: streamed, and there when they are complete."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path
from typing import Any

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import recognise_bag
from maomaps_warp.io.bags.making import BagKind, MessageMaker
from maomaps_warp.io.file_sets import write_file_set
from maomaps_warp.io.outputs import check_writable

__all__ = ["SUFFIXES", "BagKind", "Entry", "MessageMaker", "bag_kind", "check_new_bag", "write_bag"]

#: A message to be written: topic, time in ns, the message, as a MessageMaker of the bag's kind makes it.
Entry = tuple[str, int, Any]

#: Of the path of each kind of bag.
SUFFIXES: dict[BagKind, str] = {"ros1": ".bag", "mcap": ".mcap", "ros2": ""}
_KINDS: dict[str, BagKind] = {suffix: kind for kind, suffix in SUFFIXES.items()}


def bag_kind(path: Path) -> BagKind:
    """What to write at a path, by its suffix: a ROS 1 bag (.bag), an MCAP file (.mcap), a ROS 2 folder (none).

    Raises:
        InputError: another suffix.
    """
    if path.suffix.lower() not in _KINDS:
        hint = "allowed: NAME.bag (ROS 1), NAME.mcap (ROS 2, one file), NAME (ROS 2, a folder)"
        raise InputError(path, f"no bag can be written as {path.suffix!r}", hint)
    return _KINDS[path.suffix.lower()]


def check_new_bag(path: Path, *, overwrite: bool = False) -> None:
    """Find out, before a long computation, whether a bag could be written at `path`.

    Args:
        path: a file or a folder to be.
        overwrite: a file, or a folder that is a bag, may stand there; it is replaced in the end.

    Raises:
        InputError: something stands there, or the folder around it is missing or closed.
    """
    if path.exists() or path.is_symlink():
        if not overwrite:
            raise InputError(path, "exists already", "--overwrite replaces a bag; or choose another path")
        if path.is_dir() and not recognise_bag(path):
            raise InputError(path, "is a folder that is no bag: it is not replaced", "choose another path")
    if not path.is_dir():
        check_writable(path)


def write_bag(path: Path, kind: BagKind, entries: Iterable[Entry], *, overwrite: bool = False) -> None:
    """Write messages as a bag, uncompressed. It appears when it is complete, never before.

    The same messages give the same bytes.

    Args:
        path: where: a file for "ros1" and "mcap", a folder (metadata.yaml and one .mcap file) for "ros2".
        kind: "ros1" is a bag of format 2.0. "mcap" is a lone MCAP file of the profile ros2, which `ros2 bag` and
            Foxglove read; "ros2" a ROS 2 bag with MCAP storage.
        entries: messages by ascending time; at least one. They are written one by one.
        overwrite: replace a file, or a folder that is a bag; a link is followed, so that its target is replaced.

    Raises:
        InputError: something is at `path` already, or it cannot be written.
        ValueError: there is no message.
    """
    check_new_bag(path, overwrite=overwrite)
    place = path.resolve()
    left = iter(entries)
    try:
        with write_file_set(place.parent, (place.name,), overwrite=overwrite) as work:
            first = next(left, None)
            if first is None:
                raise ValueError("a bag needs at least one message")
            _WRITERS[kind](work / place.name, chain([first], left))
    except InputError as error:
        if error.where != str(place.parent):
            raise
        raise InputError(path, error.found, error.hint) from error


def _write_ros1(path: Path, entries: Iterable[Entry]) -> None:
    from rosbags.rosbag1 import Writer

    store = MessageMaker.of("ros1").store
    with Writer(path) as writer:
        _write_by_rosbags(writer, entries, store, store.serialize_ros1)


def _write_ros2(path: Path, entries: Iterable[Entry]) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = MessageMaker.of("ros2").store
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        _write_by_rosbags(writer, entries, store, store.serialize_cdr)


def _write_by_rosbags(writer: Any, entries: Iterable[Entry], store: Any, serialize: Callable[[Any, str], Any]) -> None:
    connections: dict[str, Any] = {}
    for topic, stamp_ns, message in entries:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store)
        writer.write(connections[topic], stamp_ns, serialize(message, message.__msgtype__))


def _write_mcap(path: Path, entries: Iterable[Entry]) -> None:
    """A lone file, as `ros2 bag record` stores it: schemas in ROS 2's notation, messages in CDR."""
    from mcap.writer import CompressionType, Writer

    store = MessageMaker.of("mcap").store
    channels: dict[str, int] = {}
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="maomaps-warp")
        for topic, stamp_ns, message in entries:
            name = message.__msgtype__
            if topic not in channels:
                text, _ = store.generate_msgdef(name, ros_version=2)
                schema = writer.register_schema(name, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": ""})
            data = bytes(store.serialize_cdr(message, name))
            writer.add_message(channels[topic], log_time=stamp_ns, publish_time=stamp_ns, data=data)
        writer.finish()


_WRITERS: dict[BagKind, Callable[[Path, Iterable[Entry]], None]] = {
    "ros1": _write_ros1,
    "ros2": _write_ros2,
    "mcap": _write_mcap,
}
