"""Which kind of bag a path is, by its first bytes; apart from the readers of bags, which take a while to load."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

BagFormat = Literal["ros1", "ros2", "sqlite", "mcap"]

#: First and last eight bytes of every complete MCAP file.
MCAP_MAGIC = b"\x89MCAP0\r\n"
_SQLITE_MAGIC = b"SQLite format 3\x00"
_MAGICS: dict[bytes, BagFormat] = {b"#ROSBAG V": "ros1", MCAP_MAGIC: "mcap", _SQLITE_MAGIC: "sqlite"}
_FOLDER_KEY = "rosbag2_bagfile_information"


def recognise_bag(path: Path) -> bool:
    """Whether `path` is a bag, judged by content: a ROS 1 bag, a ROS 2 folder, a lone SQLite or MCAP file.

    A folder of storage files that lost its metadata.yaml counts, so that `open_bag` can say what is wrong.
    """
    return bag_format(path) is not None


def bag_format(path: Path) -> BagFormat | None:
    """What kind of bag `path` is: "ros1", "ros2" (a folder), "sqlite" or "mcap" (lone files); None if it is none."""
    try:
        if path.is_dir():
            return "ros2" if _is_ros2_folder(path) else None
        with path.open("rb") as file:
            head = file.read(len(_SQLITE_MAGIC))
    except OSError:
        return None
    return next((found for magic, found in _MAGICS.items() if head.startswith(magic)), None)


def _is_ros2_folder(path: Path) -> bool:
    metadata = path / "metadata.yaml"
    if metadata.is_file():
        return _FOLDER_KEY in metadata.read_text(encoding="utf-8", errors="replace")
    return any(x.suffix in (".db3", ".mcap") for x in path.iterdir())
