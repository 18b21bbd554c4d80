"""The main job, step by step: pair in time, align, compare trajectories, build maps, compare maps.

Order, timing and progress live here; the mathematics lives in `scoring` and `mapping`, parsing in `io`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError, NoScoreError
from maomaps_warp.io.sources import Source
from maomaps_warp.model.alignment import Alignment
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.correspondences import Correspondences
from maomaps_warp.model.results import (
    InputSummary,
    NearestScore,
    NoValue,
    PoseErrors,
    RayScore,
    Score,
    TrajectoryScore,
)
from maomaps_warp.model.statistics import Statistics
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap
from maomaps_warp.protocol import PRESETS, Protocol
from maomaps_warp.scoring import alignment as aligning
from maomaps_warp.scoring import stamps, trajectory_errors
from maomaps_warp.stopwatch import Stopwatch


@dataclass(frozen=True, eq=False)
class PosePairs:
    """Poses of the estimate, aligned, and the ground truth at the same stamps.

    Attributes:
        T_world_camera_est, T_world_camera_gt: (P, 4, 4) float64, metres, the ground truth's world.
        stamps_ns: (P,) int64; None if they were paired by index.
        est_poses: poses of the estimate in all.
        unmatched: how many of them have no partner.
    """

    T_world_camera_est: NDArray[np.float64]
    T_world_camera_gt: NDArray[np.float64]
    stamps_ns: NDArray[np.int64] | None
    est_poses: int
    unmatched: int


@dataclass(frozen=True, eq=False)
class MapSide:
    """One of the two maps.

    Attributes:
        points: (N, 3) float64, metres, the ground truth's world: the points of a cloud as they are, or the voxel
            centres of a map built from frames. Nearest neighbours are taken between these.
        voxels: the occupied cells.
        facts: sizes, for the report.
    """

    points: NDArray[np.float64]
    voxels: VoxelMap
    facts: dict[str, int]


@dataclass(frozen=True, eq=False)
class ScoredRun:
    """A score, and the correspondences behind it (None if there was no association)."""

    score: Score
    correspondences: Correspondences | None
    poses: PosePairs | None


def score(
    gt: Source,
    est: Source,
    protocol: Protocol = PRESETS["maomaps"],
    *,
    camera: Camera | None = None,
    device: str = "auto",
    clock: Stopwatch | None = None,
) -> ScoredRun:
    """Score an estimate against the ground truth with every metric that the inputs allow.

    Args:
        gt, est: opened with `io.sources`; either may lack its map or its trajectory.
        protocol: constants and choices.
        camera: what an image shows; None: what the estimate or the ground truth states, else the protocol's.
        device: "auto", "cpu" or "cuda:N"; Warp is not even loaded without maps.
        clock: collects the stages' times and passes on progress.

    Raises:
        InputError: an input, or a combination of inputs and options, that cannot be used.
    """
    clock = clock or Stopwatch()
    with clock.stage("pair poses"):
        pairs, alignment = _pair_and_align(gt, est, protocol)
    ate: TrajectoryScore | NoValue
    rpe: TrajectoryScore | NoValue
    if isinstance(pairs, NoValue):
        ate = rpe = pairs
    else:
        with clock.stage("trajectory errors"):
            ate, rpe = _absolute_errors(pairs), _relative_errors(pairs, protocol)

    maps: tuple[MapSide, MapSide, str] | NoValue
    if alignment is None:
        maps = NoValue(f"no paired poses to find --align {protocol.align} from", asked=True)
    else:
        maps = _build_maps(gt, est, alignment, protocol, device, clock)
    nearest: NearestScore | NoValue
    ray: RayScore | NoValue
    correspondences = None
    if isinstance(maps, NoValue):
        nearest = ray = maps
        used_camera, device_used = "", "none"
    else:
        gt_map, est_map, device_used = maps
        with clock.stage("nearest neighbours"):
            nearest = _nearest_errors(gt_map, est_map, protocol, device_used)
        seen_by, used_camera = _camera_of(gt, est, camera, protocol)
        if isinstance(pairs, NoValue):
            ray, used_camera = pairs, ""
        else:
            correspondences = _associate(gt_map, est_map, pairs, seen_by, protocol, device_used, clock)
            ray = _ray_errors(correspondences, pairs)
    result = Score(
        protocol=protocol,
        camera=used_camera,
        alignment=alignment,
        ate=ate,
        rpe=rpe,
        ame_nn=nearest,
        ame_ray=ray,
        gt=_summary(gt, None if isinstance(maps, NoValue) else maps[0]),
        est=_summary(est, None if isinstance(maps, NoValue) else maps[1]),
        device=device_used,
        milliseconds=clock.milliseconds,
        notes=_notes(est),
    )
    return ScoredRun(result, correspondences, None if isinstance(pairs, NoValue) else pairs)


def _pair_and_align(gt: Source, est: Source, protocol: Protocol) -> tuple[PosePairs | NoValue, Alignment | None]:
    if gt.trajectory is None or est.trajectory is None:
        side = "ground truth" if gt.trajectory is None else "estimate"
        needs_none = protocol.align == "none" or (protocol.align == "start-pose" and gt.start_pose)
        if not needs_none:
            raise InputError(
                f"--align {protocol.align}",
                f"the {side} has no trajectory to find the transform from",
                "give one, or use --align none",
            )
        start = gt.start_pose if protocol.align == "start-pose" else None
        nothing = np.empty((0, 4, 4))
        alignment = aligning.align(
            protocol.align, nothing, nothing, start_pose=start, yaw_correction=protocol.yaw_correction
        )
        return NoValue(f"the {side} has no trajectory", asked=False), alignment
    try:
        matches = stamps.match_stamps(
            gt.trajectory,
            est.trajectory,
            method=protocol.match,
            max_gap_s=protocol.stamp_gap,
            t_offset_s=protocol.t_offset,
        )
    except NoScoreError as error:
        counts = {"poses": len(est.trajectory), "matched": 0, "unmatched": len(est.trajectory), "pairs": 0}
        return NoValue(str(error), asked=True, counts=counts), Alignment() if protocol.align == "none" else None
    T_est = est.trajectory.T_world_camera[matches.est_index]
    alignment = aligning.align(
        protocol.align,
        matches.T_world_camera_gt,
        T_est,
        start_pose=gt.start_pose if protocol.align == "start-pose" else None,
        yaw_correction=protocol.yaw_correction,
    )
    stamps_ns = None if est.trajectory.stamps_ns is None else est.trajectory.stamps_ns[matches.est_index]
    pairs = PosePairs(
        alignment.apply_poses(T_est),
        matches.T_world_camera_gt,
        None if matches.method == "index" else stamps_ns,
        len(est.trajectory),
        matches.unmatched,
    )
    return pairs, alignment


def _pose_counts(pairs: PosePairs) -> dict[str, int]:
    return {
        "poses": pairs.est_poses,
        "matched": pairs.est_poses - pairs.unmatched,
        "unmatched": pairs.unmatched,
        "pairs": len(pairs.T_world_camera_est),
    }


def _absolute_errors(pairs: PosePairs) -> TrajectoryScore:
    result = trajectory_errors.absolute_trajectory_error(pairs.T_world_camera_gt, pairs.T_world_camera_est)
    return TrajectoryScore({"absolute": PoseErrors(result.translation, result.rotation)}, _pose_counts(pairs))


def _relative_errors(pairs: PosePairs, protocol: Protocol) -> TrajectoryScore | NoValue:
    steps: list[tuple[trajectory_errors.DeltaUnit, float]] = [
        ("frames", protocol.rpe_frames),
        ("metres", protocol.rpe_metres),
    ]
    if pairs.stamps_ns is not None:
        steps.append(("seconds", protocol.rpe_seconds))
    errors: dict[str, PoseErrors] = {}
    counts = _pose_counts(pairs)
    for unit, delta in steps:
        result = trajectory_errors.relative_pose_error(
            pairs.T_world_camera_gt, pairs.T_world_camera_est, pairs.stamps_ns, delta=delta, unit=unit
        )
        counts[f"pairs_{unit}"] = 0 if result is None else result.pairs
        if result is not None:
            errors[unit] = PoseErrors(result.translation, result.rotation)
    if "frames" not in errors:
        poses = len(pairs.T_world_camera_est)
        return NoValue(
            f"{poses} paired poses are too few for a relative error over {protocol.rpe_frames} frames",
            asked=True,
        )
    return TrajectoryScore(errors, counts)


def _build_maps(
    gt: Source,
    est: Source,
    alignment: Alignment,
    protocol: Protocol,
    device: str,
    clock: Stopwatch,
) -> tuple[MapSide, MapSide, str] | NoValue:
    """Both maps on one grid in the ground truth's world, and the device; or why there are none."""
    for side, source in (("ground truth", gt), ("estimate", est)):
        if source.cloud is None and source.frames is None:
            return NoValue(f"the {side} has no map", asked=False)
    from maomaps_warp.mapping.device import resolve_device

    with clock.stage("start device"):
        device = resolve_device(device)
    grid = _grid_around(gt, protocol)
    gt_map = _build_map("ground-truth map", gt, Alignment(), grid, protocol, device, clock)
    est_map = _build_map("estimated map", est, alignment, grid, protocol, device, clock)
    for name, side_map in ((gt.name, gt_map), (est.name, est_map)):
        if not len(side_map.voxels):
            return NoValue(f"{name}: no depth sample lies within the range limits of a frame with a pose", True)
    return gt_map, est_map, device


