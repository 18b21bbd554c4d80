"""`maomaps-warp map`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from maomaps_warp.cli.map_options import (
    Ceiling,
    ColorGap,
    Colors,
    MaxRange,
    MinRange,
    ProtocolName,
    StampGap,
    Stride,
    VoxelSize,
    map_protocol_of,
)
from maomaps_warp.cli.options import CameraText, Debug, Device, Format, JsonFile, PoseFrame, Topics


def map_recording(
    source: Annotated[Path, typer.Argument(help="Bag or RGB-D folder with depth images.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Sample directory to write the run into.")
    ],
    run: Annotated[str, typer.Option(help="Name of the run to write: first, second, ...")] = "first",
    trajectory: Annotated[Path | None, typer.Option(metavar="FILE", help="Take the poses from here.")] = None,
    topic: Topics = None,
    format: Format = "auto",
    pose_frame: PoseFrame = "auto",
    camera: CameraText = None,
    protocol: ProtocolName = "maomaps",
    voxel_size: VoxelSize = None,
    min_range: MinRange = None,
    max_range: MaxRange = None,
    stride: Stride = None,
    ceiling: Ceiling = None,
    max_stamp_gap: StampGap = None,
    color_gap: ColorGap = None,
    colors: Colors = True,
    device: Device = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run if DIR has it already.")] = False,
    json_file: JsonFile = None,
    debug: Debug = False,
) -> None:
    """Make the ground-truth map of a recording, in the layout of the MAOMaps data set.

    Writes gt_points_RUN.pcd and .txt, gt_colors_RUN.txt, gt_poses_RUN.txt with timestamps, start_pose_RUN.txt and
    goal_pose_RUN.txt. What the poses mean is proved from the depth images where neither the recording nor --pose-frame
    says it. Exit code 2: an input cannot be used, and nothing was written.
    """
    from maomaps_warp.cli.terminal import check_device_name, console, progress_clock, quiet_warp, user_errors
    from maomaps_warp.io.outputs import write_whole
    from maomaps_warp.io.sample_writing import heading_notes, write_run
    from maomaps_warp.io.sources import SourceOptions
    from maomaps_warp.jobs.ground_truth import build_ground_truth, open_recording
    from maomaps_warp.report.ground_truth import MadeMap, ground_truth_document, ground_truth_table

    with user_errors(debug):
        check_device_name(device)
        rules = map_protocol_of(
            protocol,
            ceiling,
            camera,
            voxel_size=voxel_size,
            min_range=min_range,
            max_range=max_range,
            stride=stride,
            max_stamp_gap=max_stamp_gap,
            color_gap=color_gap,
        )
        _check_outputs(output, run, overwrite, json_file, (source, trajectory))
        reading = SourceOptions(topics=tuple(topic or ()), format=format, pose_frame=pose_frame)
        with progress_clock() as clock:
            with clock.stage("read"):
                opened = open_recording(source, rules, reading, trajectory_path=trajectory)
            quiet_warp()
            truth = build_ground_truth(opened, rules, device=device, clock=clock, with_colors=colors)
            with clock.stage("write"):
                files = write_run(output, run, truth.voxels, truth.trajectory, overwrite=overwrite)
        assert opened.camera is not None, "a source with frames states their camera"
        notes = (*truth.notes, *heading_notes(truth.trajectory))
        made = MadeMap(
            opened.name,
            opened.kind,
            opened.camera,
            rules,
            truth.voxels,
            truth.trajectory,
            truth.counts,
            notes,
            truth.device,
            files,
            clock.milliseconds,
        )
        if json_file is not None:
            with write_whole(json_file) as file:
                file.write(json.dumps(ground_truth_document(made), indent=2, allow_nan=False) + "\n")
        out = console()
        for part in ground_truth_table(made):
            out.print(part)


def _check_outputs(
    output: Path, run: str, overwrite: bool, json_file: Path | None, inputs: tuple[Path | None, ...]
) -> None:
    """Refuse what cannot be written, or would replace an input or another output."""
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.outputs import check_writable
    from maomaps_warp.io.sample_directories import RUN_NAMES, run_files
    from maomaps_warp.io.sample_writing import check_run_writable

    if run not in RUN_NAMES:
        raise InputError(f"--run {run}", "is no name of a run", f"allowed: {', '.join(RUN_NAMES)}")
    check_run_writable(output, run, overwrite=overwrite)
    taken = {path.resolve(): "is an input" for path in inputs if path is not None}
    written = {(output / name).resolve(): "is a file of the run" for name in run_files(run)}
    for path in written.keys() & taken.keys():
        raise InputError(path, "is an input, and a file of the run would take its place", "choose another --output")
    if json_file is not None:
        if json_file.resolve() in taken | written:
            found = (taken | written)[json_file.resolve()]
            raise InputError(f"--json {json_file}", found, "give it a file of its own")
        check_writable(json_file)
