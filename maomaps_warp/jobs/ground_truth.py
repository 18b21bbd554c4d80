"""The job of `map`: a ground-truth map of a recording of depth images and poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import recognise_bag
from maomaps_warp.io.cameras import parse_camera
from maomaps_warp.io.sources import AS_IT_COMES, Source, SourceOptions, open_source
from maomaps_warp.map_protocol import MapProtocol
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap
from maomaps_warp.stopwatch import Stopwatch

#: What `body` is called beside its own name: no other world.
_SAME_WORLD = {"maomaps-c"}


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """A map made of a recording.

    Attributes:
        voxels: the map, on multiples of the voxel size.
        trajectory: every recorded pose, with its whole rotation whatever the protocol maps with; `pose_frame` is what
            they were found or declared to mean.
        counts: frames, pixels and voxels, and what became of them.
        notes: what was decided or left out, in reading too; one short sentence each.
        device: what it was built on.
    """

    voxels: VoxelMap
    trajectory: Trajectory
    counts: dict[str, int]
    notes: tuple[str, ...]
    device: str


def open_recording(
    path: Path, protocol: MapProtocol, options: SourceOptions = AS_IT_COMES, *, trajectory_path: Path | None = None
) -> Source:
    """Open what a map is to be made of, with the camera and the colour gap of a protocol.

    Args:
        path: a bag or an RGB-D folder.
        protocol: its camera, if it has one, replaces that of `options`.
        options: how to read it.
        trajectory_path: take the poses from here.

    Raises:
        InputError: as `open_source`, or there are no depth images.
    """
    camera = parse_camera(protocol.camera) if protocol.camera else options.camera
    options = replace(options, camera=camera, max_color_gap_ns=round(protocol.color_gap * 1e9))
    source = open_source(path, options, "one", trajectory_path=trajectory_path)
    frames_of(source)
    if recognise_bag(path) or options.max_color_gap_ns == AS_IT_COMES.max_color_gap_ns:
        return source
    note = "color_gap has no effect: the folder's own layout says which colours belong to which depth image"
    return replace(source, notes=(*source.notes, note))


def build_ground_truth(
    source: Source,
    protocol: MapProtocol,
    *,
    device: str = "cpu",
    clock: Stopwatch | None = None,
    with_colors: bool = True,
) -> GroundTruth:
    """Map the depth images of a recording through its poses.

    Args:
        source: with depth images, its camera that of the protocol if that has one: see `open_recording`.
        protocol: constants and choices.
        device: "auto", "cpu" or "cuda:N".
        clock: collects the stages' times and passes on progress.
        with_colors: average colours too; depth images without colours are then left out.

    Raises:
        InputError: no depth images or no poses; the meaning of the poses is neither declared nor proved; points beyond
            the reach of the grid; or an empty map: says why.
        CapacityError: more voxels than the largest table holds.
    """
    from maomaps_warp.mapping.device import resolve_device
    from maomaps_warp.mapping.voxel_map import DepthLimits, build_voxel_map

    clock = clock or Stopwatch()
    stream = frames_of(source)
    trajectory, notes = with_known_convention(source, stream, clock)
    notes += (*_jump_notes(trajectory), *_up_notes(trajectory))
    with clock.stage("start device"):
        used_device = resolve_device(device, "map")
    with clock.stage("map") as progress:
        build = build_voxel_map(
            stream,
            _pose_of_frame(trajectory, stream, protocol),
            VoxelGrid.around(trajectory.positions, protocol.voxel_size),
            DepthLimits(protocol.min_range, protocol.max_range, protocol.pixel_stride),
            colors=protocol.color_mean if with_colors else None,
            arithmetic=protocol.arithmetic,
            device=used_device,
            progress=progress,
        )
    _check_not_empty(build.counts, source, protocol)
    voxels, removed, ceiling_notes = _without_ceiling(build.voxels, protocol)
    if not len(voxels):
        found = f"ceiling = {protocol.ceiling} removes all {removed} voxels of the map"
        raise InputError(source.name, found, "--ceiling keep, or the height of the ceiling in metres")
    counts = {"poses": len(trajectory), **build.counts, "ceiling_removed": removed, "voxels": len(voxels)}
    return GroundTruth(voxels, trajectory, counts, (*source.notes, *notes, *ceiling_notes), used_device)


def frames_of(source: Source) -> FrameStream:
    """The depth images of a recording; raises InputError where there are none."""
    if source.frames is None:
        held = "points" if source.cloud is not None else "poses"
        raise InputError(
            source.name,
            f"holds {held} but no depth images (it was read as: {source.kind})",
            "a map is made of depth images: a bag with images of 32FC1, 16UC1, mono16 or compressedDepth, or an RGB-D "
            "folder",
        )
    return source.frames


def with_known_convention(source: Source, stream: FrameStream, clock: Stopwatch) -> tuple[Trajectory, tuple[str, ...]]:
    """The trajectory as declared, or as the depth images prove it to be meant, with a note."""
    from maomaps_warp.checking.proof import prove_convention, recorded_poses

    trajectory = source.trajectory
    if trajectory is None:
        raise InputError(source.name, "holds depth images without poses", "give the poses with --trajectory")
    if not trajectory.is_assumed:
        return trajectory, ()
    with clock.stage("prove convention") as progress:
        recorded = recorded_poses(trajectory)
        proof = prove_convention(stream, recorded, progress=progress)
    if proof.frames < 2:
        found = f"its poses are not those of the depth images of {stream.source}: {proof.reason}"
        raise InputError(trajectory.source, found, "give the poses that were recorded with them with --trajectory")
    if proof.best is None:
        raise InputError(
            trajectory.source,
            f"what its poses mean is not declared, and the depth images do not prove it: {proof.reason}",
            "declare it with --pose-frame; `maomaps-warp check` shows what fits",
        )
    found, meaning = proof.best.name, proof.best.meaning
    note = f"pose convention proved by the depth images: {found}, {meaning} ({proof.reason})"
    if proof.candidates[0].equivalents and not set(proof.candidates[0].equivalents) <= _SAME_WORLD:
        alike = ", ".join(proof.candidates[0].equivalents)
        note += f"; {alike} would give the same map in a world that is turned or moved: --pose-frame declares which"
    if found == trajectory.pose_frame:
        return replace(trajectory, is_assumed=False), (note,)
    T = proof.best.camera_poses(recorded.T_world_camera)
    proved = replace(trajectory, T_world_camera=T, pose_frame=found, is_assumed=False)
    return proved, (f"{note}; {trajectory.pose_frame} is what such sources usually mean",)


def _jump_notes(trajectory: Trajectory) -> tuple[str, ...]:
    from maomaps_warp.checking.recording import pose_jumps

    jumps = pose_jumps(trajectory)
    if not jumps:
        return ()
    longest = max(jumps, key=lambda jump: jump.step_m)
    others = f"; {len(jumps)} steps are so" if len(jumps) > 1 else ""
    speed = "" if longest.speed is None else f" at {longest.speed:.3g} m/s"
    place = f"{longest.step_m:.3g} m{speed} from pose {longest.index} to pose {longest.index + 1}"
    return (f"the poses jump: {place} of {trajectory.source}{others}; the map may be doubled",)


def _up_notes(trajectory: Trajectory) -> tuple[str, ...]:
    from maomaps_warp.checking.recording import up_axis

    up = up_axis(trajectory.T_world_camera)
    if not up.is_clear or up.axis == "+z":
        return ()
    return (f"the cameras' up is the world's {up.axis}: ceiling, start pose and projections take +z for up",)


def _pose_of_frame(
    trajectory: Trajectory, stream: FrameStream, protocol: MapProtocol
) -> Callable[[Frame], NDArray[np.float64] | None]:
    from maomaps_warp.mapping.poses import heading_only
    from maomaps_warp.scoring.frame_poses import pose_of_frame

    whole = pose_of_frame(trajectory, stream, method=protocol.match, max_gap_s=protocol.stamp_gap)
    if protocol.rotation == "full":
        return whole

    def level(frame: Frame) -> NDArray[np.float64] | None:
        T_world_camera = whole(frame)
        return None if T_world_camera is None else heading_only(T_world_camera)

    return level


def _without_ceiling(voxels: VoxelMap, protocol: MapProtocol) -> tuple[VoxelMap, int, tuple[str, ...]]:
    from maomaps_warp.mapping.ceiling import remove_ceiling

    if protocol.ceiling == "keep":
        return voxels, 0, ()
    height = protocol.ceiling_height if protocol.ceiling == "height" else None
    lower, removed, note = remove_ceiling(voxels, height=height, margin=protocol.ceiling_margin)
    return lower, removed, (note,)


def _check_not_empty(counts: dict[str, int], source: Source, protocol: MapProtocol) -> None:
    frames, without_pose = counts["frames"], counts["frames_without_pose"]
    if frames == without_pose:
        gap = f"{protocol.match}, max_stamp_gap = {protocol.stamp_gap:g} s"
        found = f"not one of {frames} depth images has a pose at its stamp ({gap})"
        raise InputError(source.name, found, "widen --max-stamp-gap, or give other poses with --trajectory")
    if counts.get("frames_without_color") == frames - without_pose:
        found = f"not one of {frames - without_pose} depth images with a pose has colours"
        gap = f"{protocol.color_gap:g} s"
        hint = f"--no-colors makes the map without them; --color-gap is how far their stamps may differ, now {gap}"
        raise InputError(source.name, found, hint)
    if not counts["pixels_used"]:
        limits = f"{protocol.min_range:g} and {protocol.max_range:g} m"
        found = f"not one of {counts['pixels']} depth samples is between {limits}"
        raise InputError(source.name, found, "see --min-range and --max-range")
