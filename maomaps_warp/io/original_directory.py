"""The input directory of the original association program: map and poses of both sides, paired by index."""

from __future__ import annotations

from pathlib import Path

from maomaps_warp.errors import InputError
from maomaps_warp.io.clouds import read_cloud
from maomaps_warp.io.source import Part, Side, Source, notes_of
from maomaps_warp.io.trajectory_formats import read_maomaps_poses
from maomaps_warp.model.pose_convention import parse_convention
from maomaps_warp.model.trajectory import Trajectory

_PREFIXES = {"gt": "gt", "est": "slam"}
_NAMES = tuple(f"{prefix}_{what}.txt" for prefix in _PREFIXES.values() for what in ("points", "poses"))


def is_original_directory(path: Path) -> bool:
    """Whether a folder holds an estimate under the original program's names."""
    return any((path / name).is_file() for name in ("slam_points.txt", "slam_poses.txt"))


def read_original_side(path: Path, side: Side, *, pose_frame: str = "auto", part: Part = "all") -> Source:
    """Map and poses of one side.

    Args:
        path: a directory with gt_points.txt, gt_poses.txt, slam_points.txt and slam_poses.txt. Points are
            `x y z` lines or a PCD file under the same name, poses `x y z roll pitch yaw` lines.
        side: which of them.
        pose_frame: what the poses mean, see `parse_convention`; "auto" is the body frame (x forward, y left, z up).
        part: what is wanted of it.

    Returns:
        The map as a cloud, and the poses without stamps: pose i of one side belongs to pose i of the other.

    Raises:
        InputError: a file is missing or damaged, or the two sides have different numbers of poses.
    """
    missing = [name for name in _NAMES if not (path / name).is_file()]
    if missing:
        raise InputError(path, f"missing: {', '.join(missing)}", f"the directory needs {', '.join(_NAMES)}")
    trajectory = cloud = None
    if part != "trajectory":
        cloud = read_cloud(path / f"{_PREFIXES[side]}_points.txt")
    if part != "map":
        files = {key: path / f"{prefix}_poses.txt" for key, prefix in _PREFIXES.items()}
        # Stamps that lie beside the poses do not matter here.
        poses = {key: read_maomaps_poses(file)[0] for key, file in files.items()}
        if len(poses["gt"]) != len(poses["est"]):
            found = f"gt_poses.txt has {len(poses['gt'])} poses, slam_poses.txt has {len(poses['est'])}"
            raise InputError(path, found, "poses are paired by index; files with stamps can be given as --gt and --est")
        frame = "body" if pose_frame == "auto" else pose_frame
        T = parse_convention(frame).camera_poses(poses[side])
        note = "poses are paired by index"
        trajectory = Trajectory(T, source=str(files[side]), pose_frame=frame, notes=(note,))
    notes = notes_of(cloud, trajectory)
    return Source(str(path), "directory of the original program", trajectory, cloud, notes=notes)
