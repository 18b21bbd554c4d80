"""`maomaps-warp score`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from maomaps_warp.cli.options import (
    CameraText,
    Debug,
    Device,
    Format,
    JsonFile,
    PoseFrame,
    Run,
    Topics,
    YawCorrection,
    camera_of,
    yaw_of,
)
from maomaps_warp.protocol import AlignMethod, Caster, MatchMethod, PoseChoice

if TYPE_CHECKING:
    from maomaps_warp.io.sources import Side, Source, SourceOptions
    from maomaps_warp.model.camera import Camera
    from maomaps_warp.pipeline import ScoredRun
    from maomaps_warp.protocol import Protocol
    from maomaps_warp.stopwatch import Stopwatch


def score(
    directory: Annotated[
        Path | None,
        typer.Argument(help="Directory with gt_points.txt, gt_poses.txt, slam_points.txt, slam_poses.txt."),
    ] = None,
    gt: Annotated[Path | None, typer.Option(help="Ground truth: bag, folder, map or trajectory.")] = None,
    est: Annotated[Path | None, typer.Option(help="Estimate: bag, folder, map or trajectory.")] = None,
    gt_map: Annotated[Path | None, typer.Option(help="Ground-truth map, instead of that of --gt.")] = None,
    gt_trajectory: Annotated[Path | None, typer.Option(help="Ground-truth trajectory, likewise.")] = None,
    est_map: Annotated[Path | None, typer.Option(help="Estimated map, instead of that of --est.")] = None,
    est_trajectory: Annotated[Path | None, typer.Option(help="Estimated trajectory, likewise.")] = None,
    run: Run = None,
    gt_topic: Topics = None,
    est_topic: Topics = None,
    gt_format: Format = "auto",
    est_format: Format = "auto",
    gt_pose_frame: PoseFrame = "auto",
    est_pose_frame: PoseFrame = "auto",
    protocol: Annotated[
        str, typer.Option(help="maomaps, paper, slam_comparison, or a .toml file; see `explain`.")
    ] = "maomaps",
    align: Annotated[
        AlignMethod | None,
        typer.Option(help="Transform of the estimate, found from the trajectories.", show_default="none"),
    ] = None,
    yaw_correction: YawCorrection = None,
    match: Annotated[
        MatchMethod | None,
        typer.Option(help="Ground truth at the estimate's stamps.", show_default="interpolate"),
    ] = None,
    max_stamp_gap: Annotated[
        float | None, typer.Option(metavar="S", help="Largest gap.", show_default="0.2 or, for nearest, 0.01")
    ] = None,
    t_offset: Annotated[
        float | None, typer.Option(metavar="S", help="Added to the estimate's stamps.", show_default="0")
    ] = None,
    pose_choice: Annotated[
        PoseChoice | None,
        typer.Option(help="Which of the poses that see an element.", show_default="nearest"),
    ] = None,
    caster: Annotated[
        Caster | None,
        typer.Option(help="How rays find voxels: through a distance field, or their mesh.", show_default="voxels"),
    ] = None,
    camera: CameraText = None,
    voxel_size: Annotated[float | None, typer.Option(metavar="M", help="Edge of a voxel.", show_default="0.05")] = None,
    device: Device = "auto",
    json_file: JsonFile = None,
    correspondences: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write gx gy gz sx sy sz a line, or .npz with everything."),
    ] = None,
    debug: Debug = False,
) -> None:
    """Score a SLAM run: ATE, RPE, AME by nearest neighbour and AME along transferred camera rays.

    Give both sides: --gt X --est Y, or their parts (--gt-map, --gt-trajectory, --est-map, --est-trajectory), or the
    original program's DIRECTORY. Exit code 2: an input cannot be used. 3: a metric that was asked for has no data.
    """
    from maomaps_warp.cli.terminal import check_device_name, progress_clock, user_errors
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.sources import SourceOptions

    with user_errors(debug):
        check_device_name(device)
        options = {
            "align": align,
            "yaw_correction": yaw_of(yaw_correction),
            "match": match,
            "max_stamp_gap": max_stamp_gap,
            "t_offset": t_offset,
            "pose_choice": pose_choice,
            "caster": caster,
            "voxel_size": voxel_size,
        }
        parts = (gt, est, gt_map, gt_trajectory, est_map, est_trajectory)
        _check_outputs(json_file, correspondences, (directory, *parts))
        rules = _protocol(protocol, options)
        lens = camera_of(camera)
        gt_options = SourceOptions(run, tuple(gt_topic or ()), gt_format, gt_pose_frame, lens)
        est_options = SourceOptions(run, tuple(est_topic or ()), est_format, est_pose_frame, lens)
        if directory is not None and any(part is not None for part in parts):
            raise InputError(directory, "given beside --gt or --est", "give the directory alone, or only options")
        with progress_clock() as clock:
            if directory is not None or (_has_map(gt, gt_map) and _has_map(est, est_map)):
                with clock.stage("start device"):
                    _start_device(device, rules)  # before reading: large maps are parsed by a kernel
            with clock.stage("read"):
                if directory is not None:
                    gt_source, est_source = _open_directory(directory, gt_options)
                else:
                    gt_source = _open_side("gt", gt, gt_map, gt_trajectory, gt_options)
                    est_source = _open_side("est", est, est_map, est_trajectory, est_options)
            if run is not None and not any("sample" in side.kind for side in (gt_source, est_source)):
                raise InputError(f"--run {run}", "neither side is a MAOMaps sample directory", "leave it away")
            scored = run_pipeline(gt_source, est_source, rules, lens, device, clock)
        report(scored, json_file, correspondences)


def _has_map(whole: Path | None, map_part: Path | None) -> bool:
    """Whether a side surely has a map, before anything is read: a map of its own, or a folder that is no ROS 2 bag."""
    return map_part is not None or (whole is not None and whole.is_dir() and not (whole / "metadata.yaml").exists())


def _start_device(name: str, protocol: Protocol) -> None:
    from maomaps_warp.cli.terminal import quiet_warp
    from maomaps_warp.mapping.device import resolve_device

    quiet_warp()
    if protocol.align == "none":
        resolve_device(name, "score")
    else:  # voxels that an alignment moves are free points
        resolve_device(name, "score", "nearest")


def run_pipeline(
    gt: Source, est: Source, protocol: Protocol, camera: Camera | None, device: str, clock: Stopwatch
) -> ScoredRun:
    """Score two opened sources; Warp is made quiet first if there are maps to compare."""
    from maomaps_warp import pipeline
    from maomaps_warp.cli.terminal import quiet_warp

    if all(source.cloud or source.frames for source in (gt, est)):
        quiet_warp()
    return pipeline.score(gt, est, protocol, camera=camera, device=device, clock=clock)


def report(scored: ScoredRun, json_file: Path | None, correspondences: Path | None) -> None:
    """Write a score's files and print it; exits with 3 if a metric that was asked for has no data."""
    from maomaps_warp.cli.terminal import EXIT_NO_SCORE, complain, console
    from maomaps_warp.io.correspondences import write_correspondences
    from maomaps_warp.io.outputs import write_whole
    from maomaps_warp.report.json_report import score_document
    from maomaps_warp.report.text import score_tables

    failures = list(scored.score.failures)
    if json_file is not None:
        with write_whole(json_file, "w") as file:
            file.write(json.dumps(score_document(scored.score), indent=2, allow_nan=False) + "\n")
    if correspondences is not None:
        if scored.correspondences is None or scored.poses is None:
            failures.append("--correspondences: there are none, it takes two maps and two paired trajectories")
        else:
            poses = scored.poses
            write_correspondences(
                correspondences, scored.correspondences, poses.T_world_camera_est, poses.T_world_camera_gt
            )
    out = console()
    for part in score_tables(scored.score):
        out.print(part, soft_wrap=isinstance(part, str))
    for reason in failures:
        complain(reason)
    if failures:
        raise typer.Exit(EXIT_NO_SCORE)


