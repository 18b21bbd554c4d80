"""Options of the commands that send a virtual robot through scenes, and what they add up to."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from maomaps_warp.cli.options import camera_of
from maomaps_warp.errors import InputError

if TYPE_CHECKING:
    from maomaps_warp.jobs.record import RecordOptions

Antialias = Annotated[int, typer.Option(metavar="N", min=1, max=8, help="Colours are the mean of N x N rays a pixel.")]
Light = Annotated[Literal["natural", "flat"], typer.Option(help="flat: the scene's colours as they are.")]
BackFaces = Annotated[
    Literal["culled", "seen"], typer.Option(help="Of one-sided materials; culled is what Habitat does.")
]
Also = Annotated[list[str] | None, typer.Option(metavar="normals|parts", help="Record these images, too; repeatable.")]
EffectNames = Annotated[
    list[str] | None,
    typer.Option(
        metavar="kinect|cnn|blur|shake",
        help="Depth of a Kinect or of a network, blur of motion, a trembling camera; repeatable.",
    ),
]
Rate = Annotated[float, typer.Option(metavar="HZ", help="Frames per second.")]
Speed = Annotated[float, typer.Option(metavar="M/S", help="At most.")]
TurnRate = Annotated[float, typer.Option(metavar="DEG/S", help="At most.")]
Radius = Annotated[float, typer.Option(metavar="M", help="Of the robot.")]
RobotHeight = Annotated[float, typer.Option(metavar="M", help="Of the robot's top.")]
CameraHeight = Annotated[float, typer.Option(metavar="M", help="Of the camera.")]
Pitch = Annotated[float, typer.Option(metavar="DEG", help="Of the camera, upwards.")]


#: Of an image: what memory holds.
_MOST_PIXELS = 10**8


def robot_options(given: Mapping[str, Any]) -> RecordOptions:
    """What a robot is, how it drives, and what its camera sees.

    Args:
        given: values of a command's options: those above by their names, `camera` and `seed`; others do not matter.

    Raises:
        InputError: naming what is out of range.
    """
    from maomaps_warp.jobs import record as job

    lens = camera_of(given["camera"])
    if lens is not None and lens.width * lens.height > _MOST_PIXELS:
        raise InputError(f"--camera {given['camera']}", f"has {lens.width * lens.height:.3g} pixels", "at most 1e8")
    also = given["also"] or ()
    for name in also:
        if name not in ("normals", "parts"):
            raise InputError(f"--also {name}", "no such images", "normals, or parts")
    try:
        options = job.RecordOptions(
            robot=job.Robot(given["radius"], given["robot_height"], given["camera_height"]),
            driving=job.Driving(
                given["speed"], math.radians(given["turn_rate"]), given["rate"], math.radians(given["pitch"])
            ),
            seed=given["seed"],
            render=job.RenderOptions(
                samples=given["antialias"],
                is_lit=given["light"] == "natural",
                are_back_faces_seen=given["back_faces"] == "seen",
                with_normals="normals" in also,
                with_parts="parts" in also,
            ),
            effects=job.Effects.of(given["effect"] or (), given["seed"]),
        )
    except ValueError as error:
        raise InputError("the robot's options", str(error), "see --help") from None
    return options if lens is None else replace(options, camera=lens)
