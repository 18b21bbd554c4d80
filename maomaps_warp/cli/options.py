"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from maomaps_warp.errors import InputError

if TYPE_CHECKING:
    from maomaps_warp.model.camera import Camera

Topics = Annotated[list[str] | None, typer.Option(metavar="TOPIC", help="A bag's topic to use; repeatable.")]
Format = Annotated[
    str, typer.Option(help="Read it as: tum, kitti, euroc, maomaps, pcd, ply, xyz, npz, bag, sample, tum-rgbd, ...")
]
PoseFrame = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="What the recorded poses mean: optical (the camera's, z forward), body (x forward, z up), opengl, each "
        "with -inverse and -wxyz; maomaps-a, -b, -c, with :RAD or :sampleN a yaw correction. See `check`.",
    ),
]
CameraText = Annotated[str | None, typer.Option(help="320x240@90, WxH:fx,fy,cx,cy, or a ROS calibration YAML.")]
YawCorrection = Annotated[
    str | None,
    typer.Option(metavar="RAD", help="Added to the yaw of a start pose: radians, or sample1 to sample20 of MAOMaps."),
]
Run = Annotated[str | None, typer.Option(help="Run of a MAOMaps sample directory: first, second, ...")]
Device = Annotated[str, typer.Option(help="auto, cpu or cuda:N.")]
JsonFile = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write everything as JSON.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def yaw_of(text: str | None) -> float | None:
    """Radians of `--yaw-correction`.

    Raises:
        InputError: no number and no sample of MAOMaps.
    """
    from maomaps_warp.model.pose_convention import parse_yaw_correction

    if text is None:
        return None
    try:
        return parse_yaw_correction(text)
    except ValueError as error:
        raise InputError(f"--yaw-correction {text}", str(error)) from None


def camera_of(text: str | None) -> Camera | None:
    """The camera of `--camera`.

    Raises:
        InputError: it describes none.
    """
    from maomaps_warp.io.cameras import parse_camera

    return None if text is None else parse_camera(text)
