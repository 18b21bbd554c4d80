"""`maomaps-warp score-merge`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from maomaps_warp.cli.options import Debug, Device, JsonFile, YawCorrection, yaw_of

if TYPE_CHECKING:
    from maomaps_warp.jobs.merge_inputs import MergeFiles
    from maomaps_warp.model.merge_results import MergeScore, SuccessRule


def score_merge(
    sample: Annotated[Path, typer.Argument(help="MAOMaps sample directory with the ground truth of every run.")],
    source: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Map of each run in its own frame, in the order of the runs; repeatable."),
    ] = None,
    transforms: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The merge's transforms, one a source; a matrix of zeros: not merged."),
    ] = None,
    merged: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The merged map: any cloud, or an occupancy grid (YAML or bag)."),
    ] = None,
    align: Annotated[
        Literal["none", "first", "best"],
        typer.Option(
            help="none: the merged map lies in the truth's world; first: its first merged source lies where its run "
            "began; best: the best rigid transform, with what it hides."
        ),
    ] = "first",
    yaw_correction: YawCorrection = None,
    gt_transforms: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Where each source truly lies in the world, instead of the start poses."),
    ] = None,
    success_m: Annotated[float, typer.Option(metavar="M", help="Largest transform error of a success.")] = 1.0,
    success_deg: Annotated[float, typer.Option(metavar="DEG", help="Likewise, of the rotation.")] = 10.0,
    success_ame: Annotated[
        float | None,
        typer.Option(metavar="M", help="Largest AME of a success; decides alone where there are no transforms."),
    ] = None,
    voxel_size: Annotated[float, typer.Option(metavar="M", help="Edge of the sample's voxels.")] = 0.05,
    wall_distance: Annotated[
        float, typer.Option(metavar="M", help="How far from a surface a second one makes a doubled wall.")
    ] = 0.5,
    ground: Annotated[
        str,
        typer.Option(
            metavar="RULE", help="Ground to score an occupancy grid on: robust, original, or a height in metres."
        ),
    ] = "robust",
    pair: Annotated[str | None, typer.Option(help="Row in tables.", show_default="name of the sample")] = None,
    method: Annotated[
        str | None, typer.Option(help="Column in tables.", show_default="name of the merge's file or folder")
    ] = None,
    device: Device = "auto",
    json_file: JsonFile = None,
    debug: Debug = False,
) -> None:
    """Score a merge of maps: transform errors, success, AME inside and outside the overlap, doubled walls.

    Give the sources' own maps with the merge's --transforms, or the --merged map, or all of them. Exit code 2: an input
    cannot be used. 3: there is no AME, as where nothing was merged; the result is printed all the same.
    """
    from maomaps_warp.cli.terminal import check_device_name, progress_clock, quiet_warp, user_errors
    from maomaps_warp.mapping.projection import ground_height

    with user_errors(debug):
        check_device_name(device)
        rule = _rule(success_m, success_deg, success_ame)
        _check_length("--voxel-size", voxel_size)
        _check_wall_distance(wall_distance, voxel_size)
        ground_height(ground)
        yaw = yaw_of(yaw_correction)
        from maomaps_warp.jobs.merge_inputs import MergeFiles
        from maomaps_warp.jobs.score_merge import MergeChoices
        from maomaps_warp.jobs.score_merge import score_merge as run

        files = MergeFiles(sample, tuple(source or ()), transforms, merged, gt_transforms)
        _check_json(json_file, files)
        quiet_warp()
        from maomaps_warp.mapping.device import resolve_device

        choices = MergeChoices(align, yaw, rule, voxel_size, wall_distance, ground, pair, method)
        with progress_clock() as clock:
            score = run(files, choices, device=resolve_device(device, "score", "nearest"), clock=clock)
        _report(score, json_file)


def _report(score: MergeScore, json_file: Path | None) -> None:
    """Write the document, then print; exit 3 if there is no AME."""
    from maomaps_warp.cli.terminal import EXIT_NO_SCORE, complain, console
    from maomaps_warp.io.outputs import write_whole
    from maomaps_warp.report.merge_json import merge_document
    from maomaps_warp.report.merge_text import merge_tables

    if json_file is not None:
        with write_whole(json_file) as file:
            file.write(json.dumps(merge_document(score), indent=2, allow_nan=False) + "\n")
    out = console()
    for part in merge_tables(score):
        out.print(part, soft_wrap=isinstance(part, str))
    for reason in score.failures:
        complain(reason)
    if score.failures:
        raise typer.Exit(EXIT_NO_SCORE)


def _rule(max_m: float, max_deg: float, max_ame: float | None) -> SuccessRule:
    from maomaps_warp.model.merge_results import SuccessRule

    _check_length("--success-m", max_m)
    _check_length("--success-deg", max_deg, "degrees")
    if max_ame is not None:
        _check_length("--success-ame", max_ame)
    return SuccessRule(max_m, math.radians(max_deg), max_ame)


def _check_length(option: str, value: float, unit: str = "metres") -> None:
    from maomaps_warp.errors import InputError

    if not 0.0 < value <= 1000.0:
        raise InputError(f"{option} {value:g}", "out of range", f"above 0, up to 1000 {unit}")


def _check_wall_distance(distance: float, voxel_size: float) -> None:
    """Surfaces nearer than three voxels are one; beyond a few metres a second one is another wall."""
    from maomaps_warp.errors import InputError

    if not 3.0 * voxel_size <= distance <= 200.0 * voxel_size:
        hint = f"3 to 200 voxels: {3.0 * voxel_size:g} to {200.0 * voxel_size:g} metres"
        raise InputError(f"--wall-distance {distance:g}", "out of range", hint)


def _check_json(json_file: Path | None, files: MergeFiles) -> None:
    """Refuse a file that cannot be written, or that would replace an input."""
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.outputs import check_writable

    if json_file is None:
        return
    inputs = (*files.sources, files.transforms, files.merged, files.gt_transforms)
    if json_file.resolve() in {path.resolve() for path in inputs if path is not None}:
        raise InputError(f"--json {json_file}", "is an input", "give it a file of its own")
    check_writable(json_file)
