"""`maomaps-warp record`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from maomaps_warp.cli import EXIT_INTERRUPTED
from maomaps_warp.cli.drive import Where, drive_by_hand, kept_drive
from maomaps_warp.cli.options import CameraText, Debug, Device, PoseFrame
from maomaps_warp.cli.robot_options import (
    Also,
    Antialias,
    BackFaces,
    CameraHeight,
    EffectNames,
    Light,
    Pitch,
    Radius,
    Rate,
    RobotHeight,
    Speed,
    TurnRate,
    robot_options,
)
from maomaps_warp.errors import InputError

#: Share of pixels that see nothing from which on there is a note.
_MOSTLY_EMPTY = 0.5


def record(
    scene: Annotated[str, typer.Argument(help="A .glb, .gltf, .ply or .obj; or flat, flat:SEED: a furnished flat.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="BAG", help="NAME.bag (ROS 1), NAME.mcap or NAME (ROS 2).")
    ],
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="At most; an exploration takes 60, waypoints what they need.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the exploration.")] = 0,
    start: Annotated[str | None, typer.Option(metavar="X,Y", help="Where to start, metres.")] = None,
    waypoint: Annotated[
        list[str] | None, typer.Option(metavar="X,Y", help="Go there by the shortest way; repeatable. Else explore.")
    ] = None,
    trajectory: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Follow these poses exactly (TUM, KITTI, EuRoC, MAOMaps).")
    ] = None,
    pose_frame: PoseFrame = "auto",
    drive: Annotated[Where | None, typer.Option(help="Drive by keys there, instead of exploring.")] = None,
    port: Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="Of the page of --drive browser.")] = 8080,
    camera: CameraText = None,
    antialias: Antialias = 2,
    light: Light = "natural",
    back_faces: BackFaces = "culled",
    also: Also = None,
    effect: EffectNames = None,
    rate: Rate = 10.0,
    speed: Speed = 0.5,
    turn_rate: TurnRate = 45.0,
    radius: Radius = 0.18,
    robot_height: RobotHeight = 1.3,
    camera_height: CameraHeight = 1.0,
    pitch: Pitch = 0.0,
    floor: Annotated[
        float | None, typer.Option(metavar="Z", help="Height of the floor, metres.", show_default="found")
    ] = None,
    up: Annotated[Literal["auto", "y", "z"], typer.Option(help="Axis of the file that points upwards.")] = "auto",
    unit: Annotated[Literal["m", "cm", "mm"], typer.Option(help="Of the file's coordinates.")] = "m",
    drop: Annotated[list[str] | None, typer.Option(metavar="PART", help="Leave this part out; repeatable.")] = None,
    device: Device = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a bag that stands there.")] = False,
    debug: Debug = False,
) -> None:
    """Send a virtual robot through a scene and record RGB, depth and exact poses, as MAOMaps bags have them.

    It explores, goes along waypoints, follows a trajectory, or obeys your keys. Ctrl-C ends the recording; the bag
    holds the frames until then. Exit code 2: the scene or a place cannot be used, or the bag cannot be written.
    """
    given = dict(locals())  # the options alone: nothing else is named yet
    from maomaps_warp.cli.terminal import check_device_name, console, progress_clock, quiet_warp, user_errors
    from maomaps_warp.io.bags.writing import bag_kind, check_new_bag
    from maomaps_warp.jobs import record as job

    with user_errors(debug):
        check_device_name(device)
        _check_alone(trajectory, start, waypoint, drive, duration)
        if trajectory is None and pose_frame != "auto":
            raise InputError(f"--pose-frame {pose_frame}", "given without --trajectory, whose poses it is about")
        places = tuple(_place("--waypoint", text) for text in waypoint or ())
        options = replace(
            robot_options(given),
            duration=None if duration is None else _positive("--duration", duration),
            start=None if start is None else _place("--start", start),
            waypoints=places,
            trajectory=trajectory,
            pose_frame=pose_frame,
            floor_z=_finite("--floor", floor),
            scene=job.SceneOptions(up, unit, tuple(drop or ())),
            overwrite=overwrite,
        )
        quiet_warp()
        from maomaps_warp.mapping.device import resolve_device

        out = console()

        def tell(text: str) -> None:
            out.print(text, soft_wrap=True)

        if drive is None:
            with progress_clock() as clock:
                with clock.stage("start device"):
                    used = resolve_device(device, "render")
                recorded = job.record(scene, output, options, device=used, clock=clock)
        else:
            bag_kind(output)
            check_new_bag(output, overwrite=overwrite)
            used = resolve_device(device, "render", "map")
            driven = drive_by_hand(scene, options, drive, port=port, device=used, tell=tell)
            with kept_drive(driven, tell) as keep, progress_clock() as clock:
                recorded = job.record_world(
                    driven.world,
                    driven.trajectory,
                    output,
                    options,
                    free_area=driven.space.area,
                    device=used,
                    clock=clock,
                )
                if recorded.run.is_stopped:
                    keep()
        for note in recorded.world.notes:
            tell(f"note   {note}")
        area = "" if recorded.free_area is None else f"; {recorded.free_area:.1f} m2 free for the robot"
        triangles, parts = len(recorded.world.triangles), len(recorded.world.parts)
        tell(f"scene  {recorded.world.source}: {triangles} triangles, parts: {parts}{area}")
        run = recorded.run
        way = run.trajectory
        length = f"{len(way)} frames, {way.path_length:.2f} m, {way.duration_s or 0.0:.1f} s"
        tell(f"run    {length}; {100.0 * run.empty:.1f} % of the pixels see nothing")
        if run.empty > _MOSTLY_EMPTY:
            tell("note   the scene is open there, or its faces are seen from behind: see --back-faces, --floor, --up")
        tell(f"wrote  {output}")
        if run.is_stopped:
            tell(f"stopped after {len(way)} of {run.planned} frames")
            raise typer.Exit(EXIT_INTERRUPTED)


def _place(option: str, text: str) -> tuple[float, float]:
    try:
        x, y = (float(word) for word in text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"{option} {text}", "is no place", "give X,Y in metres, as in 1.5,-2")
    return x, y


def _finite(option: str, value: float | None) -> float | None:
    if value is not None and not math.isfinite(value):
        raise InputError(f"{option} {value:g}", "must be a number")
    return value


def _positive(option: str, value: float) -> float:
    if not 0.0 < value < math.inf:
        raise InputError(f"{option} {value:g}", "must be above 0", "give seconds")
    return value


def _check_alone(
    trajectory: Path | None, start: str | None, waypoints: list[str] | None, drive: str | None, duration: float | None
) -> None:
    """Refuse options that would be ignored."""
    beside = {
        "--start": start is not None and trajectory is not None,
        "--waypoint": bool(waypoints),
        "--duration": duration is not None,
        "--trajectory": drive is not None and trajectory is not None,
    }
    ruling = f"--drive {drive}" if drive is not None else f"--trajectory {trajectory}"
    if (drive is not None or trajectory is not None) and any(beside.values()):
        others = " and ".join(option for option, is_given in beside.items() if is_given)
        raise InputError(ruling, f"given beside {others}", "give one or the other")
