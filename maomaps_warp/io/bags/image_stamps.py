"""Stamps of the images of a bag, without decoding one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.io.bags.messages import header_stamp_ns
from maomaps_warp.io.bags.topics import open_contents


def read_image_stamps(
    path: Path, topics: tuple[str, ...], topic_option: str
) -> tuple[NDArray[np.int64], NDArray[np.int64] | None]:
    """Stamps of the headers of a bag's depth and colour images.

    Args:
        path: the bag.
        topics: topics that the user named.
        topic_option: how the command line calls the option that names topics, for errors.

    Returns:
        (N,) int64 of the depth images and (M,) int64 of the colour images, nanoseconds, ascending. The second is None
        if no topic holds colours.

    Raises:
        InputError: a damaged bag, no or several candidates of a kind, stamps that were never set.
    """
    with open_contents(path, topics, topic_option) as contents:
        depth = contents.choose("depths").name
        color = contents.choose("colors").name if contents.colors else None
        stamps: dict[str, list[int]] = {name: [] for name in (depth, color) if name is not None}
        for name, _, message in contents.bag.messages(list(stamps)):
            place = f"{path}, topic {name}, message {len(stamps[name]) + 1}"
            stamps[name].append(header_stamp_ns(message.header, place))
    arrays = {name: np.sort(np.array(values, dtype=np.int64)) for name, values in stamps.items()}
    return arrays[depth], arrays.get(color) if color is not None else None
