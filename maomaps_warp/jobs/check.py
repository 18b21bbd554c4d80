"""Checking one recording: what its poses mean, its depth unit, its stamps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.checking.depth_unit import prove_depth_unit
from maomaps_warp.checking.proof import RULE, says_the_same
from maomaps_warp.checking.proof import prove as prove_sample
from maomaps_warp.checking.recorded import recorded_poses
from maomaps_warp.checking.recording import frames_without_pose, partner_gaps, pose_jumps, stamp_facts, up_axis
from maomaps_warp.checking.sampling import FrameSample, sample_frames
from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import recognise_bag
from maomaps_warp.io.bags.image_stamps import read_image_stamps
from maomaps_warp.io.source import Source, SourceOptions, option
from maomaps_warp.io.sources import open_source
from maomaps_warp.model.check_results import ColorGaps, ConventionProof, Jump, RecordingCheck, StampFacts, UpAxis
from maomaps_warp.model.frame import FrameStream
from maomaps_warp.model.pose_convention import parse_convention
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.stopwatch import Stopwatch

#: Of more jumps only the first are named.
JUMPS_NAMED = 3
#: Frames or poses may miss this share before it is a finding.
MISSING_ALLOWED = 0.01


def check(path: Path, options: SourceOptions, trajectory_path: Path | None, clock: Stopwatch) -> RecordingCheck:
    """Check a recording.

    Args:
        path: depth images with poses: a bag or an RGB-D folder.
        options: how to read it.
        trajectory_path: take the poses from here.
        clock: collects the stages' times.

    Raises:
        InputError: there are no depth images or no poses, or they cannot be read.
    """
    with clock.stage("read"):
        source = open_source(path, options, "one", trajectory_path=trajectory_path)
        if options.run is not None and "sample" not in source.kind:
            raise InputError(f"--run {options.run}", f"{source.name} is no MAOMaps sample directory", "leave it away")
        frames, poses = _parts(source)
    with clock.stage("depth images") as progress:
        sample = sample_frames(frames, progress=progress)
    recorded = recorded_poses(poses)
    is_declared = options.pose_frame != "auto"
    with clock.stage("conventions"):
        proof = prove_sample(sample, recorded, also=parse_convention(poses.pose_frame) if is_declared else None)
    with clock.stage("depth unit"):
        unit = prove_depth_unit(sample, recorded, proof)
    with clock.stage("stamps") as progress:
        depth_ns, color_ns, color_findings = _image_stamps(path, options, frames, progress)
    stamped = {"depth": depth_ns, "colour": color_ns, "poses": poses.stamps_ns}
    facts = tuple(stamp_facts(what, stamps) for what, stamps in stamped.items() if stamps is not None and len(stamps))
    count, lost = _pose_counts(depth_ns, frames, sample, recorded)
    camera_trajectory = _under_best(recorded, proof)
    jumps = pose_jumps(camera_trajectory)
    gaps = _color_gaps(depth_ns, color_ns, options)
    contradicted = is_declared and proof.is_clear and not says_the_same(proof, parse_convention(poses.pose_frame))
    return RecordingCheck(
        name=source.name,
        kind=source.kind,
        camera=str(frames.camera),
        frames_source=frames.source,
        poses_source=poses.source,
        declared=poses.pose_frame,
        declared_by="the user" if is_declared else "nobody" if poses.is_assumed else "the source",
        proof=proof,
        is_contradicted=contradicted,
        depth_unit=unit,
        frames=count,
        frames_without_pose=lost,
        stamps=facts,
        color_gaps=gaps,
        jumps=jumps,
        up=_up(camera_trajectory, proof),
        findings=tuple(
            dict.fromkeys(
                (*_color_findings(frames), *color_findings, *_findings(facts, count, lost, gaps), *_jumps(jumps))
            )
        ),
        notes=source.notes,
        rule=RULE,
        milliseconds=dict(clock.milliseconds),
    )


def _parts(source: Source) -> tuple[FrameStream, Trajectory]:
    if source.frames is None:
        found = f"holds no depth images (it was read as: {source.kind})"
        hint = "check a bag or an RGB-D folder with depth images"
        if source.cloud is not None and "bag" in source.kind:
            hint += f"; if the bag has a depth topic beside its clouds, name it with {option('one', 'topic')}"
        raise InputError(source.name, found, hint)
    if source.trajectory is None:
        raise InputError(source.name, "holds no poses", f"give them with {option('one', 'trajectory')}")
    return source.frames, source.trajectory


def _image_stamps(
    path: Path, options: SourceOptions, frames: FrameStream, progress: Callable[[int, int | None], None]
) -> tuple[NDArray[np.int64] | None, NDArray[np.int64] | None, tuple[str, ...]]:
    """Stamps of all depth and colour images where there are some, and what stands against the colours."""
    if recognise_bag(path):
        try:
            return *read_image_stamps(path, options.topics, option("one", "topic")), ()
        except InputError as error:
            # The depth was read already: it is the colours that cannot be chosen.
            finding = f"colours cannot be used: {error}"
    else:
        finding = ""
    stamps = []
    for done, frame in enumerate(frames.read(False), start=1):
        if frame.stamp_ns is None:
            return None, None, ()
        stamps.append(frame.stamp_ns)
        progress(done, frames.count)
    return np.array(stamps, dtype=np.int64), None, (finding,) if finding else ()


def _pose_counts(
    depth_ns: NDArray[np.int64] | None, frames: FrameStream, sample: FrameSample, recorded: Trajectory
) -> tuple[int, int]:
    """How many frames there are, and how many have no pose."""
    if depth_ns is not None and recorded.stamps_ns is not None and len(recorded):
        return len(depth_ns), frames_without_pose(depth_ns, recorded)
    count = frames.count if frames.count is not None else int(sample.index[-1]) + 1 if len(sample) else 0
    return count, max(0, count - len(recorded))


def _under_best(recorded: Trajectory, proof: ConventionProof) -> Trajectory:
    """The cameras' poses under the best convention; as recorded if there is none."""
    if not proof.candidates:
        return recorded
    return replace(recorded, T_world_camera=proof.candidates[0].convention.camera_poses(recorded.T_world_camera))


