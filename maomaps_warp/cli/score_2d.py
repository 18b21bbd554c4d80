"""`maomaps-warp score-2d`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from maomaps_warp.cli.options import Debug, Device, Format, JsonFile, PoseFrame, Topics
from maomaps_warp.cli.project import GroundRule, MapRun, VoxelSize, check_run, check_voxel_size


def score_2d(
    gt: Annotated[Path, typer.Option(help="Ground truth: .yaml of a map_server pair, bag with a grid, or a 3D map.")],
    est: Annotated[Path, typer.Option(help="Estimate, likewise.")],
    gt_trajectory: Annotated[Path | None, typer.Option(help="Poses of a 3D map of --gt.")] = None,
    est_trajectory: Annotated[Path | None, typer.Option(help="Poses of a 3D map of --est.")] = None,
    run: MapRun = None,
    gt_topic: Topics = None,
    est_topic: Topics = None,
    gt_format: Format = "auto",
    est_format: Format = "auto",
    gt_pose_frame: PoseFrame = "auto",
    est_pose_frame: PoseFrame = "auto",
    ground: GroundRule = "robust",
    voxel_size: VoxelSize = 0.05,
    device: Device = "auto",
    json_file: JsonFile = None,
    debug: Debug = False,
) -> None:
    """Score an estimated map of the ground: 2D AME, IoU of known and of occupied cells.

    3D maps are projected as by `project`, both on the ground truth's ground. Both sides must be in one world. Exit
    code 2: an input cannot be used. 3: a map has no occupied cell.
    """
    from maomaps_warp.cli.terminal import (
        EXIT_NO_SCORE,
        check_device_name,
        complain,
        console,
        progress_clock,
        quiet_warp,
        user_errors,
    )
    from maomaps_warp.io.outputs import write_whole
    from maomaps_warp.io.sources import Source, SourceOptions
    from maomaps_warp.jobs import score_2d as job
    from maomaps_warp.mapping.projection import ground_height
    from maomaps_warp.model.results import NoValue
    from maomaps_warp.report.occupancy import occupancy_document, occupancy_tables

    with user_errors(debug):
        check_device_name(device)
        check_voxel_size(voxel_size)
        ground_height(ground)
        _check_output(json_file, (gt, est, gt_trajectory, est_trajectory))
        gt_options = SourceOptions(run, tuple(gt_topic or ()), gt_format, gt_pose_frame)
        est_options = SourceOptions(run, tuple(est_topic or ()), est_format, est_pose_frame)
        with progress_clock() as clock:
            with clock.stage("read"):
                sides = (
                    job.open_side(gt, gt_options, "gt", trajectory_path=gt_trajectory),
                    job.open_side(est, est_options, "est", trajectory_path=est_trajectory),
                )
            maps = [side for side in sides if isinstance(side, Source)]
            check_run(run, tuple(side.kind for side in maps))
            if any(side.frames is not None for side in maps):
                quiet_warp()
            report = job.score_2d(*sides, job.ProjectionRules(voxel_size, ground, device), clock)
        if json_file is not None:
            with write_whole(json_file) as file:
                file.write(json.dumps(occupancy_document(report), indent=2, allow_nan=False) + "\n")
        out = console()
        for part in occupancy_tables(report):
            out.print(part, soft_wrap=isinstance(part, str))
        if isinstance(report.score.ame, NoValue):
            complain(report.score.ame.reason)
            raise typer.Exit(EXIT_NO_SCORE)


def _check_output(json_file: Path | None, inputs: tuple[Path | None, ...]) -> None:
    """Refuse an output that cannot be written, or that would replace an input."""
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.outputs import check_writable

    if json_file is None:
        return
    if json_file.resolve() in {path.resolve() for path in inputs if path is not None}:
        raise InputError(f"--json {json_file}", "is an input", "give it a file of its own")
    check_writable(json_file)