def _grid_around(gt: Source, protocol: Protocol) -> VoxelGrid:
    """A grid whose origin lies in the middle of the ground truth, so that float32 suffices on the device."""
    points = gt.cloud.points if gt.cloud is not None else None
    if points is None and gt.trajectory is not None:
        points = gt.trajectory.positions
    middle = np.zeros(3) if points is None else points.mean(axis=0)
    return VoxelGrid(
        protocol.voxel_size, np.rint(middle / protocol.voxel_size).astype(np.int64), protocol.center_offset
    )


def _build_map(
    stage: str,
    source: Source,
    alignment: Alignment,
    grid: VoxelGrid,
    protocol: Protocol,
    device: str,
    clock: Stopwatch,
) -> MapSide:
    from maomaps_warp.mapping import cloud_map, voxel_map
    from maomaps_warp.scoring.frame_poses import pose_of_frame

    with clock.stage(stage) as progress:
        if source.cloud is not None:
            points = alignment.apply_points(source.cloud.points)
            cloud_map.check_extent(points, grid, source.name)
            # OctoMap holds points in float32; that decides the cell of a point on a cell's face.
            exact = points if protocol.cells == "rounded" else points.astype(np.float32).astype(np.float64)
            voxels = cloud_map.voxelise(exact, grid)
            facts = {"points": len(points), "dropped_nonfinite": source.cloud.dropped_nonfinite}
            return MapSide(points, voxels, facts)
        assert source.frames is not None
        if source.trajectory is None:
            raise InputError(source.name, "depth frames without poses", "give a trajectory file for them")
        trajectory = alignment.apply_trajectory(source.trajectory)
        build = voxel_map.build_voxel_map(
            source.frames,
            pose_of_frame(trajectory, source.frames, method=protocol.match, max_gap_s=protocol.stamp_gap),
            grid,
            voxel_map.DepthLimits(protocol.min_range, protocol.max_range, protocol.pixel_stride, alignment.scale),
            device=device,
            progress=progress,
        )
        return MapSide(build.voxels.points, build.voxels, build.counts)


