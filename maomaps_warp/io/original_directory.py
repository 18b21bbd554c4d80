"""The input directory of the original association program: map and poses of both sides, paired by index."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from maomaps_warp.errors import InputError
from maomaps_warp.io.clouds import read_cloud
from maomaps_warp.io.trajectories import PoseFrame, read_trajectory
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.trajectory import Trajectory

_PREFIXES = {"gt": "gt", "est": "slam"}
_NAMES = tuple(f"{prefix}_{what}.txt" for prefix in _PREFIXES.values() for what in ("points", "poses"))


def is_original_directory(path: Path) -> bool:
    """Whether a folder holds an estimate under the original program's names."""
    return any((path / name).is_file() for name in ("slam_points.txt", "slam_poses.txt"))


def read_original_side(
    path: Path, side: Literal["gt", "est"], *, pose_frame: PoseFrame = "auto"
) -> tuple[PointCloud, Trajectory]:
    """Map and poses of one side.

    Args:
        path: a directory with gt_points.txt, gt_poses.txt, slam_points.txt and slam_poses.txt. Points are
            `x y z` lines or a PCD file under the same name, poses `x y z roll pitch yaw` lines.
        side: "gt" or "est".
        pose_frame: whose poses they are; "auto" is the body frame (x forward, y left, z up).

    Returns:
        The map, and the poses without stamps: pose i of one side belongs to pose i of the other.

    Raises:
        InputError: a file is missing or damaged, or the two sides have different numbers of poses.
    """
    missing = [name for name in _NAMES if not (path / name).is_file()]
    if missing:
        raise InputError(path, f"missing: {', '.join(missing)}", f"the directory needs {', '.join(_NAMES)}")
    trajectories = {
        key: read_trajectory(path / f"{prefix}_poses.txt", format="maomaps", pose_frame=pose_frame)
        for key, prefix in _PREFIXES.items()
    }
    gt, est = trajectories["gt"], trajectories["est"]
    if len(gt) != len(est):
        found = f"gt_poses.txt has {len(gt)} poses, slam_poses.txt has {len(est)}"
        raise InputError(path, found, "poses are paired by index; files with stamps can be given as --gt and --est")
    cloud = read_cloud(path / f"{_PREFIXES[side]}_points.txt")
    # Neither stamps that lie beside the poses nor their absence matter here.
    return cloud, replace(trajectories[side], stamps_ns=None, notes=("poses are paired by index",))
