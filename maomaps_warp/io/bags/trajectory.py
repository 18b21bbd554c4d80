"""Trajectories from the topics of a bag."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.messages import header_stamp_ns
from maomaps_warp.io.bags.reading import Bag, Topic
from maomaps_warp.io.bags.topics import BagContents
from maomaps_warp.io.rotations import checked_quaternions, matrices_from_quaternions, poses
from maomaps_warp.io.stamp_order import check_stamp_order
from maomaps_warp.model.pose_convention import parse_convention
from maomaps_warp.model.trajectory import Trajectory

_PATH = "nav_msgs/msg/Path"
_ODOMETRY = "nav_msgs/msg/Odometry"

#: Where each type keeps its position and its orientation.
_PARTS: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda m: (m.transform.translation, m.transform.rotation),
    _ODOMETRY: lambda m: (m.pose.pose.position, m.pose.pose.orientation),
}


@dataclass(frozen=True, eq=False)
class _Poses:
    """Poses as recorded.

    Attributes:
        stamps_ns: (N,) int64, ns.
        values: (N, 7) float64, x y z in metres and qx qy qz qw.
        frame_id, child_frame_id: the frames' names.
        notes: for the user.
    """

    stamps_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    frame_id: str
    child_frame_id: str
    notes: tuple[str, ...] = ()


def read_bag_trajectory(contents: BagContents, *, pose_frame: str = "auto") -> Trajectory:
    """Read the trajectory of the named topic of a bag, or else of the only candidate.

    Candidates are nav_msgs/Path (its last message that holds poses), nav_msgs/Odometry, and
    geometry_msgs/PoseStamped, PoseWithCovarianceStamped and TransformStamped.

    Args:
        contents: the open bag.
        pose_frame: what the poses mean, see `parse_convention`. "auto" takes Odometry whose child_frame_id does
            not contain "optical" for those of a body (x forward, y left, z up) in whose origin the camera looks
            forward, everything else for optical; without a child_frame_id that is an assumption.

    Returns:
        Poses with the stamps of the headers; the log times are not used.

    Raises:
        InputError: no or several candidates (lists them); stamps that are zero, fall or repeat often; positions
            that are not finite; quaternions whose norm is not 1; changing frames. Tells the message's number.
    """
    topic = contents.choose("poses")
    recorded = (_read_path if topic.type == _PATH else _read_messages)(contents.bag, topic)
    where = f"{contents.path}, topic {topic.name}"
    item = "pose" if topic.type == _PATH else "message"

    def place(row: int) -> str:
        return f"{where}, {item} {row + 1}"

    _check_positions(recorded, place)
    quaternions = checked_quaternions(recorded.values[:, 3:], place)
    T_world_pose = poses(recorded.values[:, :3], matrices_from_quaternions(quaternions))
    keep, notes = check_stamp_order(recorded.stamps_ns, T_world_pose, place, drop_copies=True)
    T_world_pose = T_world_pose[keep]
    child = recorded.child_frame_id
    usual = "body" if topic.type == _ODOMETRY and "optical" not in child else "optical"
    frame = usual if pose_frame == "auto" else pose_frame
    if frame == "body":
        body = f"the body {child!r}" if child else "a body"
        notes += (f"{topic.name}: read as poses of {body} (x forward, y left, z up)",)
    return Trajectory(
        T_world_camera=parse_convention(frame).camera_poses(T_world_pose),
        stamps_ns=recorded.stamps_ns[keep],
        source=where,
        frame_id=recorded.frame_id,
        pose_frame=frame,
        is_assumed=pose_frame == "auto" and not child,
        notes=recorded.notes + notes,
    )


def _read_messages(bag: Bag, topic: Topic) -> _Poses:
    messages = (message for _, _, message in bag.messages([topic.name]))
    return _collect(messages, _PARTS[topic.type], f"{bag.path}, topic {topic.name}, message")


def _read_path(bag: Bag, topic: Topic) -> _Poses:
    """The last nav_msgs/Path that holds poses: each message repeats the whole path so far."""
    message = bag.last_message(topic)
    notes = (f"{topic.name}: the last of {topic.count} paths is used",) if topic.count > 1 else ()
    if not len(message.poses):
        # A reset ends the recording with an empty path; only then is it worth to deserialise them all.
        for number, (_, _, candidate) in enumerate(bag.messages([topic.name]), start=1):
            if len(candidate.poses):
                message = candidate
                notes = (f"{topic.name}: path {number} of {topic.count} is used, the later ones are empty",)
    where = f"{bag.path}, topic {topic.name}"
    if not len(message.poses):
        raise InputError(where, f"none of its {topic.count} paths holds a pose")
    found = _collect(iter(message.poses), _PARTS["geometry_msgs/msg/PoseStamped"], f"{where}, pose")
    return _Poses(found.stamps_ns, found.values, message.header.frame_id or found.frame_id, "", notes)


def _collect(messages: Iterator[Any], parts: Callable[[Any], tuple[Any, Any]], place: str) -> _Poses:
    """Stamps and poses of messages; `place` is completed by the number of the message."""
    stamps: list[int] = []
    values: list[tuple[float, ...]] = []
    frames: tuple[str, str] | None = None
    for number, message in enumerate(messages, start=1):
        where = f"{place} {number}"
        stamps.append(header_stamp_ns(message.header, where))
        p, q = parts(message)
        values.append((p.x, p.y, p.z, q.x, q.y, q.z, q.w))
        these = (message.header.frame_id, getattr(message, "child_frame_id", ""))
        if frames is None:
            frames = these
        if these != frames:
            names = [" -> ".join(filter(None, pair)) for pair in (frames, these)]
            raise InputError(where, f"the frame changes from {names[0]!r} to {names[1]!r}", "use a topic of one frame")
    frame_id, child_frame_id = frames or ("", "")
    return _Poses(
        np.array(stamps, dtype=np.int64),
        np.array(values, dtype=np.float64).reshape(-1, 7),
        frame_id,
        child_frame_id,
    )


def _check_positions(recorded: _Poses, place: Callable[[int], str]) -> None:
    bad = np.flatnonzero(~np.isfinite(recorded.values[:, :3]).all(axis=1))
    if len(bad):
        more = f"; {len(bad)} of {len(recorded.values)} are so" if len(bad) > 1 else ""
        raise InputError(place(int(bad[0])), "the position is not finite" + more, "remove such poses")
