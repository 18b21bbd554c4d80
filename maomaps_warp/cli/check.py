"""`maomaps-warp check`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from maomaps_warp.cli.options import CameraText, Debug, Format, JsonFile, PoseFrame, Run, Topics, camera_of


def check(
    source: Annotated[Path, typer.Argument(help="Bag or RGB-D folder with depth images.")],
    trajectory: Annotated[Path | None, typer.Option(help="Take the poses from here.")] = None,
    topic: Topics = None,
    format: Format = "auto",
    pose_frame: PoseFrame = "auto",
    camera: CameraText = None,
    run: Run = None,
    json_file: JsonFile = None,
    debug: Debug = False,
) -> None:
    """Prove what the poses of a recording mean, by carrying depth from frame to frame; check depth unit and stamps.

    Exit code 2: the recording cannot be read. 3: it is not clear what the poses mean, or not what --pose-frame says.
    """
    from maomaps_warp.cli.terminal import EXIT_NO_SCORE, complain, console, progress_clock, user_errors
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.outputs import check_writable, write_whole
    from maomaps_warp.io.sources import SourceOptions
    from maomaps_warp.jobs.check import check as check_recording
    from maomaps_warp.report.check import check_document, check_tables

    with user_errors(debug):
        if json_file is not None:
            if json_file.resolve() in {path.resolve() for path in (source, trajectory) if path is not None}:
                raise InputError(f"--json {json_file}", "is an input", "give it a file of its own")
            check_writable(json_file)
        options = SourceOptions(run, tuple(topic or ()), format, pose_frame, camera_of(camera))
        with progress_clock() as clock:
            found = check_recording(source, options, trajectory, clock)
        if json_file is not None:
            with write_whole(json_file, "w") as file:
                file.write(json.dumps(check_document(found), indent=2, allow_nan=False) + "\n")
        out = console()
        for part in check_tables(found):
            out.print(part, soft_wrap=isinstance(part, str))
        if not found.proof.is_clear:
            complain(
                f"{found.poses_source}: not clear what the poses mean: {found.proof.reason} (--pose-frame declares it)"
            )
            raise typer.Exit(EXIT_NO_SCORE)
        if found.is_contradicted and found.proof.best:
            complain(f"--pose-frame {found.declared}: the poses are {found.proof.best.name}")
            raise typer.Exit(EXIT_NO_SCORE)