def _nearest_errors(gt: MapSide, est: MapSide, protocol: Protocol, device: str) -> NearestScore | NoValue:
    from maomaps_warp.scoring import map_errors

    est_to_gt, gt_to_est = map_errors.distances_both_ways(est.points, gt.points, device)
    accuracy, completeness = Statistics.of(est_to_gt), Statistics.of(gt_to_est)
    if accuracy is None or completeness is None:
        return NoValue("a map is empty", asked=True)
    return NearestScore(
        accuracy,
        completeness,
        tuple(map_errors.threshold_score(est_to_gt, gt_to_est, t) for t in protocol.thresholds),
        map_errors.voxel_overlap(est.voxels, gt.voxels),
        {"est_points": len(est.points), "gt_points": len(gt.points)},
    )


def _camera_of(gt: Source, est: Source, camera: Camera | None, protocol: Protocol) -> tuple[Camera, str]:
    """The camera that decides what is in view, and how to name it."""
    stated = [
        (camera, "--camera"),
        (est.camera or (est.frames.camera if est.frames else None), est.name),
        (gt.camera or (gt.frames.camera if gt.frames else None), gt.name),
    ]
    for candidate, origin in stated:
        if candidate is not None:
            return candidate, f"{candidate} (from {origin})"
    from maomaps_warp.io.cameras import parse_camera

    return parse_camera(protocol.camera), f"{protocol.camera} (the protocol's: the inputs state none)"


