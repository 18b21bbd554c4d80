"""Serialised ROS messages to objects."""

from __future__ import annotations

import functools
from typing import Any

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.storage import Channel


def deserialise(channel: Channel, data: bytes, where: str) -> Any:
    """The message in `data`.

    Args:
        channel: the stream that it comes from.
        data: the serialised message.
        where: bag and topic, for errors.

    Returns:
        An object with the fields of the message's definition.

    Raises:
        InputError: an encoding that is not ROS's, or a definition that is unknown or not the standard's.
        Exception: whatever rosbags raises for damaged data; `bag_errors` turns it into an InputError.
    """
    if channel.encoding not in ("ros1", "cdr"):
        found = f"messages of {channel.type or 'unknown type'} in the encoding {channel.encoding!r}"
        raise InputError(where, found, "the encodings ros1 and cdr can be read")
    store = _typestore_for(channel, where)
    if channel.encoding == "ros1":
        return store.deserialize_ros1(data, channel.type)
    return store.deserialize_cdr(data, channel.type)


@functools.lru_cache(maxsize=64)
def _typestore_for(channel: Channel, where: str) -> Any:
    """The types needed by a channel: those that come with ROS, or else the bag's own definition.

    Each foreign type gets a store of its own, so that one odd definition in a bag cannot hurt the others.
    """
    standard = _standard_types(channel.encoding)
    if channel.type in standard.fielddefs:
        if channel.encoding == "ros1" and channel.md5 not in ("", "*", _md5(channel.type)):
            raise InputError(
                where,
                f"its {channel.type} is not defined as in ROS Noetic (md5 {channel.md5})",
                "migrate the bag with `rosbag fix`",
            )
        return standard
    if not channel.definition:
        raise InputError(where, f"{channel.type} is not defined in the bag", "only standard types need not be")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel.definition, channel.type))
    return store


@functools.cache
def _standard_types(encoding: str) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.LATEST)


def _md5(message_type: str) -> str:
    """ROS 1's fingerprint of a standard type."""
    return str(_standard_types("ros1").generate_msgdef(message_type)[1])
