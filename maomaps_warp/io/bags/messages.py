"""What is inside single ROS messages: stamps and images."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.images import (
    COLOR_ENCODINGS,
    DEPTH_ENCODINGS,
    decode_color,
    decode_compressed_color,
    decode_compressed_depth,
    decode_depth,
)

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"


def header_stamp_ns(header: Any, where: str) -> int:
    """The stamp of a std_msgs/Header, nanoseconds.

    Args:
        header: the message's header.
        where: bag, topic and message, for the error.

    Raises:
        InputError: the stamp is zero, as drivers that do not set it leave it, or negative.
    """
    stamp_ns = int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
    if stamp_ns <= 0:
        raise InputError(
            where,
            f"the header's stamp is {stamp_ns} ns: it was never set",
            "poses and images pair by the stamps of their headers; record with a driver that sets them",
        )
    return stamp_ns


def image_encoding(message: Any) -> str:
    """What an Image or CompressedImage says that it holds ("32FC1", "16UC1; compressedDepth png", "jpeg")."""
    return str(message.format if hasattr(message, "format") else message.encoding)


def image_role(message_type: str, encoding: str) -> Literal["depths", "colors", "others"]:
    """What an image topic can serve as, by its type and the encoding of its first message."""
    if message_type == IMAGE:
        if encoding in DEPTH_ENCODINGS:
            return "depths"
        return "colors" if encoding in COLOR_ENCODINGS else "others"
    text = encoding.lower()
    # image_transport writes "<encoding of the source>; <codec> ..."; older drivers the codec alone.
    if "compresseddepth" in text or encoding.partition(";")[0].strip() in DEPTH_ENCODINGS:
        return "depths"
    return "colors" if any(codec in text for codec in ("jpeg", "jpg", "png")) else "others"


def depth_of(message: Any, where: str) -> NDArray[np.float32]:
    """The depth image of an Image or CompressedImage, (H, W) float32 metres, 0 = missing.

    Raises:
        InputError: what `images` does not decode.
    """
    if hasattr(message, "format"):
        return decode_compressed_depth(message.data, message.format, where)
    return decode_depth(
        message.data,
        message.height,
        message.width,
        message.step,
        message.encoding,
        bool(message.is_bigendian),
        where,
    )


def color_of(message: Any, where: str) -> NDArray[np.uint8]:
    """The colour image of an Image or CompressedImage, (H, W, 3) uint8 RGB.

    The JPEG and PNG of image_transport are ordinary RGB files, whatever order of channels the source had.

    Raises:
        InputError: what `images` does not decode.
    """
    if hasattr(message, "format"):
        return decode_compressed_color(message.data, where)
    return decode_color(message.data, message.height, message.width, message.step, message.encoding, where)
