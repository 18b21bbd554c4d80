"""Writes RGB-D recordings as bags."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from maomaps_warp.io.bags.writing import BagKind, Entry, MessageMaker, write_bag
from maomaps_warp.io.rotations import quaternions_from_matrices
from maomaps_warp.model.frame import FrameStream
from maomaps_warp.model.trajectory import Trajectory

#: Topics of a recording; depth is registered to the colour image, so both have the same camera.
RGB_TOPIC = "/camera/rgb/image_raw"
RGB_INFO_TOPIC = "/camera/rgb/camera_info"
DEPTH_TOPIC = "/camera/depth/image_raw"
DEPTH_INFO_TOPIC = "/camera/depth/camera_info"
POSE_TOPIC = "/gt/pose"
CAMERA_FRAME = "camera_optical_frame"
WORLD_FRAME = "world"

_Kind = Literal["ros1", "mcap"]


def write_rgbd_bag(path: Path, stream: FrameStream, trajectory: Trajectory, *, kind: _Kind) -> None:
    """Writes frames and their ground truth as a bag, uncompressed, in the order of the stamps.

    Topics: `/camera/rgb/image_raw` (rgb8), `/camera/depth/image_raw` (32FC1, metres, 0 = missing),
    `/camera/rgb/camera_info`, `/camera/depth/camera_info`, `/gt/pose` (PoseStamped of the optical frame in
    "world"). Every message's time is the stamp of its header.

    Args:
        path: what to make: a ".bag" file for "ros1", a folder (metadata.yaml and one .mcap file) for "mcap".
            It appears when it is complete, never before.
        stream: frames with stamps and colours.
        trajectory: poses with stamps, their own or the frames'.
        kind: "ros1" (bag format 2.0) or "mcap" (ROS 2 bag with MCAP storage).

    Raises:
        InputError: something is at `path` already, or it cannot be written.
        ValueError: frames or poses lack stamps, or frames lack colours.
    """
    if trajectory.stamps_ns is None:
        raise ValueError("a bag needs poses with stamps")
    bag_kind: BagKind = "ros1" if kind == "ros1" else "ros2"
    make = MessageMaker.of(bag_kind)
    entries = heapq.merge(_frame_entries(stream, make), _pose_entries(trajectory, make), key=lambda entry: entry[1])
    write_bag(path, bag_kind, entries)


def _frame_entries(stream: FrameStream, make: MessageMaker) -> Iterator[Entry]:
    for frame in stream.read(True):
        if frame.stamp_ns is None or frame.colors is None:
            raise ValueError(f"a bag needs frames with stamps and colours; frame {frame.index} lacks them")
        header = make.header(frame.stamp_ns, CAMERA_FRAME, frame.index)
        info = make.camera_info(header, stream.camera)
        yield RGB_INFO_TOPIC, frame.stamp_ns, info
        yield RGB_TOPIC, frame.stamp_ns, make.image(header, "rgb8", frame.colors)
        yield DEPTH_INFO_TOPIC, frame.stamp_ns, info
        yield DEPTH_TOPIC, frame.stamp_ns, make.image(header, "32FC1", frame.depth)


def _pose_entries(trajectory: Trajectory, make: MessageMaker) -> Iterator[Entry]:
    assert trajectory.stamps_ns is not None
    quaternions = quaternions_from_matrices(trajectory.T_world_camera[:, :3, :3]).tolist()
    poses = zip(trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), quaternions, strict=True)
    for index, (stamp, position, xyzw) in enumerate(poses):
        yield POSE_TOPIC, stamp, make.pose_stamped(make.header(stamp, WORLD_FRAME, index), position, xyzw)
