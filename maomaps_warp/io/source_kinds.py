"""Every kind of file, folder and bag that can be a side of a comparison: how it is recognised and opened."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast, get_args

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags import (
    BagContents,
    describe_bag,
    read_bag_camera,
    read_bag_cloud,
    read_bag_frames,
    read_bag_trajectory,
    recognise_bag,
)
from maomaps_warp.io.clouds import KnownCloud, read_cloud, recognise_cloud
from maomaps_warp.io.original_directory import is_original_directory, read_original_side
from maomaps_warp.io.rgbd_folders import LAYOUTS, read_rgbd_folder, recognise_rgbd_folder
from maomaps_warp.io.sample_directories import is_sample_directory, read_sample
from maomaps_warp.io.tables import HEAD_BYTES, column_count, read_bytes, read_table, signature
from maomaps_warp.io.trajectories import (
    KnownFormat,
    PoseFrame,
    read_trajectory,
    recognise_trajectory,
)
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.frame import FrameStream
from maomaps_warp.model.trajectory import Trajectory

Side = Literal["gt", "est"]
#: What is wanted of a path: everything, what a map can be made of, or the poses.
Part = Literal["all", "map", "trajectory"]

TRAJECTORY_FORMATS: tuple[str, ...] = get_args(KnownFormat)
CLOUD_FORMATS: tuple[str, ...] = get_args(KnownCloud)
_FOLDER_FORMATS = ("sample", "original", *LAYOUTS)
#: Every name that `--gt-format` and `--est-format` take.
FORMATS = ("auto", *TRAJECTORY_FORMATS, *CLOUD_FORMATS, "bag", *_FOLDER_FORMATS)

_ACCEPTED = (
    "accepted: bags (ROS 1, ROS 2, MCAP); trajectories (TUM, KITTI, EuRoC, MAOMaps); "
    "maps (PCD, PLY, XYZ text, NPZ); RGB-D folders (TUM, 3DMatch / 7-Scenes, Open3D / Redwood); "
    "MAOMaps sample directories; directories of gt_points.txt, gt_poses.txt, slam_points.txt, slam_poses.txt"
)
_TRAJECTORY_NAMES = {"tum": "TUM", "kitti": "KITTI", "euroc": "EuRoC", "maomaps": "MAOMaps"}


@dataclass(frozen=True, eq=False)
class Source:
    """One side of a comparison, opened.

    Attributes:
        name: what the user gave.
        kind: what it was recognised as ("ROS 1 bag", "PCD map"), for reports.
        trajectory: its poses, or None.
        cloud: its map as points, or None.
        frames: depth frames to build the map from, or None; never beside a cloud.
        camera: the camera of its frames, else what it states about its camera; None if it states nothing.
        start_pose: (x, y, z, yaw), metres and radians, of a MAOMaps sample; else None.
        notes: what was decided or left out in reading any part of it, one short sentence each.
    """

    name: str
    kind: str
    trajectory: Trajectory | None = None
    cloud: PointCloud | None = None
    frames: FrameStream | None = None
    camera: Camera | None = None
    start_pose: tuple[float, float, float, float] | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class SourceOptions:
    """What the user said about how to read a side.

    Attributes:
        run: "first" or "second" of a MAOMaps sample directory.
        topics: topics of a bag, in any order; whatever they leave open is found by type.
        format: one of FORMATS; "auto" recognises it.
        pose_frame: whose poses a text file or a topic holds: "auto", "optical" or "body".
        camera: what to use instead of the camera that the source states.
    """

    run: str | None = None
    topics: tuple[str, ...] = ()
    format: str = "auto"
    pose_frame: PoseFrame = "auto"
    camera: Camera | None = None


def open_part(path: Path, options: SourceOptions, side: Side, part: Part) -> Source:
    """Open what is wanted of a path; the Source lacks what the path does not have.

    Args:
        path: any file, folder or bag.
        options: how to read it. A format that cannot give the part is meant for another path and passed over.
        side: whose it is.
        part: what is wanted. Poses where only a map is wanted, and images and clouds of a bag where only
            poses are, are not read, so that they may be missing, damaged or ambiguous.

    Raises:
        InputError: it is absent, unknown or damaged.
    """
    if options.format not in FORMATS:
        raise InputError(f"--{side}-format {options.format}", "is no format", f"allowed: {', '.join(FORMATS)}")
    if not path.exists():
        raise InputError(path, "no such file or folder")
    other = {"all": (), "map": TRAJECTORY_FORMATS, "trajectory": CLOUD_FORMATS}[part]
    format = "auto" if options.format in other else options.format
    if format == "auto":
        format = _recognise(path, side)
    elif format in _FOLDER_FORMATS and not path.is_dir():
        raise InputError(path, "is a file", f"--{side}-format {format} is a folder")
    return _OPENERS[format](path, format, options, side, part)


def _recognise(path: Path, side: Side) -> str:
    """The format of a path by its content: one of FORMATS, never "auto"."""
    if path.is_dir():
        if is_original_directory(path):
            return "original"
        # Before bags: a sample directory holds recordings too.
        if is_sample_directory(path):
            return "sample"
        layout = recognise_rgbd_folder(path)
        if layout is not None:
            return layout
    if recognise_bag(path):
        return "bag"
    known = None if path.is_dir() else recognise_cloud(path) or recognise_trajectory(path)
    if known is None:
        raise InputError(path, f"cannot be recognised: {_looks_like(path)}", f"{_ACCEPTED}; --{side}-format names one")
    return known


def _looks_like(path: Path) -> str:
    if path.is_dir():
        names = sorted(entry.name + "/" * entry.is_dir() for entry in path.iterdir())
        shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
        return f"a folder with {shown}" if names else "an empty folder"
    head = read_bytes(path, HEAD_BYTES)
    known = signature(head)
    if not head or known:
        return f"it looks like {known}" if known else "an empty file"
    if b"\0" in head:
        return "it looks like binary data of no known kind"
    shape = column_count(head)
    if shape is not None:
        return f"a table with {shape[0]} numbers a row"
    lines = head.decode("utf-8", errors="replace").split("\n")
    first = next((line.strip() for line in lines if line.strip()), "")
    return f"a text that starts with {first[:60]!r}{_fault_of_table(path)}"


def _fault_of_table(path: Path) -> str:
    """What keeps a text from being a table, with its line; nothing if it is one."""
    try:
        read_table(path)
    except InputError as error:
        line = error.where.removeprefix(str(path)).removeprefix(", ")
        return f"; {line}: {error.found}" if line else f"; it {error.found}"
    return ""


def _open_trajectory(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    trajectory = read_trajectory(
        path,
        format=cast(KnownFormat, format),
        pose_frame=options.pose_frame,
    )
    return Source(str(path), f"{_TRAJECTORY_NAMES[format]} trajectory", trajectory, notes=trajectory.notes)


def _open_cloud(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    cloud = read_cloud(path, format=cast(KnownCloud, format))
    return Source(str(path), f"{format.upper()} map", cloud=cloud, notes=cloud.notes)


def _open_original(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    cloud, trajectory = read_original_side(path, side, pose_frame=options.pose_frame)
    return Source(
        str(path),
        "directory of the original program",
        trajectory if part != "map" else None,
        cloud if part != "trajectory" else None,
        notes=(*cloud.notes, *trajectory.notes),
    )


def _open_sample(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    sample = read_sample(
        path,
        options.run,
        pose_frame=options.pose_frame,
        with_map=part != "trajectory",
        with_poses=part != "map",
    )
    return Source(
        str(path),
        f"MAOMaps sample directory, run {options.run}",
        sample.trajectory,
        sample.cloud,
        start_pose=sample.start_pose,
        notes=(*sample.notes, *_notes_of(sample.cloud), *_notes_of(sample.trajectory)),
    )


def _open_rgbd(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    folder = read_rgbd_folder(
        path,
        layout=format,
        camera=options.camera,
        with_poses=part != "map",
    )
    return Source(
        str(path),
        folder.kind,
        folder.trajectory,
        frames=folder.frames if part != "trajectory" else None,
        camera=folder.frames.camera,
        notes=(*folder.notes, *_notes_of(folder.trajectory)),
    )


def _open_bag(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    contents = describe_bag(path)
    contents.check_names(options.topics)
    if part != "trajectory":
        contents.check_named_images(options.topics)
    role, notes = (None, ()) if part == "trajectory" else _map_role(contents, options.topics, side)
    cloud = read_bag_cloud(path, topics=options.topics) if role == "clouds" else None
    camera = options.camera
    frames = read_bag_frames(path, topics=options.topics, camera=camera) if role == "depths" else None
    if frames is not None:
        camera = frames.camera
    elif cloud is not None and camera is None:
        camera, more = _camera_beside_cloud(path, options.topics)
        notes += more
    trajectory = None
    if part != "map" and contents.poses:
        trajectory = read_bag_trajectory(path, topics=options.topics, pose_frame=options.pose_frame)
    if role is None and trajectory is None:
        listed = "; ".join(map(str, contents.all)) or "none"
        wanted = {"all": "neither a map nor poses", "map": "no map", "trajectory": "no poses"}[part]
        raise InputError(path, f"the bag holds {wanted}", f"topics in this bag: {listed}")
    kind = "ROS 2 bag folder" if path.is_dir() else _bag_file_kind(path)
    all_notes = (*notes, *_notes_of(cloud), *_notes_of(trajectory))
    return Source(str(path), kind, trajectory, cloud, frames, camera, notes=all_notes)


def _map_role(
    contents: BagContents, topics: tuple[str, ...], side: Side
) -> tuple[Literal["clouds", "depths"] | None, tuple[str, ...]]:
    """What of a bag is its map, and a note where there was a choice."""
    clouds, depths = contents.named("clouds", topics), contents.named("depths", topics)
    if not clouds and not depths:
        clouds, depths = contents.clouds, contents.depths
    if not clouds or not depths:
        return ("clouds" if clouds else "depths" if depths else None), ()
    # What a method puts out as its map is the estimate; the ground truth's clouds are often single scans.
    if side == "est":
        return "clouds", (f"of clouds and depth images in the bag, the clouds are the map; --{side}-topic decides",)
    return "depths", (f"of clouds and depth images in the bag, the depth makes the map; --{side}-topic decides",)


def _camera_beside_cloud(path: Path, topics: tuple[str, ...]) -> tuple[Camera | None, tuple[str, ...]]:
    """The camera of a bag whose map does not need it, or None and the reason why it cannot be used."""
    try:
        return read_bag_camera(path, topics=topics), ()
    except InputError as error:
        return None, (f"camera_info of the bag not used: {error.found}",)


def _bag_file_kind(path: Path) -> str:
    words = signature(read_bytes(path, HEAD_BYTES)) or "a bag"
    return words.partition(" ")[2]


def _notes_of(part: Trajectory | PointCloud | None) -> tuple[str, ...]:
    return part.notes if part is not None else ()


_OPENERS: dict[str, Callable[[Path, str, SourceOptions, Side, Part], Source]] = {
    **dict.fromkeys(TRAJECTORY_FORMATS, _open_trajectory),
    **dict.fromkeys(CLOUD_FORMATS, _open_cloud),
    **dict.fromkeys(LAYOUTS, _open_rgbd),
    "bag": _open_bag,
    "sample": _open_sample,
    "original": _open_original,
}
