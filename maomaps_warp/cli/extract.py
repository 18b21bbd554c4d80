"""`maomaps-warp extract`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from maomaps_warp.cli.options import Debug, PoseFrame, Topics

if TYPE_CHECKING:
    from rich.table import Table

    from maomaps_warp.jobs.extract import Extracted


def extract(
    path: Annotated[Path, typer.Argument(metavar="BAG", help="A bag of any kind.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="A new or empty folder.")],
    topic: Topics = None,
    every: Annotated[bool, typer.Option("--every", help="All clouds of a topic; else the last.")] = False,
    trajectory_format: Annotated[
        Literal["tum", "maomaps"], typer.Option(help="The camera's poses, or the body's.")
    ] = "tum",
    pose_frame: PoseFrame = "auto",
    cloud_format: Annotated[
        Literal["pcd", "ply", "txt"], typer.Option(help="x, y, z and colours; nothing else is kept.")
    ] = "pcd",
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="DIR may hold something; files of the same names are replaced.")
    ] = False,
    debug: Debug = False,
) -> None:
    """Take the clouds, trajectories and occupancy grids out of a bag.

    Files are named after their topics. Odometry becomes poses of the camera, which looks forward; as recorded:
    --pose-frame optical. Exit code 2: nothing could be taken out. 3: some topics could not; the others are written.
    """
    from maomaps_warp.cli.terminal import EXIT_NO_SCORE, complain, console, progress_clock, user_errors
    from maomaps_warp.jobs import extract as job

    with user_errors(debug):
        options = job.ExtractOptions(tuple(topic or ()), every, trajectory_format, pose_frame, cloud_format, overwrite)
        with progress_clock() as clock:
            extraction = job.extract(path, output, options, clock)
        out = console()
        out.print(_table(extraction.taken))
        for taken in extraction.taken:
            for note in taken.notes:
                out.print(f"note   {taken.topic.name}: {note.removeprefix(f'{taken.topic.name}: ')}", soft_wrap=True)
        out.print(f"wrote  {sum(len(taken.files) for taken in extraction.taken)} files into {output}", soft_wrap=True)
        for reason in extraction.failures:
            complain(reason)
    if extraction.failures:
        raise typer.Exit(EXIT_NO_SCORE)


def _table(rows: tuple[Extracted, ...]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE, pad_edge=False)
    for name in ("topic", "type", "size", "file"):
        table.add_column(name, justify="right" if name == "size" else "left", overflow="fold")
    for row in rows:
        names = [file.name for file in row.files]
        shown = ", ".join(names) if len(names) <= 2 else f"{names[0]} ... ({len(names)} files)"
        table.add_row(row.topic.name, row.topic.type.replace("/msg/", "/"), f"{row.count} {row.unit}", shown)
    return table
