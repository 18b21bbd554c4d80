"""The main job, step by step: pair in time, align, compare trajectories, build maps, compare maps.

Order, timing and progress live here; the mathematics lives in `scoring` and `mapping`, parsing in `io`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from maomaps_warp.errors import InputError
from maomaps_warp.io.sources import Source
from maomaps_warp.map_building import SideMap, build_both
from maomaps_warp.model.alignment import Alignment
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.correspondences import Correspondences
from maomaps_warp.model.paired_poses import PairedPoses
from maomaps_warp.model.pose_convention import parse_convention
from maomaps_warp.model.results import InputSummary, NearestScore, NoValue, RayScore, Score, TrajectoryScore
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelMap
from maomaps_warp.protocol import PRESETS, Caster, Protocol, changes_of
from maomaps_warp.scoring.pairing import pair_and_align
from maomaps_warp.scoring.summaries import absolute_score, nearest_score, ray_score, relative_score
from maomaps_warp.stopwatch import Stopwatch


@dataclass(frozen=True, eq=False)
class ScoredRun:
    """A score with what it was taken from.

    Attributes:
        score: the numbers.
        correspondences: of the association; None if there was none.
        poses: paired and aligned; None if there were none.
    """

    score: Score
    correspondences: Correspondences | None
    poses: PairedPoses | None


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
        CapacityError: a map too large for the device's tables.
    """
    clock = clock or Stopwatch()
    _check_something_in_common(gt, est)
    for side in (gt, est):
        _check_more_than_one_pose(side)
    with clock.stage("pair poses"):
        pairs, alignment = pair_and_align(gt.trajectory, est.trajectory, protocol, gt.start_pose)
    ate: TrajectoryScore | NoValue
    rpe: TrajectoryScore | NoValue
    if isinstance(pairs, NoValue):
        ate = rpe = pairs
    else:
        with clock.stage("trajectory errors"):
            ate, rpe = absolute_score(pairs), relative_score(pairs, protocol)

    used_device, used_camera = "none", ""
    nearest: NearestScore | NoValue
    ray: RayScore | NoValue
    correspondences = None
    maps: tuple[SideMap, SideMap] | NoValue | None = _why_no_maps(gt, est, alignment, protocol)
    if maps is None:
        from maomaps_warp.mapping.device import resolve_device

        with clock.stage("start device"):
            has_frames = gt.frames is not None or est.frames is not None
            used_device = resolve_device(device, "score", "map") if has_frames else resolve_device(device, "score")
        maps = build_both(gt, est, alignment or Alignment(), protocol, used_device, clock)
    if isinstance(maps, NoValue):
        nearest = ray = maps
    else:
        gt_map, est_map = maps
        with clock.stage("nearest neighbours"):
            nearest = nearest_score(est_map.points, gt_map.points, est_map.voxels, gt_map.voxels, protocol, used_device)
        if isinstance(pairs, NoValue):
            ray = pairs
        else:
            seen_by, used_camera = _camera_of(gt, est, camera, protocol)
            correspondences = _associate(gt_map, est_map, pairs, seen_by, protocol, used_device, clock)
            with clock.stage("association errors"):
                ray = ray_score(correspondences, pairs, used_device)
    result = Score(
        protocol=protocol,
        camera=used_camera,
        pairing=None if isinstance(pairs, NoValue) else (pairs.method, pairs.largest_gap_s),
        alignment=alignment,
        ate=ate,
        rpe=rpe,
        ame_nn=nearest,
        ame_ray=ray,
        gt=_summary(gt, None if isinstance(maps, NoValue) else maps[0]),
        est=_summary(est, None if isinstance(maps, NoValue) else maps[1]),
        device=used_device,
        milliseconds=clock.milliseconds,
        notes=(*_notes(gt, est, alignment), *_without_effect(protocol, camera, pairs, maps, ray)),
    )
    return ScoredRun(result, correspondences, None if isinstance(pairs, NoValue) else pairs)


def _check_something_in_common(gt: Source, est: Source) -> None:
    have_poses = gt.trajectory is not None and est.trajectory is not None
    if not have_poses and not (_has_map(gt) and _has_map(est)):
        held = "a map" if _has_map(gt) else "a trajectory"
        other = "a map" if _has_map(est) else "a trajectory"
        raise InputError(
            f"{gt.name} and {est.name}",
            f"the ground truth holds only {held}, the estimate only {other}: there is nothing to compare",
            "give both a map, or both a trajectory",
        )


def _check_more_than_one_pose(source: Source) -> None:
    if source.trajectory is not None and len(source.trajectory) < 2:
        raise InputError(
            source.trajectory.source,
            f"{len(source.trajectory)} pose is no trajectory",
            "give at least two, or the maps alone: --gt-map and --est-map",
        )


def _has_map(source: Source) -> bool:
    return source.cloud is not None or source.frames is not None


def _why_no_maps(gt: Source, est: Source, alignment: Alignment | None, protocol: Protocol) -> NoValue | None:
    """Why maps are not to be compared; None if they are."""
    for side, source in (("ground truth", gt), ("estimate", est)):
        if not _has_map(source):
            return NoValue(f"the {side} has no map", asked=False)
    if alignment is None:
        return NoValue(f"no paired poses to find --align {protocol.align} from", asked=True)
    return None


