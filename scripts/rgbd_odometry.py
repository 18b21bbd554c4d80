"""Run Open3D's RGB-D odometry over recorded bags, and score its trajectories and maps: the paper's Table III.

    pip install '.[odometry]'
    python scripts/rgbd_odometry.py run.bag -o results                   # one recording
    python scripts/rgbd_odometry.py mini_maomaps/*/*.bag -o results      # a dataset: also the table of its means

Each bag is run twice: with its depth, and with depth as a network would guess it (`--depth exact cnn kinect`; the
effects of `maomaps-warp record`). Frames are tracked against a keyframe by Open3D's multi-scale odometry, point to
plane (or `--method hybrid`, which uses the colours, too), and fused into a TSDF volume, whose surface is the estimated
map. Nothing of it is ours: this is an example of a method under test, and not of a good one, since it closes no loops.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import maomaps_warp as mw
from maomaps_warp.io.clouds import write_pcd
from maomaps_warp.io.trajectories import write_tum
from maomaps_warp.sim.effects import Effects

#: A new keyframe after so many metres or radians, or when less of the image than this share was tracked.
_KEYFRAME_M, _KEYFRAME_RAD, _KEYFRAME_FITNESS = 0.15, 0.12, 0.6
#: Greatest motion from one frame to the next that is believed, metres and radians.
_LEAP_M, _LEAP_RAD = 0.3, 0.35
#: Depth that is used, metres; edge of a voxel of the map and truncation of its distances in voxels.
_FARTHEST_M, _MAP_VOXEL_M, _TRUNCATION_VOXELS = 6.0, 0.025, 4.0
#: Room for blocks of 16^3 voxels at the beginning; and how often a voxel must be seen.
_BLOCKS, _SEEN = 20_000, 3.0
#: Of a row of the table: RMSE of the trajectory, means of the map's distances (and a median), metres.
_FIGURES = ("ate", "nearest", "rays", "rays_median", "rays_relative")


@dataclass(frozen=True, eq=False)
class Estimate:
    """What the odometry made of a recording."""

    trajectory: mw.Trajectory
    points: np.ndarray
    lost: int


def run_odometry(source: mw.Source, effects: Effects, method: str) -> Estimate:
    """Track the frames of a recording; the first pose is the true one, so that the worlds are one."""
    import open3d as o3d

    assert source.frames is not None and source.trajectory is not None
    camera = source.frames.camera
    K = o3d.core.Tensor(np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]))
    volume = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (o3d.core.float32, o3d.core.float32), ((1), (1)), _MAP_VOXEL_M, 16, _BLOCKS
    )
    start = source.trajectory.T_world_camera[0]
    key_pose, key_frame, pose, motion = start, None, start, np.eye(4)
    stamps, poses, lost = [], [], 0
    first = None
    for frame in source.frames.read(True):
        assert frame.stamp_ns is not None and frame.colors is not None
        first = frame.stamp_ns if first is None else first
        depth = effects.depth(frame.depth, frame.index, (frame.stamp_ns - first) * 1e-9)
        image = o3d.t.geometry.Image(depth)
        now = o3d.t.geometry.RGBDImage(o3d.t.geometry.Image(np.ascontiguousarray(frame.colors)), image)
        if key_frame is not None:
            guess = np.linalg.inv(key_pose) @ pose @ motion
            found = _track(o3d, now, key_frame, K, guess, method)
            if found is None or _leaps(np.linalg.inv(pose) @ key_pose @ found[0]):
                # No pose and nothing for the map; from here on as if the camera had stood still.
                lost += 1
                key_pose, key_frame, motion = pose, now, np.eye(4)
                continue
            T_key_now, fitness = found
            motion, pose = np.linalg.inv(pose) @ key_pose @ T_key_now, key_pose @ T_key_now
            moved, turned = _size(T_key_now)
            if moved > _KEYFRAME_M or turned > _KEYFRAME_RAD or fitness < _KEYFRAME_FITNESS:
                key_pose, key_frame = pose, now
        else:
            key_frame = now
        stamps.append(frame.stamp_ns)
        poses.append(pose)
        extrinsic = o3d.core.Tensor(np.linalg.inv(pose))
        limits = (1.0, _FARTHEST_M, _TRUNCATION_VOXELS)
        if ((depth > 0.0) & (depth < _FARTHEST_M)).any():
            blocks = volume.compute_unique_block_coordinates(image, K, extrinsic, *limits)
            volume.integrate(blocks, image, K, extrinsic, *limits)
    cloud = volume.extract_point_cloud(_SEEN).point.positions.numpy()
    return Estimate(mw.Trajectory(np.stack(poses), np.array(stamps, dtype=np.int64), "Open3D odometry"), cloud, lost)


def _size(T: np.ndarray) -> tuple[float, float]:
    """Metres and radians of a motion."""
    turn = np.arccos(np.clip((np.trace(T[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))
    return float(np.linalg.norm(T[:3, 3])), float(turn)


def _leaps(motion: np.ndarray) -> bool:
    """Whether no robot moves so from one frame to the next."""
    moved, turned = _size(motion)
    return moved > _LEAP_M or turned > _LEAP_RAD


def _track(o3d: Any, now: Any, key: Any, K: Any, guess: np.ndarray, method: str) -> tuple[np.ndarray, float] | None:
    """Pose of the frame in the keyframe's and the share of it that was tracked; None where tracking failed."""
    odometry = o3d.t.pipelines.odometry
    try:
        found = odometry.rgbd_odometry_multi_scale(
            now,
            key,
            K,
            o3d.core.Tensor(guess),
            1.0,
            _FARTHEST_M,
            [odometry.OdometryConvergenceCriteria(n) for n in (10, 8, 6)],
            odometry.Method.Hybrid if method == "hybrid" else odometry.Method.PointToPlane,
        )
    except RuntimeError:  # a singular system: nothing to hold on to
        return None
    T = found.transformation.numpy()
    return (T, float(found.fitness)) if np.isfinite(T).all() and found.fitness > 0.1 else None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", type=Path, nargs="+", help="bags of `maomaps-warp record` or of a MAOMaps sample")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for trajectories, maps and scores")
    parser.add_argument("--depth", nargs="+", default=["exact", "cnn"], choices=["exact", "cnn", "kinect"])
    parser.add_argument("--method", default="point-to-plane", choices=["point-to-plane", "hybrid"])
    parser.add_argument("--pose-frame", default="maomaps-c", help="what the recorded poses mean")
    parser.add_argument("--seed", type=int, default=0, help="of the errors of depth")
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for bag in asked.bags:
        for depth in asked.depth:
            try:
                rows.append(_one(bag, depth, asked))
            except mw.InputError as error:
                rows.append({"bag": f"{bag.parent.name}/{bag.name}", "depth": depth, "why_not": str(error)})
            print(_line(rows[-1]), flush=True)
            (asked.output / "table.json").write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    print()
    for depth in asked.depth:
        asked_for = [row for row in rows if row["depth"] == depth]
        scored = [row for row in asked_for if "why_not" not in row]
        for name, middle in (("mean", np.mean), ("median", np.median)):
            if scored:
                figures = {key: float(middle([row[key] for row in scored])) for key in _FIGURES}
                title = f"{name} of {len(scored)} of {len(asked_for)}"
                print(_line({"bag": title, "depth": depth, "lost": sum(row["lost"] for row in scored), **figures}))
    return 0


