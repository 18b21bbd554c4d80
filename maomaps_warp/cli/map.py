"""`maomaps-warp map`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from maomaps_warp.cli.options import CameraText, Debug, Device, Format, JsonFile, PoseFrame, Topics, camera_of

if TYPE_CHECKING:
    from maomaps_warp.map_protocol import MapProtocol


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
    protocol: Annotated[str, typer.Option(help="maomaps, gt_map_creator, or a .toml file; see `explain`.")] = "maomaps",
    voxel_size: Annotated[float | None, typer.Option(metavar="M", help="Edge of a voxel.", show_default="0.05")] = None,
    min_range: Annotated[
        float | None, typer.Option(metavar="M", help="Nearest depth, exclusive.", show_default="0.01")
    ] = None,
    max_range: Annotated[
        float | None, typer.Option(metavar="M", help="Farthest depth, exclusive.", show_default="10")
    ] = None,
    stride: Annotated[
        int | None, typer.Option(metavar="N", help="Every n-th pixel of each row and column.", show_default="1")
    ] = None,
    ceiling: Annotated[
        str | None,
        typer.Option(metavar="RULE", help="keep, layer (the original's rule), or a height in m.", show_default="keep"),
    ] = None,
    max_stamp_gap: Annotated[
        float | None,
        typer.Option(metavar="S", help="Largest gap between poses around an image.", show_default="0.2"),
    ] = None,
    color_gap: Annotated[
        float | None, typer.Option(metavar="S", help="Largest gap of depth and colours.", show_default="0.02")
    ] = None,
    colors: Annotated[bool, typer.Option("--colors/--no-colors", help="Colours of the map.")] = True,
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
        options = {
            "--voxel-size": ("voxel_size", voxel_size),
            "--min-range": ("min_range", min_range),
            "--max-range": ("max_range", max_range),
            "--stride": ("pixel_stride", stride),
            "--max-stamp-gap": ("max_stamp_gap", max_stamp_gap),
            "--color-gap": ("color_gap", color_gap),
            "--camera": ("camera", camera_text(camera)),
        }
        rules = map_protocol_of(protocol, options, ceiling)
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


def map_protocol_of(name: str, options: dict[str, tuple[str, Any]], ceiling: str | None) -> MapProtocol:
    """The protocol of that name with what the options say instead.

    Args:
        name: a preset, or a TOML file.
        options: field and value of each option, None where it was not given.
        ceiling: text of `--ceiling`, or None.

    Raises:
        InputError: naming the option with a value that it cannot take.
    """
    from maomaps_warp.protocol_files import load_map_protocol, with_overrides

    given = {option: pair for option, pair in options.items() if pair[1] is not None}
    rules = load_map_protocol(name)
    if ceiling is not None:
        rules = with_overrides(rules, _ceiling(ceiling), f"--ceiling {ceiling}")
    # Together: the two ranges are only right or wrong as a pair.
    return with_overrides(rules, dict(given.values()), ", ".join(given)) if given else rules


def _ceiling(text: str) -> dict[str, str | float]:
    from maomaps_warp.errors import InputError

    if text in ("keep", "layer"):
        return {"ceiling": text}
    try:
        return {"ceiling": "height", "ceiling_height": float(text)}
    except ValueError:
        raise InputError(f"--ceiling {text}", "is no rule", "keep, layer, or a height in metres") from None


def camera_text(text: str | None) -> str | None:
    """The camera of `--camera`, which may be a file, as a protocol writes it.

    Raises:
        InputError: it describes none.
    """
    camera = camera_of(text)
    if camera is None:
        return None
    return f"{camera.width}x{camera.height}:{camera.fx!r},{camera.fy!r},{camera.cx!r},{camera.cy!r}"


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
