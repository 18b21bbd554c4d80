"""What every reader of a side gives, and what the user may say about reading it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from maomaps_warp.errors import InputError
from maomaps_warp.io.images import MAX_COLOR_GAP_NS
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.frame import FrameStream
from maomaps_warp.model.trajectory import Trajectory

#: Whose input it is: of a comparison, or the only one of a command; options are named after it.
Side = Literal["gt", "est", "one"]
#: What is wanted of a path: everything, what a map can be made of, or the poses. What is not wanted is not read:
#: it may be missing, damaged or ambiguous.
Part = Literal["all", "map", "trajectory"]


@dataclass(frozen=True, eq=False)
class Source:
    """One side of a comparison, opened.

    Attributes:
        name: what the user gave.
        kind: what it was recognised as ("ROS 1 bag", "PCD map"), for reports.
        trajectory: its poses, or None.
        cloud: its map as points, or None.
        frames: depth frames to build the map from, or None; never beside a cloud. Frame i has pose i of its
            trajectory where either has no stamps.
        camera: the camera of its frames, else what it states about its camera; None if it states nothing.
        start_pose: (x, y, z, yaw), metres and radians, of a MAOMaps sample; else None.
        one_clock: frames and trajectory come from one recording; False: from two files, so that an offset of the
            trajectory's stamps holds against the frames too.
        notes: what was decided or left out in reading any part of it, one short sentence each.
    """

    name: str
    kind: str
    trajectory: Trajectory | None = None
    cloud: PointCloud | None = None
    frames: FrameStream | None = None
    camera: Camera | None = None
    start_pose: tuple[float, float, float, float] | None = None
    one_clock: bool = True
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class SourceOptions:
    """What the user said about how to read a side.

    Attributes:
        run: "first" or "second" of a MAOMaps sample directory.
        topics: topics of a bag, in any order; whatever they leave open is found by type.
        format: one of `source_kinds.FORMATS`; "auto" recognises it.
        pose_frame: what the recorded poses mean: a text for `parse_convention`; "auto" is the format's.
        camera: what to use instead of the camera that the source states.
        max_color_gap_ns: largest distance of the stamps of a depth image and its colours in a bag, ns.
    """

    run: str | None = None
    topics: tuple[str, ...] = ()
    format: str = "auto"
    pose_frame: str = "auto"
    camera: Camera | None = None
    max_color_gap_ns: int = MAX_COLOR_GAP_NS


def option(side: Side, name: str) -> str:
    """How the command line calls an option of one side: "--gt-topic", or "--topic" where there is one input."""
    return f"--{name}" if side == "one" else f"--{side}-{name}"


def notes_of(*parts: Trajectory | PointCloud | None) -> tuple[str, ...]:
    """The notes of all parts that are there."""
    return tuple(note for part in parts if part is not None for note in part.notes)


def camera_or_note(read: Callable[[], Camera | None]) -> tuple[Camera | None, tuple[str, ...]]:
    """The camera of a source whose own images are not used, or None and a note why it cannot be read."""
    try:
        return read(), ()
    except InputError as error:
        return None, (f"camera not used: {error.where}: {error.found}",)
