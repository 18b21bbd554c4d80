"""Point clouds from the topics of a bag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.topics import BagContents
from maomaps_warp.model.cloud import PointCloud

#: sensor_msgs/PointField datatype -> NumPy type.
_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_USED_FIELDS = ("x", "y", "z", "rgb", "rgba", "r", "g", "b")


def read_bag_cloud(contents: BagContents) -> PointCloud:
    """Read the last sensor_msgs/PointCloud2 of the named topic, or else of the only one with clouds.

    SLAM programs publish the growing map again and again; its last state is the map.

    Returns:
        Points with their colours, if the cloud has rgb, rgba or r, g, b; points that are not finite are
        dropped and counted. They stay in the frame of the message, which is named.

    Raises:
        InputError: no or several candidates (lists them), a damaged cloud, or one without a finite point.
    """
    topic = contents.choose("clouds")
    message = contents.bag.last_message(topic)
    where = f"{contents.path}, topic {topic.name}"
    cloud = _finite_cloud(message, where)
    if not len(cloud):
        total = cloud.dropped_nonfinite
        found = f"all {total} points of the last cloud are NaN or infinite" if total else "the last cloud is empty"
        raise InputError(
            where, found, f"choose another topic with {contents.topic_option} NAME, or check the recording"
        )
    if topic.count > 1:
        cloud = replace(cloud, notes=(f"{topic.name}: the last of {topic.count} clouds is used", *cloud.notes))
    return cloud


def read_bag_clouds(contents: BagContents) -> Iterator[tuple[int, PointCloud]]:
    """Read every sensor_msgs/PointCloud2 of the named topic, or else of the only one with clouds, one by one.

    Yields:
        The stamp of the header as it is, ns, zero included; and the cloud, as `read_bag_cloud` gives it, which may
        have no point.

    Raises:
        InputError: no or several candidates (lists them), or a damaged cloud.
    """
    topic = contents.choose("clouds")
    for number, (_, _, message) in enumerate(contents.bag.messages([topic.name]), start=1):
        stamp = message.header.stamp
        cloud = _finite_cloud(message, f"{contents.path}, topic {topic.name}, message {number}")
        yield int(stamp.sec) * 10**9 + int(stamp.nanosec), cloud


def _finite_cloud(message: Any, where: str) -> PointCloud:
    points, colors, notes = cloud_of(message, where)
    finite = np.isfinite(points).all(axis=1)
    return PointCloud(
        points=points[finite],
        colors=None if colors is None else colors[finite],
        dropped_nonfinite=int((~finite).sum()),
        source=where,
        frame_id=message.header.frame_id,
        notes=notes,
    )


def cloud_of(message: Any, where: str) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None, tuple[str, ...]]:
    """Unpack a PointCloud2.

    Args:
        message: the message, of ROS 1 or ROS 2.
        where: bag and topic, for errors.

    Returns:
        Points, (N, 3) float64 metres, not all of them finite; colours, (N, 3) uint8 RGB, or None; notes.

    Raises:
        InputError: no x, y, z of float32 or float64, or fields and sizes that contradict each other.
    """
    fields = {field.name: field for field in message.fields}
    missing = [name for name in "xyz" if name not in fields or fields[name].datatype not in (7, 8)]
    if missing:
        raise InputError(
            where,
            f"no float field {', '.join(missing)} among the fields {', '.join(fields) or '(none)'}",
            "x, y and z of float32 or float64 are needed",
        )
    records = _records(message, fields, where)
    points = np.stack([records[name].astype(np.float64) for name in "xyz"], axis=-1).reshape(-1, 3)
    colors, notes = _colors(records)
    return points, colors, notes


def _records(message: Any, fields: dict[str, Any], where: str) -> NDArray[np.void]:
    """The cloud's buffer as a (height, width) structured array: any offsets, byte order and padding."""
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    known = {name: fields[name] for name in _USED_FIELDS if name in fields and fields[name].datatype in _DATATYPES}
    formats = {name: np.dtype(_DATATYPES[field.datatype]).newbyteorder(order) for name, field in known.items()}
    height, width = int(message.height), int(message.width)
    point_step, row_step = int(message.point_step), int(message.row_step)
    if height * width == 0:
        return np.empty((0, 0), dtype=list(formats.items()))
    used = max(field.offset + formats[name].itemsize for name, field in known.items())
    if height == 1:
        row_step = width * point_step  # Some publishers leave it 0 in clouds of one row.
    needed = (height - 1) * row_step + width * point_step
    if used > point_step or row_step < width * point_step or len(message.data) < needed:
        raise InputError(
            where,
            f"{len(message.data)} bytes cannot hold {height} x {width} points of {used} bytes, "
            f"{point_step} apart, in rows of {row_step}",
            "the message is damaged or its publisher is faulty",
        )
    dtype = np.dtype(
        {
            "names": list(formats),
            "formats": list(formats.values()),
            "offsets": [field.offset for field in known.values()],
            "itemsize": point_step,
        }
    )
    return np.ndarray((height, width), dtype, np.ascontiguousarray(message.data), 0, (row_step, point_step))


def _colors(records: NDArray[np.void]) -> tuple[NDArray[np.uint8] | None, tuple[str, ...]]:
    """Colours of the points, (N, 3) uint8, from a packed rgb or rgba, or from bytes r, g, b."""
    names = records.dtype.names or ()
    for name in ("rgb", "rgba"):
        if name in names and records.dtype[name].itemsize == 4:
            # PCL packs the bytes 0xAARRGGBB into 32 bits and often calls them a float.
            field = np.ascontiguousarray(records[name]).reshape(-1)
            packed = field.view(np.dtype("u4").newbyteorder(field.dtype.byteorder))
            return np.stack([packed >> 16, packed >> 8, packed], axis=-1).astype(np.uint8), ()
    if all(name in names for name in "rgb"):
        if all(records.dtype[name] == np.uint8 for name in "rgb"):
            return np.stack([records[name].reshape(-1) for name in "rgb"], axis=-1), ()
        return None, ("the fields r, g, b are not bytes; colours were left out",)
    return None, ()
