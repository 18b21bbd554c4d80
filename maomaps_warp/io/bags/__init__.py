"""Bags: ROS 1, ROS 2 (folder, SQLite, MCAP), and MCAP with ROS 1 messages.

    open_contents -> read_bag_trajectory | read_bag_cloud | read_bag_camera | read_bag_frames

`read_bag` does all of it for one side of a comparison. Topics are found by type where there is one candidate.
"""

from maomaps_warp.io.bags.cloud import read_bag_cloud, read_bag_clouds
from maomaps_warp.io.bags.frames import read_bag_camera, read_bag_frames
from maomaps_warp.io.bags.reading import open_bag
from maomaps_warp.io.bags.side import read_bag
from maomaps_warp.io.bags.topics import BagContents, open_contents
from maomaps_warp.io.bags.trajectory import read_bag_trajectory

__all__ = [
    "BagContents",
    "open_bag",
    "open_contents",
    "read_bag",
    "read_bag_camera",
    "read_bag_cloud",
    "read_bag_clouds",
    "read_bag_frames",
    "read_bag_trajectory",
]