def _one(bag: Path, depth: str, asked: argparse.Namespace) -> dict[str, Any]:
    """Run the odometry, unless its result is there, and score it."""
    name = f"{bag.parent.name}/{bag.name}"
    # The errors of a recording depend on its name, not on what else is run.
    effects = Effects.of([] if depth == "exact" else [depth], zlib.crc32(f"{asked.seed} {name}".encode()))
    gt = mw.open_source(bag, mw.SourceOptions(pose_frame=asked.pose_frame), side="gt")
    folder = asked.output / f"{bag.parent.name}_{bag.stem}_{depth}"
    files, facts = (folder / "est_map.pcd", folder / "est_trajectory.txt"), folder / "odometry.json"
    recipe = {"bag": str(bag.resolve()), "bytes": bag.stat().st_size, "seed": asked.seed, "method": asked.method}
    recipe["pose_frame"] = asked.pose_frame
    known = json.loads(facts.read_text(encoding="utf-8")) if facts.exists() else {}
    if known.get("recipe") != recipe:
        folder.mkdir(parents=True, exist_ok=True)
        estimate = run_odometry(gt, effects, asked.method)
        write_pcd(files[0], estimate.points, None)
        write_tum(files[1], estimate.trajectory)
        known = {"recipe": recipe, "lost": estimate.lost}
        facts.write_text(json.dumps(known) + "\n", encoding="utf-8")
    est = mw.source_from_parts(*files, side="est")
    score = mw.score(gt, est, replace(mw.load_protocol("maomaps"), align="none"), device="cpu").score
    row: dict[str, Any] = {"bag": name, "depth": depth, "lost": known["lost"]}
    for metric in (score.ate, score.ame_nn, score.ame_ray):
        if isinstance(metric, mw.NoValue):
            return row | {"why_not": metric.reason}
    return row | {
        "ate": score.ate.errors["absolute"].translation.rmse,
        "nearest": score.ame_nn.accuracy.mean,
        "rays": score.ame_ray.absolute.mean,
        "rays_median": score.ame_ray.absolute.median,
        "rays_relative": score.ame_ray.relative.mean,
        "classes": score.ame_ray.counts,
    }


def _line(row: dict[str, Any]) -> str:
    if "why_not" in row:
        return f"{row['bag']:<24} {row['depth']:<7} no score: {row['why_not']}"
    ate, nearest, rays, median, relative = (f"{row[key]:.3f}" for key in _FIGURES)
    figures = f"ATE {ate}  AME {nearest}  by rays {rays} (median {median}; relative {relative})"
    return f"{row['bag']:<24} {row['depth']:<7} {figures}  lost {row['lost']}"


if __name__ == "__main__":
    sys.exit(main())
