"""Serialised messages into files, one function a kind of bag."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

#: A message to be written: topic, log time in ns, message.
Entry = tuple[str, int, Any]


def write_ros1(path: Path, entries: Iterable[Entry], compression: str, store: Any) -> None:
    from rosbags.rosbag1 import Writer

    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    connections: dict[str, Any] = {}
    with writer:
        for topic, log_ns, item in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, item.__msgtype__, typestore=store)
            writer.write(connections[topic], log_ns, store.serialize_ros1(item, item.__msgtype__))


def write_ros2(path: Path, plugin_name: str, entries: Iterable[Entry], compression: str, store: Any) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    plugin = StoragePlugin.MCAP if plugin_name == "ros2-mcap" else StoragePlugin.SQLITE3
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat[compression.upper()])
    connections: dict[str, Any] = {}
    with writer:
        for topic, log_ns, item in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, item.__msgtype__, typestore=store)
            writer.write(connections[topic], log_ns, store.serialize_cdr(item, item.__msgtype__))


def write_mcap(path: Path, entries: Iterable[Entry], compression: str, store: Any, **options: Any) -> None:
    from mcap.writer import CompressionType, Writer

    channels: dict[str, int] = {}
    with path.open("wb") as stream:
        kind = CompressionType[compression.upper()] if compression else CompressionType.NONE
        writer = Writer(stream, chunk_size=64 * 1024, compression=kind, **options)
        writer.start(profile="ros1", library="tests")
        for topic, log_ns, item in entries:
            if topic not in channels:
                text, md5 = store.generate_msgdef(item.__msgtype__)
                name = item.__msgtype__.replace("/msg/", "/")
                schema = writer.register_schema(name, "ros1msg", text.encode())
                channels[topic] = writer.register_channel(topic, "ros1", schema, {"md5sum": md5})
            data = bytes(store.serialize_ros1(item, item.__msgtype__))
            writer.add_message(channels[topic], log_time=log_ns, publish_time=log_ns, data=data)
        writer.finish()
