"""Every kind of file, folder and bag that can be a side of a comparison: how it is recognised and opened."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast, get_args

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import recognise_bag
from maomaps_warp.io.clouds import CloudFormat, read_cloud, recognise_cloud
from maomaps_warp.io.original_directory import is_original_directory, read_original_side
from maomaps_warp.io.rgbd_folders import LAYOUTS, read_rgbd_folder, recognise_rgbd_folder
from maomaps_warp.io.sample_directories import is_sample_directory, read_sample
from maomaps_warp.io.source import Part, Side, Source, SourceOptions, option
from maomaps_warp.io.tables import HEAD_BYTES, column_count, read_bytes, read_table, signature
from maomaps_warp.io.trajectories import (
    TRAJECTORY_NAMES,
    TrajectoryFormat,
    read_trajectory,
    recognise_trajectory,
)
from maomaps_warp.model.pose_convention import parse_convention

TRAJECTORY_FORMATS: tuple[str, ...] = get_args(TrajectoryFormat)
CLOUD_FORMATS: tuple[str, ...] = get_args(CloudFormat)
_FOLDER_FORMATS = ("sample", "original", *LAYOUTS)
#: Every name that `--gt-format` and `--est-format` take.
FORMATS = ("auto", *TRAJECTORY_FORMATS, *CLOUD_FORMATS, "bag", *_FOLDER_FORMATS)

_ACCEPTED = (
    "accepted: bags (ROS 1, ROS 2, MCAP); trajectories (TUM, KITTI, EuRoC, MAOMaps); "
    "maps (PCD, PLY, XYZ text, NPZ); RGB-D folders (TUM, 3DMatch / 7-Scenes, Open3D / Redwood); "
    "MAOMaps sample directories; directories of gt_points.txt, gt_poses.txt, slam_points.txt, slam_poses.txt"
)


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
        raise InputError(f"{option(side, 'format')} {options.format}", "is no format", f"allowed: {', '.join(FORMATS)}")
    if options.pose_frame != "auto":
        try:
            parse_convention(options.pose_frame)
        except ValueError as error:
            raise InputError(f"{option(side, 'pose-frame')} {options.pose_frame}", str(error)) from None
    if not path.exists():
        raise InputError(path, "no such file or folder")
    other = {"all": (), "map": TRAJECTORY_FORMATS, "trajectory": CLOUD_FORMATS}[part]
    format = "auto" if options.format in other else options.format
    if format == "auto":
        format = _recognise(path, side, part)
        _check_name(path, format, side)
    elif format in _FOLDER_FORMATS and not path.is_dir():
        raise InputError(path, "is a file", f"{option(side, 'format')} {format} is a folder")
    return _OPENERS[format](path, format, options, side, part)


def _check_name(path: Path, format: str, side: Side) -> None:
    """Refuse a file whose name says plainly that it is something else; `.txt`, `.csv` and the like say nothing."""
    suffix = path.suffix.lower()
    meant = _MEANT_BY_SUFFIX.get(suffix)
    if path.is_file() and meant is not None and format != meant:
        found = f"is named {suffix} but holds {format}"
        raise InputError(path, found, f"rename it, or say {option(side, 'format')} {format}")


def _recognise(path: Path, side: Side, part: Part) -> str:
    """The format of a path by its content: one of FORMATS, never "auto"."""
    if path.is_dir():
        if is_original_directory(path):
            return "original"
        # Before bags: a sample directory holds recordings too.
        if is_sample_directory(path):
            return "sample"
        layout = recognise_rgbd_folder(path, side)
        if layout is not None:
            return layout
    if recognise_bag(path):
        return "bag"
    known = None if path.is_dir() else recognise_cloud(path) or recognise_trajectory(path)
    if known == "maomaps" and (part == "map" or path.suffix.lower() == ".xyz"):
        known = "xyz"  # six columns are points with normals where poses cannot be meant
    if known is None:
        raise InputError(
            path, f"cannot be recognised: {_looks_like(path)}", f"{_ACCEPTED}; {option(side, 'format')} names one"
        )
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
    trajectory = read_trajectory(path, format=cast(TrajectoryFormat, format), pose_frame=options.pose_frame)
    return Source(str(path), f"{TRAJECTORY_NAMES[format]} trajectory", trajectory, notes=trajectory.notes)


def _open_cloud(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    cloud = read_cloud(path, format=cast(CloudFormat, format))
    return Source(str(path), f"{format.upper()} map", cloud=cloud, notes=cloud.notes)


def _open_original(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    return read_original_side(path, side, pose_frame=options.pose_frame, part=part)


def _open_sample(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    return read_sample(path, options.run, pose_frame=options.pose_frame, part=part)


def _open_rgbd(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    source = read_rgbd_folder(path, layout=format, camera=options.camera, part=part)
    if source.trajectory is None or options.pose_frame == "auto":
        return source
    T = parse_convention(options.pose_frame).camera_poses(source.trajectory.T_world_camera)
    declared = replace(source.trajectory, T_world_camera=T, pose_frame=options.pose_frame, is_assumed=False)
    return replace(source, trajectory=declared)


def _open_bag(path: Path, format: str, options: SourceOptions, side: Side, part: Part) -> Source:
    from maomaps_warp.io.bags import read_bag

    return read_bag(path, options, side, part)


#: Suffixes that stand for one format.
_MEANT_BY_SUFFIX = {
    ".pcd": "pcd",
    ".ply": "ply",
    ".npz": "npz",
    ".npy": "npz",
    ".xyz": "xyz",
    ".bag": "bag",
    ".mcap": "bag",
    ".db3": "bag",
}

_OPENERS: dict[str, Callable[[Path, str, SourceOptions, Side, Part], Source]] = {
    **dict.fromkeys(TRAJECTORY_FORMATS, _open_trajectory),
    **dict.fromkeys(CLOUD_FORMATS, _open_cloud),
    **dict.fromkeys(LAYOUTS, _open_rgbd),
    "bag": _open_bag,
    "sample": _open_sample,
    "original": _open_original,
}