def _check_outputs(json_file: Path | None, correspondences: Path | None, inputs: tuple[Path | None, ...]) -> None:
    """Refuse outputs that cannot be written, or that would replace an input or one another."""
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.outputs import check_writable

    taken = {path.resolve(): "is an input" for path in inputs if path is not None}
    for option, output in (("--json", json_file), ("--correspondences", correspondences)):
        if output is None:
            continue
        if output.resolve() in taken:
            raise InputError(f"{option} {output}", f"{taken[output.resolve()]}", "give it a file of its own")
        check_writable(output)
        taken[output.resolve()] = f"is the file of {option} too"


def _protocol(name: str, options: dict[str, Any]) -> Protocol:
    from maomaps_warp.protocol_files import load_protocol, with_overrides

    given = {field: value for field, value in options.items() if value is not None}
    protocol = load_protocol(name)
    for field, value in given.items():
        protocol = with_overrides(protocol, {field: value}, "--" + field.replace("_", "-"))
    return protocol


def _open_side(
    side: Side,
    whole: Path | None,
    map_part: Path | None,
    trajectory_part: Path | None,
    options: SourceOptions,
) -> Source:
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.sources import open_source, source_from_parts

    if whole is not None:
        return open_source(whole, options, side, map_path=map_part, trajectory_path=trajectory_part)
    if map_part is None and trajectory_part is None:
        name = "ground truth" if side == "gt" else "estimate"
        raise InputError(f"--{side}", f"no {name} given", f"--{side}, or --{side}-map and --{side}-trajectory")
    return source_from_parts(map_part, trajectory_part, options, side)


def _open_directory(directory: Path, options: SourceOptions) -> tuple[Source, Source]:
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.sources import is_original_directory, open_original_directory

    if directory.exists() and not is_original_directory(directory):
        found = "is no directory of the original program (gt_points.txt, gt_poses.txt, slam_points.txt, slam_poses.txt)"
        raise InputError(directory, found, "give other inputs as --gt X --est Y")
    return open_original_directory(directory, options)