def _camera_of(gt: Source, est: Source, camera: Camera | None, protocol: Protocol) -> tuple[Camera, str]:
    """The camera that decides what is in view, and how to name it."""
    stated = ((camera, "--camera"), (est.camera, est.name), (gt.camera, gt.name))
    for candidate, origin in stated:
        if candidate is not None:
            return candidate, f"{candidate} (from {origin})"
    from maomaps_warp.io.cameras import parse_camera

    return parse_camera(protocol.camera), f"{protocol.camera} (the protocol's: the inputs state none)"


def _associate(
    gt: SideMap,
    est: SideMap,
    pairs: PairedPoses,
    camera: Camera,
    protocol: Protocol,
    device: str,
    clock: Stopwatch,
) -> Correspondences:
    from maomaps_warp.mapping.cloud_map import octomap_leaves
    from maomaps_warp.scoring.association import ViewRules, associate_maps

    with clock.stage("surfaces"):
        gt_surface, est_surface = _surfaces(gt.voxels, est.voxels, protocol.caster, device)
        elements = octomap_leaves(est.voxels) if protocol.prune_leaves else est.voxels.points
    rules = ViewRules(
        camera,
        near=protocol.near,
        max_range=protocol.view_range,
        two_sided=protocol.two_sided_view,
        occlusion_tolerance=protocol.occlusion_tolerance,
        pose_choice=protocol.pose_choice,
    )
    with clock.stage("association") as progress:
        return associate_maps(
            elements,
            est_surface,
            gt_surface,
            pairs.T_world_camera_est,
            pairs.T_world_camera_gt,
            rules,
            first_surface_is_estimate=protocol.est_point == "first-surface",
            progress=progress,
        )


def _surfaces(gt: VoxelMap, est: VoxelMap, caster: Caster, device: str) -> tuple[Any, Any]:
    if caster == "mesh":
        from maomaps_warp.mapping.surface import build_surface

        return build_surface(gt, device), build_surface(est, device)
    from maomaps_warp.mapping.distance_field import build_voxel_fields

    return build_voxel_fields(gt, est, device)


def _summary(source: Source, side: SideMap | None) -> InputSummary:
    facts: dict[str, float | int | str] = {}
    if source.trajectory is not None:
        facts["poses"] = len(source.trajectory)
        facts["path_length_m"] = source.trajectory.path_length
        if source.trajectory.duration_s is not None:
            facts["duration_s"] = source.trajectory.duration_s
    return InputSummary(source.name, source.kind, facts | (side.facts if side else {}), source.notes)


def _notes(gt: Source, est: Source, alignment: Alignment | None) -> tuple[str, ...]:
    notes = []
    for source, option in ((gt, "--gt-pose-frame"), (est, "--est-pose-frame")):
        way = source.trajectory
        if source.frames is not None and source.one_clock and way is not None and way.is_assumed:
            notes.append(
                f"poses of {way.source} read as {_meaning(way)}: nobody declares it; `check` proves what they mean, "
                f"{option} says it"
            )
    cloud, trajectory = est.cloud, est.trajectory
    if gt.trajectory and trajectory and gt.trajectory.pose_frame != trajectory.pose_frame:
        notes.append(
            f"the ground truth's poses were read as {_meaning(gt.trajectory)}, the estimate's as "
            f"{_meaning(trajectory)}; if both are of one kind, relative errors and rays are "
            "wrong: see --gt-pose-frame and --est-pose-frame"
        )
    if alignment is not None and alignment.method == "start-pose":
        start = "its start_pose file" if alignment.pairs == 0 else "its first paired pose"
        notes.append(f"the start pose is that of the ground truth, from {start}")
    if cloud and trajectory and cloud.frame_id and trajectory.frame_id != cloud.frame_id:
        notes.append(
            f"the estimate's map is in frame {cloud.frame_id!r} and its trajectory in {trajectory.frame_id!r}: "
            "they are scored as if both were the same world"
        )
    if est.frames is not None and alignment is not None and alignment.scale != 1.0:
        notes.append(
            f"range limits apply to the estimate's depth as measured, before its scale of {alignment.scale:.6g}"
        )
    return tuple(notes)


def _without_effect(
    protocol: Protocol,
    camera: Camera | None,
    pairs: PairedPoses | NoValue,
    maps: tuple[SideMap, SideMap] | NoValue,
    ray: RayScore | NoValue,
) -> tuple[str, ...]:
    """What was chosen and plays no part, for want of the data that it is about."""
    idle: list[str] = []
    if isinstance(maps, NoValue):
        idle += ["voxel_size", "cells", "pixel_stride", "min_range", "max_range", "thresholds"]
    if isinstance(ray, NoValue):
        idle += ["pose_choice", "camera", "near", "view_range", "occlusion_tolerance", "caster", "est_point"]
    if isinstance(pairs, PairedPoses) and pairs.stamps_ns is None:
        idle += ["match", "max_stamp_gap", "rpe_seconds"]
    changed = changes_of(protocol).keys() | ({"camera"} if camera is not None else set())
    named = [name for name in idle if name in changed]
    return (f"without effect on this input: {', '.join(named)}",) if named else ()


def _meaning(trajectory: Trajectory) -> str:
    return parse_convention(trajectory.pose_frame).meaning
