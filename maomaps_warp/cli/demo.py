"""`maomaps-warp demo`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from maomaps_warp.cli.options import Debug, Device, JsonFile


def demo(
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Keep the recording here; the folder must be new."),
    ] = None,
    frames: Annotated[int, typer.Option(min=2, max=5000, help="Length of the recording, at 10 Hz.")] = 240,
    seed: Annotated[int, typer.Option(min=0, help="Of the flat and of the disturbance.")] = 0,
    device: Device = "auto",
    json_file: JsonFile = None,
    debug: Debug = False,
) -> None:
    """Make a furnished flat, drive a camera through it, disturb the recording as SLAM would, and score it."""
    from maomaps_warp.cli.score import report, run_pipeline
    from maomaps_warp.cli.terminal import check_device_name, console, progress_clock, quiet_warp, user_errors
    from maomaps_warp.io.outputs import check_writable
    from maomaps_warp.io.sources import SourceOptions, open_source, source_from_parts
    from maomaps_warp.protocol import PRESETS

    with user_errors(debug), _folder(output) as folder:
        check_device_name(device)
        if json_file is not None:
            check_writable(json_file)
        quiet_warp()
        from maomaps_warp.jobs.demo import make_demo
        from maomaps_warp.mapping.device import resolve_device

        with progress_clock() as clock:
            with clock.stage("start device"):
                # All now, so that they compile side by side.
                used = resolve_device(device, "score", "nearest", "map", "render")
            files = make_demo(folder, frames=frames, seed=seed, device=used, clock=clock)
            out = console()
            for name, path in vars(files).items():
                size = sum(f.stat().st_size for f in ([path] if path.is_file() else path.iterdir()))
                out.print(f"wrote {name.replace('_', ' '):<15} {path}  {size / 1e6:.1f} MB")
            options = SourceOptions()
            with clock.stage("read"):
                gt = open_source(files.ros1_bag, options, "gt")
                est = source_from_parts(files.est_map, files.est_trajectory, options, "est")
            scored = run_pipeline(gt, est, PRESETS["maomaps"], None, device, clock)
        report(scored, json_file, None)
        total = sum(clock.milliseconds.values()) / 1e3
        stages = ", ".join(f"{name} {ms / 1e3:.1f}" for name, ms in clock.milliseconds.items())
        out.print(f"{total:.1f} s: {stages}")
        if output is None:
            out.print("The recording was temporary; keep one with: maomaps-warp demo --output DIR")
        else:
            out.print(
                f"Again: maomaps-warp score --gt {files.ros1_bag} --est-map {files.est_map} "
                f"--est-trajectory {files.est_trajectory}",
                soft_wrap=True,
            )


@contextmanager
def _folder(output: Path | None) -> Iterator[Path]:
    """A new folder that is kept, or a temporary one."""
    import shutil
    import tempfile

    from maomaps_warp.errors import InputError

    if output is None:
        with tempfile.TemporaryDirectory(prefix="maomaps-demo-") as name:
            yield Path(name)
        return
    try:
        output.mkdir(parents=True)
    except FileExistsError:
        raise InputError(output, "exists already", "give --output a new folder") from None
    except OSError as error:
        raise InputError(output, f"cannot be made: {error.strerror}", "give --output a writable place") from error
    try:
        yield output
    except BaseException:
        shutil.rmtree(output, ignore_errors=True)
        raise
