"""A "SLAM result" whose errors are known, out of a recording with ground truth."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.clouds import write_pcd
from maomaps_warp.io.file_sets import check_file_set, write_file_set
from maomaps_warp.io.outputs import write_whole
from maomaps_warp.io.sources import Source
from maomaps_warp.io.trajectories import write_tum
from maomaps_warp.jobs.ground_truth import frames_of, with_known_convention
from maomaps_warp.map_building import build_side
from maomaps_warp.model.alignment import Alignment
from maomaps_warp.model.frame import FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap
from maomaps_warp.protocol import PRESETS
from maomaps_warp.sim.slam import SlamDisturbance, closed_loops, disturbed_frames, disturbed_trajectory, kept_poses
from maomaps_warp.stopwatch import Stopwatch

__all__ = ["DISTURBANCES", "FILES", "Disturbed", "SlamDisturbance", "disturb", "write_disturbed"]

#: What is written: the estimate's map and trajectory, and what was done to them.
FILES = ("est_map.pcd", "est_trajectory.txt", "disturbance.json")

_EXACT = SlamDisturbance(
    scale_error=0.0,
    yaw_drift=0.0,
    position_drift=0.0,
    position_jitter=0.0,
    rotation_jitter=0.0,
    depth_noise=0.0,
    disparity_step=0.0,
    edge_threshold=0.0,
    border=0,
)
#: By name: nothing at all, to build upon; a structured-light camera and odometry; depth as a network guesses it.
DISTURBANCES: dict[str, SlamDisturbance] = {
    "none": _EXACT,
    "rgbd": SlamDisturbance(),
    "cnn": replace(
        _EXACT, scale_error=0.05, yaw_drift=0.02, position_drift=0.04, depth_noise=0.02, depth_scale_error=0.08
    ),
}


@dataclass(frozen=True, eq=False)
class Disturbed:
    """An estimate that was made.

    Attributes:
        trajectory: its poses.
        voxels: its map.
        facts: what was done and what came of it, for JSON.
        notes: of the recording.
    """

    trajectory: Trajectory
    voxels: VoxelMap
    facts: dict[str, Any]
    notes: tuple[str, ...]


def disturb(
    source: Source, disturbance: SlamDisturbance, *, device: str = "cpu", clock: Stopwatch | None = None
) -> Disturbed:
    """What a SLAM method with these errors would have made of a recording.

    Args:
        source: depth images and their true poses, with stamps.
        disturbance: of poses and depth.
        device: Warp device.
        clock: collects the stages' times.

    Raises:
        InputError: no depth images, no poses, no stamps, or it is not clear what the poses mean.
    """
    clock = clock or Stopwatch()
    stream = frames_of(source)
    trajectory, notes = with_known_convention(source, stream, clock)
    with clock.stage("pair frames"):
        index, gt = _posed_frames(source, stream, trajectory)
    est, kept = disturbed_trajectory(gt, disturbance), kept_poses(gt, disturbance)
    frames = disturbed_frames(stream, disturbance, index[kept])
    seen = Source("simulated SLAM", "simulation", est, frames=frames)
    rules = PRESETS["maomaps"]
    grid = VoxelGrid.around(est.positions, rules.voxel_size)
    built = build_side("estimated map", seen, Alignment(), grid, rules, device, clock, with_colors=True)
    if not len(built.voxels):
        raise InputError(source.name, "nothing is left of its depth images", "disturb less: see the ranges of depth")
    return Disturbed(est, built.voxels, _facts(gt, est, kept, disturbance), (*source.notes, *notes))


def write_disturbed(folder: Path, disturbed: Disturbed, *, overwrite: bool = False) -> tuple[Path, ...]:
    """Write FILES into a folder: all of them, or none.

    Raises:
        InputError: one of them stands there, or cannot be written.
    """
    with write_file_set(folder, FILES, overwrite=overwrite) as staging:
        write_pcd(staging / FILES[0], disturbed.voxels.points, disturbed.voxels.colors)
        write_tum(staging / FILES[1], disturbed.trajectory)
        with write_whole(staging / FILES[2]) as file:
            file.write(json.dumps(disturbed.facts, indent=2, allow_nan=False) + "\n")
    return tuple(folder / name for name in FILES)


def check_disturbed_writable(folder: Path, *, overwrite: bool = False) -> None:
    """Find out before the work whether `write_disturbed` could write.

    Raises:
        InputError: as `write_disturbed`.
    """
    check_file_set(folder, FILES, overwrite=overwrite)


def _posed_frames(source: Source, stream: FrameStream, trajectory: Trajectory) -> tuple[NDArray[np.int64], Trajectory]:
    """Indices of the frames that have a pose, and those poses with the frames' stamps."""
    from maomaps_warp.scoring.frame_poses import pose_of_frame

    rules = PRESETS["maomaps"]
    pose_of = pose_of_frame(trajectory, stream, method=rules.match, max_gap_s=rules.stamp_gap)
    index, stamps, poses = [], [], []
    for frame in stream.read(False):
        pose = pose_of(frame)
        if pose is None:
            continue
        if frame.stamp_ns is None:
            raise InputError(source.name, "its depth images have no stamps", "an estimate is a trajectory in time")
        index.append(frame.index)
        stamps.append(frame.stamp_ns)
        poses.append(pose)
    if len(index) < 2:
        raise InputError(source.name, f"{len(index)} of its depth images have a pose", "at least two are needed")
    return np.array(index), Trajectory(np.stack(poses), np.array(stamps, dtype=np.int64))


def _facts(gt: Trajectory, est: Trajectory, kept: NDArray[np.int64], disturbance: SlamDisturbance) -> dict[str, Any]:
    error = np.linalg.norm(est.positions - gt.positions[kept], axis=1)
    turned = np.einsum("nji,njk->nik", gt.T_world_camera[kept, :3, :3], est.T_world_camera[:, :3, :3])
    angle = np.degrees(np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0)))
    assert gt.stamps_ns is not None
    return {
        "schema": 1,
        "disturbance": asdict(disturbance),
        "frames": {"of_the_recording": len(gt), "kept": len(est)},
        "closures_at_ns": gt.stamps_ns[closed_loops(gt.positions, disturbance)].tolist(),
        "position_error_m": {"rmse": float(np.sqrt(np.square(error).mean())), "last": float(error[-1])},
        "rotation_error_deg": {"rmse": float(np.sqrt(np.square(angle).mean())), "last": float(angle[-1])},
    }
