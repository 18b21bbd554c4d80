"""Bags: ROS 1, ROS 2 (folder, SQLite, MCAP), and MCAP with ROS 1 messages.

    recognise_bag -> describe_bag -> read_bag_trajectory | read_bag_cloud | read_bag_camera | read_bag_frames

`open_bag` streams any topic of a standard type. Topics are found by type where there is one candidate.
"""

from maomaps_warp.io.bag_cloud import read_bag_cloud
from maomaps_warp.io.bag_frames import read_bag_camera, read_bag_frames
from maomaps_warp.io.bag_reading import Bag, Topic, open_bag, recognise_bag
from maomaps_warp.io.bag_topics import BagContents, describe_bag
from maomaps_warp.io.bag_trajectory import read_bag_trajectory

__all__ = [
    "Bag",
    "BagContents",
    "Topic",
    "describe_bag",
    "open_bag",
    "read_bag_camera",
    "read_bag_cloud",
    "read_bag_frames",
    "read_bag_trajectory",
    "recognise_bag",
]