def _up(cameras: Trajectory, proof: ConventionProof) -> UpAxis | None:
    return up_axis(cameras.T_world_camera) if proof.candidates else None


def _color_gaps(
    depth_ns: NDArray[np.int64] | None, color_ns: NDArray[np.int64] | None, options: SourceOptions
) -> ColorGaps | None:
    if depth_ns is None or color_ns is None or not len(depth_ns) or not len(color_ns):
        return None
    gaps = partner_gaps(depth_ns, color_ns)
    limit = options.max_color_gap_ns
    return ColorGaps(
        float(np.median(gaps)) * 1e-9, float(gaps.max()) * 1e-9, int((gaps > limit).sum()), float(limit) * 1e-9
    )


def _color_findings(frames: FrameStream) -> tuple[str, ...]:
    """What stands against the colours of the first frame: most often another size than the depth's."""
    try:
        next(iter(frames.read(True)), None)
    except InputError as error:
        return (f"colours cannot be used: {error}",)
    return ()


def _findings(facts: tuple[StampFacts, ...], frames: int, lost: int, gaps: ColorGaps | None) -> tuple[str, ...]:
    found = [
        f"{one.what}: {one.missing} messages are missing in {one.gaps} gaps, the largest of {one.largest_gap_s:.3f} s "
        f"at {one.largest_at_s:.3f} s"
        for one in facts
        if one.missing > MISSING_ALLOWED * one.count
    ]
    if lost:
        found.append(f"{lost} of {frames} depth frames have no pose")
    if gaps is not None and gaps.without:
        found.append(f"{gaps.without} of {frames} depth images have no colours within {gaps.limit_s:g} s")
    return tuple(found)


def _jumps(jumps: tuple[Jump, ...]) -> tuple[str, ...]:
    if not jumps:
        return ()
    named = [
        f"pose {jump.index + 1} by {jump.step_m:.2f} m"
        + (f" at {jump.at_s:.3f} s ({jump.speed:.1f} m/s)" if jump.at_s is not None else "")
        for jump in jumps[:JUMPS_NAMED]
    ]
    more = f" and {len(jumps) - JUMPS_NAMED} more" if len(jumps) > JUMPS_NAMED else ""
    return (f"poses jump: {', '.join(named)}{more}",)
