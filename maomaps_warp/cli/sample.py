"""`maomaps-warp sample`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

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
from maomaps_warp.cli.options import CameraText, Debug, Device, Format, PoseFrame, Topics

if TYPE_CHECKING:
    from maomaps_warp.jobs.sample import MadeSample
    from maomaps_warp.map_protocol import MapProtocol


def sample(
    recordings: Annotated[
        list[Path], typer.Argument(help="Two bags or more (or RGB-D folders), one a run, with poses in one world.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Sample directory: it appears complete, or not.")
    ],
    bags: Annotated[
        Literal["copy", "link", "none"],
        typer.Option(help="Lay the bags beside the maps as first.bag and so on; link: symbolic links."),
    ] = "copy",
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
    ground: Annotated[
        str, typer.Option(metavar="RULE", help="Ground of the projections: robust, original, or a height in metres.")
    ] = "robust",
    device: Device = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the maps and poses that DIR has.")] = False,
    debug: Debug = False,
) -> None:
    """Make a sample of a dataset: the map of each run, the merged map, trajectories, start and goal poses, the IoU.

    The options hold for all runs. The layout is that of the MAOMaps data set. Exit code 2: an input cannot be used, and
    nothing was written.
    """
    from maomaps_warp.cli.terminal import check_device_name, progress_clock, quiet_warp, user_errors
    from maomaps_warp.io.bag_formats import recognise_bag
    from maomaps_warp.io.sample_writing import SamplePlace, check_sample_writable
    from maomaps_warp.io.sources import SourceOptions
    from maomaps_warp.jobs.ground_truth import open_recording
    from maomaps_warp.jobs.sample import make_sample

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
        runs = _named(recordings)
        place = SamplePlace(output, {run: path for run, path in runs.items() if recognise_bag(path)}, bags, overwrite)
        check_sample_writable(place)
        reading = SourceOptions(topics=tuple(topic or ()), format=format, pose_frame=pose_frame)
        with progress_clock() as clock:
            with clock.stage("read"):
                sources = {run: open_recording(path, rules, reading) for run, path in runs.items()}
            quiet_warp()
            made = make_sample(place, sources, rules, ground=ground, with_colors=colors, device=device, clock=clock)
        _print(made, runs, place.folder, rules, ground)


def _named(recordings: list[Path]) -> dict[str, Path]:
    """The recordings by the names of their runs."""
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.sample_directories import RUN_NAMES

    if not 2 <= len(recordings) <= len(RUN_NAMES):
        found = f"{len(recordings)} given" if len(recordings) > 1 else "only one given"
        hint = f"a sample has 2 to {len(RUN_NAMES)} runs; `map` makes the map of one"
        raise InputError("recordings", found, hint)
    return dict(zip(RUN_NAMES, recordings, strict=False))


def _print(made: MadeSample, runs: dict[str, Path], folder: Path, rules: MapProtocol, ground: str) -> None:
    from maomaps_warp.cli.terminal import console
    from maomaps_warp.model.dataset import DatasetFigures
    from maomaps_warp.report.dataset_table import dataset_tables, overlap_lines

    out = console()
    for run, path in runs.items():
        counts = made.counts[run]
        used = counts["frames"] - counts["frames_without_pose"] - counts.get("frames_without_color", 0)
        text = f"{run:<8} {path}: {counts['voxels']} voxels of {used} of {counts['frames']} depth images"
        out.print(text, soft_wrap=True)
        for note in made.notes[run]:
            out.print(f"note     {note}", soft_wrap=True)
    assert made.figures.overlap is not None, "a sample has two runs or more"
    for line in overlap_lines(made.figures.overlap):
        out.print(line)
    table = DatasetFigures(str(folder), (made.figures,), rules.voxel_size, ground)
    for part in dataset_tables(table):
        out.print(part, soft_wrap=isinstance(part, str))
    out.print(f"wrote {len(made.files)} files to {folder}", soft_wrap=True)
