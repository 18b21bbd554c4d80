"""Folders of depth images with poses: TUM RGB-D, 3DMatch / 7-Scenes, Open3D / Redwood.

Each layout is recognised by what lies in the folder, and gives frames that are read when asked for and the
trajectory of the camera. Poses and images of all of them are in the optical frame.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from maomaps_warp.errors import InputError
from maomaps_warp.io.image_streams import ImageFiles, color_notes, stream_images
from maomaps_warp.io.images import read_depth_image
from maomaps_warp.io.rgbd_files import (
    CAMERA_HINT,
    read_camera_matrix,
    read_json_camera,
    read_pose_lines,
    read_pose_log,
    read_pose_matrix,
)
from maomaps_warp.io.source import Part, Side, Source, camera_or_note, notes_of, option
from maomaps_warp.io.trajectories import read_trajectory
from maomaps_warp.io.tum_images import find_tum_images
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.trajectory import Trajectory

#: The default of the TUM RGB-D benchmark for 640x480 images, and its depth unit (its page "File Formats").
TUM_CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
TUM_METRES_PER_UNIT = 1.0 / 5000.0
#: The other layouts store millimetres.
METRES_PER_MILLIMETRE = 0.001

_COLOR_FOLDERS = ("color", "rgb", "image")
_POSE_READERS = {"trajectory.log": read_pose_log, "odometry.log": read_pose_log, "pose.txt": read_pose_lines}


def recognise_rgbd_folder(path: Path, side: Side = "one") -> str | None:
    """The layout of a folder by its content: a key of LAYOUTS, or None.

    Args:
        path: the folder.
        side: whose it is.

    Raises:
        InputError: it fits several.
    """
    found = [layout for layout, (fits, _) in LAYOUTS.items() if fits(path)]
    if len(found) > 1:
        hint = f"choose with {option(side, 'format')}"
        raise InputError(path, f"fits several layouts: {', '.join(found)}", hint)
    return found[0] if found else None


def read_rgbd_folder(path: Path, *, layout: str, camera: Camera | None = None, part: Part = "all") -> Source:
    """Open an RGB-D folder.

    Args:
        path: the folder.
        layout: a key of LAYOUTS.
        camera: intrinsics to use instead of the folder's.
        part: what is wanted of it. Without the folder's poses every depth image is a frame, also one whose pose
            is lost: another file will bring the poses. Without its images its camera may be unknown.

    Raises:
        InputError: files are missing, counts differ, a matrix is no pose, or the camera is unknown.
    """
    fits, read = LAYOUTS[layout]
    if not fits(path):
        raise InputError(path, f"is no {layout} folder", "leave the format to auto, to be told what it is")
    return read(path, camera, part)


# TUM RGB-D


def _is_tum(folder: Path) -> bool:
    lists = ("groundtruth.txt", "depth.txt", "associations.txt")
    return (folder / "depth").is_dir() and any((folder / name).is_file() for name in lists)


def _read_tum(folder: Path, camera: Camera | None, part: Part) -> Source:
    frames = trajectory = None
    notes = []
    if camera is None:
        camera = TUM_CAMERA
        notes.append(f"camera assumed: TUM's default {TUM_CAMERA}, lens distortion not undone; --camera overrides it")
    if part != "trajectory":
        images, unused = find_tum_images(folder)
        frames = stream_images(folder, images, camera, TUM_METRES_PER_UNIT)
        notes += [*unused, *color_notes(images)]
    if part != "map":
        trajectory = read_trajectory(folder / "groundtruth.txt", format="tum")
    notes += notes_of(trajectory)
    return Source(str(folder), "TUM RGB-D folder", trajectory, frames=frames, camera=camera, notes=tuple(notes))


# 3DMatch / 7-Scenes


def _is_3dmatch(folder: Path) -> bool:
    return bool(_sequences(folder))


def _sequences(folder: Path) -> list[Path]:
    """The folder itself if frames lie in it, else its seq-* with frames."""
    candidates = [folder, *sorted(folder.glob("seq-*"))]
    return [path for path in candidates if next(path.glob("frame-*.depth.png"), None)]


def _read_3dmatch(folder: Path, camera: Camera | None, part: Part) -> Source:
    sequences = _sequences(folder)
    if len(sequences) > 1:
        names = ", ".join(path.name for path in sequences)
        raise InputError(folder, f"holds several sequences: {names}", f"give one of them, as {sequences[0]}")
    sequence = sequences[0]
    stems = [path.name.removesuffix(".depth.png") for path in sorted(sequence.glob("frame-*.depth.png"))]
    first = sequence / f"{stems[0]}.depth.png"
    camera, notes = _camera(camera, lambda: _camera_beside(sequence, first), part)
    frames = trajectory = None
    if part != "map":
        found = {stem: read_pose_matrix(sequence / f"{stem}.pose.txt") for stem in stems}
        T = {stem: pose for stem, pose in found.items() if pose is not None}
        lost = [stem for stem in stems if stem not in T]
        if not T:
            raise InputError(sequence, f"the poses of all {len(lost)} frames are lost (NaN)")
        if lost:
            shown = ", ".join(lost[:5]) + (", ..." if len(lost) > 5 else "")
            notes += (f"{len(lost)} of {len(stems)} frames skipped because their pose is lost (NaN): {shown}",)
        trajectory = Trajectory(np.stack(list(T.values())), source=str(sequence))
        stems = list(T)
    if part != "trajectory" and camera is not None:
        images = [
            ImageFiles(sequence / f"{stem}.depth.png", _existing(sequence / f"{stem}.color.png")) for stem in stems
        ]
        frames = stream_images(sequence, images, camera, METRES_PER_MILLIMETRE)
        notes += color_notes(images)
    return Source(str(folder), "3DMatch / 7-Scenes folder", trajectory, frames=frames, camera=camera, notes=notes)


def _camera_beside(sequence: Path, first_image: Path) -> Camera:
    """The camera of camera-intrinsics.txt in the sequence or above it, with the size of the first image."""
    for folder in (sequence, sequence.parent):
        if (folder / "camera-intrinsics.txt").is_file():
            height, width = read_depth_image(first_image, scale=METRES_PER_MILLIMETRE).shape
            return read_camera_matrix(folder / "camera-intrinsics.txt", width, height)
    raise InputError(sequence, "no camera-intrinsics.txt here or in the folder above", CAMERA_HINT)


def _camera(given: Camera | None, read: Callable[[], Camera], part: Part) -> tuple[Camera | None, tuple[str, ...]]:
    """The given camera, else the folder's; None, with a note, if that is unknown and no image is wanted."""
    if given is not None or part != "trajectory":
        return given or read(), ()
    return camera_or_note(read)


