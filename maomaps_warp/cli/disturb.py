"""`maomaps-warp disturb`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from maomaps_warp.cli.options import CameraText, Debug, Device, Format, PoseFrame, Topics, camera_of
from maomaps_warp.errors import InputError


def disturb(
    source: Annotated[Path, typer.Argument(metavar="RUN", help="A bag or RGB-D folder with true poses.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the estimate.")],
    preset: Annotated[str, typer.Option(help="none, rgbd or cnn: what the options below change.")] = "rgbd",
    seed: Annotated[int, typer.Option(min=0, help="Of everything random.")] = 0,
    scale_error: Annotated[float | None, typer.Option(metavar="SHARE", help="By which steps are too long.")] = None,
    yaw_drift: Annotated[float | None, typer.Option(metavar="RAD/M", help="Of the heading's rate.")] = None,
    position_drift: Annotated[float | None, typer.Option(metavar="M/M", help="Of each step, per axis.")] = None,
    closures: Annotated[int | None, typer.Option(metavar="N", help="Loop closures: the pose jumps back.")] = None,
    losses: Annotated[int | None, typer.Option(metavar="N", help="Places where tracking is lost.")] = None,
    loss_length: Annotated[float | None, typer.Option(metavar="M", help="Length of way of each.")] = None,
    keyframe_every: Annotated[int | None, typer.Option(metavar="N", help="Keep one frame of N.")] = None,
    depth_noise: Annotated[float | None, typer.Option(metavar="M", help="At 1 m; grows with its square.")] = None,
    depth_scale_error: Annotated[
        float | None, typer.Option(metavar="SHARE", help="By which depth is too large.")
    ] = None,
    topic: Topics = None,
    format: Format = "auto",
    pose_frame: PoseFrame = "auto",
    camera: CameraText = None,
    device: Device = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the estimate that DIR has.")] = False,
    debug: Debug = False,
) -> None:
    """Make a "SLAM result" with known errors out of a recording: its map and trajectory, to check scores against.

    Writes est_map.pcd, est_trajectory.txt (TUM) and disturbance.json, which says what was done and what came of it.
    """
    from maomaps_warp.cli.terminal import check_device_name, console, progress_clock, quiet_warp, user_errors
    from maomaps_warp.io.sources import SourceOptions, open_source
    from maomaps_warp.jobs import disturb as job

    changes = {
        "scale_error": scale_error,
        "yaw_drift": yaw_drift,
        "position_drift": position_drift,
        "closures": closures,
        "losses": losses,
        "loss_length": loss_length,
        "keyframe_every": keyframe_every,
        "depth_noise": depth_noise,
        "depth_scale_error": depth_scale_error,
    }
    with user_errors(debug):
        check_device_name(device)
        if preset not in job.DISTURBANCES:
            raise InputError(f"--preset {preset}", "no such preset", f"allowed: {', '.join(job.DISTURBANCES)}")
        try:
            given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
            disturbance = replace(job.DISTURBANCES[preset], seed=seed, **given)
        except ValueError as error:
            raise InputError("the disturbance", str(error).split(":")[0], "see --help") from None
        job.check_disturbed_writable(output, overwrite=overwrite)
        reading = SourceOptions(None, tuple(topic or ()), format, pose_frame, camera_of(camera))
        with progress_clock() as clock:
            with clock.stage("read"):
                opened = open_source(source, reading, "one")
            quiet_warp()
            from maomaps_warp.mapping.device import resolve_device

            with clock.stage("start device"):
                used = resolve_device(device, "map")
            made = job.disturb(opened, disturbance, device=used, clock=clock)
            files = job.write_disturbed(output, made, overwrite=overwrite)
        out = console()
        for note in made.notes:
            out.print(f"note    {note}", soft_wrap=True)
        kept, of = made.facts["frames"]["kept"], made.facts["frames"]["of_the_recording"]
        moved, turned = made.facts["position_error_m"], made.facts["rotation_error_deg"]
        out.print(f"frames  {kept} of {of}")
        out.print(f"moved   RMSE {moved['rmse']:.4f} m, {moved['last']:.4f} m at the end")
        out.print(f"turned  RMSE {turned['rmse']:.3f} deg, {turned['last']:.3f} deg at the end")
        for file in files:
            out.print(f"wrote   {file}", soft_wrap=True)
