"""`maomaps-warp create-dataset`."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from maomaps_warp.cli.options import CameraText, Debug, Device
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

if TYPE_CHECKING:
    from maomaps_warp.jobs.create_dataset import DatasetSample, SceneEntry

_SCENE_HINT = "SCENE,floor=Z,drop=PART,unit=cm,up=z,duration=LO..HI; drop may come more than once"


def create_dataset(
    scenes: Annotated[
        list[str],
        typer.Argument(
            metavar="SCENE...",
            help="As in `record`; SCENE,floor=Z,drop=PART,unit=cm,up=z,duration=LO..HI says what holds for it alone.",
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DATASET", help="Folder for the samples.")],
    samples: Annotated[int, typer.Option(metavar="N", min=1, help="How many, in turn from the scenes.")] = 20,
    iou: Annotated[str, typer.Option(metavar="LO..HI", help="Overlap of the two runs of a sample.")] = "0.2..0.6",
    iou_of: Annotated[
        Literal["voxels", "known", "obstacle"], typer.Option(help="What of the maps is compared; see `describe`.")
    ] = "voxels",
    duration: Annotated[str, typer.Option(metavar="LO..HI", help="Seconds of a run.")] = "20..60",
    seed: Annotated[int, typer.Option(min=0, help="Of everything random.")] = 0,
    bags: Annotated[Literal["ros1", "mcap", "ros2"], typer.Option(help="Kind of the bags.")] = "ros1",
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
    device: Device = "auto",
    debug: Debug = False,
) -> None:
    """Make a dataset: samples of two overlapping runs each, with bags, maps, the merged map, poses and the IoU.

    Interrupted, it goes on where it was when the same command is given again; the same options and seed give the same
    bytes. Exit code 2: a scene cannot be used, or no runs through it overlap as asked.
    """
    given = dict(locals())  # the options alone: nothing else is named yet
    from maomaps_warp.cli.terminal import check_device_name, console, progress_clock, quiet_warp, user_errors
    from maomaps_warp.io.bags.writing import SUFFIXES
    from maomaps_warp.jobs import create_dataset as job
    from maomaps_warp.jobs.describe import describe_dataset
    from maomaps_warp.report.dataset_table import dataset_tables

    with user_errors(debug):
        check_device_name(device)
        robot = robot_options(given)
        try:
            options = job.DatasetOptions(
                scenes=tuple(_scene(text) for text in scenes),
                robot=robot,
                samples=samples,
                iou=_range(f"--iou {iou}", iou),
                kind=iou_of,
                duration=_range(f"--duration {duration}", duration),
                seed=seed,
                suffix=SUFFIXES[bags],
            )
        except ValueError as error:
            raise InputError("the dataset's options", str(error), "see --help") from None
        quiet_warp()
        from maomaps_warp.mapping.device import resolve_device

        out, told = console(), _Told(samples)
        try:
            with progress_clock(out) as clock:
                with clock.stage("start device"):
                    used = resolve_device(device, "render", "map")
                made = job.create_dataset(
                    output, options, device=used, clock=clock, tell=lambda sample: clock.say(told.line(sample))
                )
        except KeyboardInterrupt:
            out.print(f"stopped after {told.seen} of {samples} samples; the same command goes on from there")
            raise
        with progress_clock() as clock:
            table = describe_dataset(output, voxel_size=job.VOXEL_SIZE, ground="robust", clock=clock)
        for part in dataset_tables(table):
            out.print(part, soft_wrap=isinstance(part, str))
        fresh = sum(not sample.was_there for sample in made)
        out.print(f"wrote {fresh} samples to {output}; {len(made) - fresh} were there", soft_wrap=True)


class _Told:
    """A line for each sample, with the time that the others will take."""

    def __init__(self, samples: int) -> None:
        self.seen = 0
        self._samples, self._made, self._start = samples, 0, time.monotonic()
        self._scenes: set[str] = set()

    def line(self, sample: DatasetSample) -> str:
        self.seen += 1
        iou: dict[str, Any] = sample.facts["iou"]
        notes = [f"note      {sample.facts['scene']}: {note}\n" for note in sample.facts["scene_notes"]]
        heading = "" if sample.facts["scene"] in self._scenes else "".join(notes)
        self._scenes.add(sample.facts["scene"])
        text = heading + f"{sample.name:<9} {sample.facts['scene']}: IoU {iou[iou['of']]:.3f} ({iou['of']})"
        if sample.was_there:
            return f"{text}, was there"
        self._made += 1
        left = (time.monotonic() - self._start) / self._made * (self._samples - self.seen)
        tries = f", {iou['tries']} tries" if iou["tries"] > 1 else ""
        return text + tries + (f"; about {math.ceil(left / 60)} min left" if self.seen < self._samples else "")


def _scene(text: str) -> SceneEntry:
    """A scene with its own options, as in "house.glb,floor=0,drop=ground"."""
    from maomaps_warp.jobs.create_dataset import SceneEntry
    from maomaps_warp.jobs.record import SceneOptions

    name, *words = [text] if Path(text).exists() else text.split(",")
    given: dict[str, list[str]] = {}
    for word in words:
        key, _, value = word.partition("=")
        given.setdefault(key, []).append(value)
    allowed: dict[str, tuple[str, ...]] = {"up": ("auto", "y", "z"), "unit": ("m", "cm", "mm")}
    for key, values in given.items():
        if key not in ("floor", "drop", "duration", *allowed) or (key != "drop" and len(values) > 1):
            raise InputError(text, f"{key!r} is said twice, or is no option of a scene", _SCENE_HINT)
        if key in allowed and values[0] not in allowed[key]:
            raise InputError(text, f"{key} cannot be {values[0]!r}", f"allowed: {', '.join(allowed[key])}")
    floor = given.get("floor")
    options: Any = {key: given[key][0] for key in allowed if key in given}
    return SceneEntry(
        name,
        SceneOptions(**options, drop=tuple(given.get("drop", ()))),
        None if floor is None else _number(text, "floor", floor[0]),
        _range(text, given["duration"][0]) if "duration" in given else None,
    )


def _range(place: str, text: str) -> tuple[float, float]:
    """Two numbers of "0.2..0.6"."""
    low, dots, high = text.partition("..")
    if not dots:
        raise InputError(place, f"{text!r} is no range", "give LO..HI, as in 0.2..0.6")
    return _number(place, "the range", low), _number(place, "the range", high)


def _number(place: str, what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(place, f"{what} holds {text!r}, which is no number")
    return value