def _associate(
    gt: MapSide,
    est: MapSide,
    pairs: PosePairs,
    camera: Camera,
    protocol: Protocol,
    device: str,
    clock: Stopwatch,
) -> Correspondences:
    from maomaps_warp.mapping.cloud_map import octomap_leaves
    from maomaps_warp.mapping.surface import build_surface
    from maomaps_warp.scoring.association import ViewRules, associate_maps

    with clock.stage("surfaces"):
        gt_surface, est_surface = build_surface(gt.voxels, device), build_surface(est.voxels, device)
        elements = octomap_leaves(est.voxels) if protocol.prune_leaves else est.voxels.points
    with clock.stage("association") as progress:
        return associate_maps(
            elements,
            est_surface,
            gt_surface,
            pairs.T_world_camera_est,
            pairs.T_world_camera_gt,
            ViewRules(
                camera,
                near=protocol.near,
                max_range=protocol.view_range,
                two_sided=protocol.two_sided_view,
                occlusion_tolerance=protocol.occlusion_tolerance,
                pose_choice=protocol.pose_choice,
            ),
            first_surface_is_estimate=protocol.est_point == "first-surface",
            progress=progress,
        )


def _ray_errors(correspondences: Correspondences, pairs: PosePairs) -> RayScore | NoValue:
    absolute = Statistics.of(correspondences.absolute_errors())
    relative = Statistics.of(correspondences.relative_errors(pairs.T_world_camera_est, pairs.T_world_camera_gt))
    counts = correspondences.counts | {
        "correspondences": len(correspondences),
        "poses": len(pairs.T_world_camera_est),
    }
    if absolute is None or relative is None:
        return NoValue("no predicted element could be associated", asked=True, counts=counts)
    return RayScore(absolute, relative, counts)


def _summary(source: Source, side: MapSide | None) -> InputSummary:
    facts: dict[str, float | int | str] = {}
    if source.trajectory is not None:
        facts["poses"] = len(source.trajectory)
        facts["path_length_m"] = source.trajectory.path_length
        if source.trajectory.duration_s is not None:
            facts["duration_s"] = source.trajectory.duration_s
    if side is not None:
        facts |= side.facts | {"voxels": len(side.voxels)}
    return InputSummary(source.name, source.kind, facts, source.notes)


def _notes(est: Source) -> tuple[str, ...]:
    cloud, trajectory = est.cloud, est.trajectory
    if cloud and trajectory and cloud.frame_id and trajectory.frame_id != cloud.frame_id:
        return (
            f"the estimate's map is in frame {cloud.frame_id!r} and its trajectory in {trajectory.frame_id!r}: "
            "they are scored as if both were the same world",
        )
    return ()