def _existing(path: Path) -> Path | None:
    return path if path.is_file() else None


# Open3D / Redwood


def _is_open3d(folder: Path) -> bool:
    return (folder / "depth").is_dir() and any((folder / name).is_file() for name in _POSE_READERS)


def _read_open3d(folder: Path, camera: Camera | None, part: Part) -> Source:
    depths = [path for path in (folder / "depth").iterdir() if path.suffix in (".png", ".pgm")]
    camera, notes = _camera(camera, lambda: read_json_camera(folder), part)
    frames = trajectory = None
    if part != "trajectory" and camera is not None:
        color_folder = next((folder / name for name in _COLOR_FOLDERS if (folder / name).is_dir()), folder / "color")
        colors = {path.stem: path for path in color_folder.glob("*.*")}
        images = [ImageFiles(depth, colors.get(depth.stem)) for depth in sorted(depths, key=_numbers_in_name)]
        frames = stream_images(folder, images, camera, METRES_PER_MILLIMETRE)
        notes += color_notes(images)
    if part != "map":
        path = next(folder / name for name in _POSE_READERS if (folder / name).is_file())
        T = _POSE_READERS[path.name](path)
        if frames is not None and len(T) != len(depths):
            raise InputError(path, f"{len(T)} poses, but {len(depths)} images in depth/", "image i needs pose i")
        trajectory = Trajectory(T, source=str(path))
        notes += (f"poses of {path.name}, paired with the depth images in the order of their names",)
    return Source(str(folder), "Open3D / Redwood folder", trajectory, frames=frames, camera=camera, notes=notes)


def _numbers_in_name(path: Path) -> list[tuple[int, str]]:
    """Sorts 2.png before 10.png."""
    return [(int(text), "") if text.isdigit() else (-1, text) for text in re.findall(r"\d+|\D+", path.stem)]


_Reader = Callable[[Path, Camera | None, Part], Source]

#: How each layout is recognised, and its reader.
LAYOUTS: dict[str, tuple[Callable[[Path], bool], _Reader]] = {
    "tum-rgbd": (_is_tum, _read_tum),
    "3dmatch": (_is_3dmatch, _read_3dmatch),
    "open3d": (_is_open3d, _read_open3d),
}
