"""Writes RGB-D recordings as bags."""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.io.bags.writing import BagKind, Entry, MessageMaker, write_bag
from maomaps_warp.io.rotations import quaternions_from_matrices
from maomaps_warp.model.frame import FrameStream
from maomaps_warp.model.pose_convention import T_BODY_CAMERA
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.simulator import EXACT_DEPTH

CAMERA_FRAME = "camera_optical_frame"
WORLD_FRAME = "world"


@dataclass(frozen=True)
class Topics:
    """Names of a recording's topics; depth is registered to the colour image, so both have the same camera.

    Attributes:
        rgb, depth, pose: rgb8; 32FC1, metres, 0 = missing; PoseStamped in "world".
        infos: topics of the camera's calibration, one message a frame each.
        has_body_poses: poses are those of the robot's body at the camera's place (x forward, y left, z up); else the
            camera's (x right, y down, z forward).
        extras: topics of further images, by their names; float32 is written as 32FC1 or 32FC3, int32 as 32SC1.
        part_names: String, the first message: a JSON list, the name of each number in the image of parts.
    """

    rgb: str
    depth: str
    pose: str
    infos: tuple[str, ...]
    has_body_poses: bool
    extras: Mapping[str, str] = field(default_factory=dict)
    part_names: str = "/parts"


#: Each image with its calibration, as drivers of RGB-D cameras have it.
CAMERA_TOPICS = Topics(
    "/camera/rgb/image_raw",
    "/camera/depth/image_raw",
    "/gt/pose",
    ("/camera/rgb/camera_info", "/camera/depth/camera_info"),
    has_body_poses=False,
)
#: As the MAOMaps recorder publishes them; poses by the plainest of its conventions ("maomaps-c").
MAOMAPS_TOPICS = Topics(
    "/habitat/rgb/image",
    "/habitat/depth/image",
    "/true_pose",
    ("/habitat/rgb/camera_info",),
    has_body_poses=True,
    extras={
        "normals": "/habitat/normals/image",
        "parts": "/habitat/semantic/image",
        EXACT_DEPTH: "/true_depth/image",
    },
    part_names="/habitat/semantic/parts",
)


def write_rgbd_bag(
    path: Path,
    stream: FrameStream,
    trajectory: Trajectory,
    *,
    kind: BagKind,
    topics: Topics = CAMERA_TOPICS,
    part_names: Sequence[str] = (),
    stop: Event | None = None,
    overwrite: bool = False,
) -> None:
    """Writes frames and their ground truth as a bag, uncompressed, in the order of the stamps.

    Every message's time is the stamp of its header.

    Args:
        path: what to make: a ".bag" file for "ros1", an ".mcap" file for "mcap", a folder for "ros2". It appears when
            it is complete, never before.
        stream: frames with stamps and colours.
        trajectory: poses with stamps, their own or the frames'.
        kind: see `write_bag`.
        topics: under which names, and which poses.
        part_names: what the numbers in the images of parts mean; written if there are any.
        stop: once it is set, the bag ends with the frame that was written last; poses after it are left out.
        overwrite: replace a bag that stands there.

    Raises:
        InputError: something is at `path` already, or it cannot be written.
        ValueError: frames or poses lack stamps, frames lack colours, or there is no topic for an extra image.
    """
    if trajectory.stamps_ns is None:
        raise ValueError("a bag needs poses with stamps")
    make = MessageMaker.of(kind)
    stop = stop or Event()
    frames, poses = _frame_entries(stream, topics, make, part_names, stop), _pose_entries(trajectory, topics, make)
    entries = heapq.merge(frames, poses, key=lambda entry: entry[1])
    write_bag(path, kind, _until(entries, stop, topics), overwrite=overwrite)


def _until(entries: Iterator[Entry], stop: Event, topics: Topics) -> Iterator[Entry]:
    """The entries; after a stop those that are not later than the last depth image."""
    last = -1
    for entry in entries:
        topic, stamp_ns, _ = entry
        if stop.is_set() and topic == topics.pose and stamp_ns > last:
            return
        last = stamp_ns if topic == topics.depth else last
        yield entry


def _frame_entries(
    stream: FrameStream, topics: Topics, make: MessageMaker, part_names: Sequence[str], stop: Event
) -> Iterator[Entry]:
    for frame in stream.read(True):
        if frame.stamp_ns is None or frame.colors is None:
            raise ValueError(f"a bag needs frames with stamps and colours; frame {frame.index} lacks them")
        header = make.header(frame.stamp_ns, CAMERA_FRAME, frame.index)
        if part_names and not frame.index:
            yield topics.part_names, frame.stamp_ns, make.string(json.dumps(list(part_names)))
        info = make.camera_info(header, stream.camera)
        for topic in topics.infos:
            yield topic, frame.stamp_ns, info
        yield topics.rgb, frame.stamp_ns, make.image(header, "rgb8", frame.colors)
        yield topics.depth, frame.stamp_ns, make.image(header, "32FC1", frame.depth)
        for name, image in frame.extras.items():
            if name not in topics.extras:
                raise ValueError(f"there is no topic for images named {name!r}")
            yield topics.extras[name], frame.stamp_ns, make.image(header, _encoding(image), image)
        if stop.is_set():
            return


def _encoding(image: NDArray[Any]) -> str:
    """Of an image of float32 or int32, with one channel or three: "32FC1", "32FC3", "32SC1"."""
    kinds = {np.dtype(np.float32): "32FC", np.dtype(np.int32): "32SC"}
    if image.dtype not in kinds or image.shape[2:] not in ((), (3,)):
        raise ValueError(f"extra images are float32 or int32, (H, W) or (H, W, 3), got {image.shape} {image.dtype}")
    return f"{kinds[image.dtype]}{image.shape[2] if image.ndim == 3 else 1}"


def _pose_entries(trajectory: Trajectory, topics: Topics, make: MessageMaker) -> Iterator[Entry]:
    assert trajectory.stamps_ns is not None
    R = trajectory.T_world_camera[:, :3, :3]
    if topics.has_body_poses:
        R = R @ T_BODY_CAMERA[:3, :3].T
    quaternions = quaternions_from_matrices(R).tolist()
    poses = zip(trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), quaternions, strict=True)
    for index, (stamp, position, xyzw) in enumerate(poses):
        yield topics.pose, stamp, make.pose_stamped(make.header(stamp, WORLD_FRAME, index), position, xyzw)
