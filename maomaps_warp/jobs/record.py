"""Recording what a virtual robot sees on its way through a scene."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event, current_thread, main_thread
from types import FrameType

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.writing import bag_kind, check_new_bag
from maomaps_warp.io.trajectories import read_trajectory
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.agent import START_NS
from maomaps_warp.sim.driving import Driving, drive_along
from maomaps_warp.sim.effects import EFFECTS, NO_EFFECTS, Effects
from maomaps_warp.sim.free_space import FreeSpace, Robot, find_free_space
from maomaps_warp.sim.planning import Planner, rounded
from maomaps_warp.sim.recorder import MAOMAPS_TOPICS, write_rgbd_bag
from maomaps_warp.sim.render import MeshSimulator, RenderOptions
from maomaps_warp.sim.scene import furnished_flat
from maomaps_warp.sim.scene_files import SceneOptions, read_world
from maomaps_warp.sim.simulator import EXACT_DEPTH, Simulator, camera_path, simulated_frames
from maomaps_warp.sim.world import World
from maomaps_warp.stopwatch import Stopwatch

__all__ = [
    "EFFECTS",
    "Driving",
    "Effects",
    "RecordOptions",
    "Recorded",
    "RecordedRun",
    "RenderOptions",
    "Robot",
    "SceneOptions",
    "driven",
    "free_start",
    "is_flat",
    "open_world",
    "plan_run",
    "record",
    "record_simulator",
    "record_world",
]

#: What ends a recording early; a system may lack some.
_STOPPING_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
#: progress(done, total).
Progress = Callable[[int, int | None], None]

#: How long an exploration takes if nobody says it, seconds.
DEFAULT_DURATION_S = 60.0
#: What names a built-in scene: "flat", or "flat:3" for that of another seed.
FLAT = "flat"


@dataclass(frozen=True)
class RecordOptions:
    """What a robot is, where it goes, and what its camera sees.

    Attributes:
        camera: of the images.
        robot: its size.
        driving: its speeds; the poses' rate.
        duration: seconds, at most; None: of an exploration DEFAULT_DURATION_S, of waypoints what they take.
        seed: of the exploration.
        start: x and y, metres; None: the first of several waypoints, else the free place nearest to the scene's middle.
        waypoints: (x, y), metres: shortest ways from the start to each in turn; none: explore.
        trajectory: a file of poses to follow exactly, instead of driving.
        pose_frame: what the file's poses mean.
        floor_z: height of the floor, metres; None: found.
        scene: how a scene's file is read.
        render: how images are rendered.
        effects: what spoils them.
        overwrite: replace a bag.
    """

    camera: Camera = field(default_factory=lambda: Camera.from_fov(320, 240, 90.0))
    robot: Robot = field(default_factory=Robot)
    driving: Driving = field(default_factory=Driving)
    duration: float | None = None
    seed: int = 0
    start: tuple[float, float] | None = None
    waypoints: tuple[tuple[float, float], ...] = ()
    trajectory: Path | None = None
    pose_frame: str = "auto"
    floor_z: float | None = None
    scene: SceneOptions = field(default_factory=SceneOptions)
    render: RenderOptions = field(default_factory=lambda: RenderOptions(samples=2))
    effects: Effects = NO_EFFECTS
    overwrite: bool = False

    @property
    def places(self) -> tuple[tuple[float, float], ...]:
        """The start, if it is given, and the waypoints."""
        return self.waypoints if self.start is None else (self.start, *self.waypoints)


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """What a bag holds that was recorded.

    Attributes:
        trajectory: poses of its frames.
        planned: how many frames there would have been.
        is_stopped: whether Ctrl-C was pressed; then there may be fewer.
        empty: share of the pixels that see nothing.
    """

    trajectory: Trajectory
    planned: int
    is_stopped: bool
    empty: float


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording that was made.

    Attributes:
        run: what was recorded.
        world: what was seen.
        free_area: square metres in which the robot could go; None where it followed a file.
    """

    run: RecordedRun
    world: World
    free_area: float | None


def record(
    scene: str, output: Path, options: RecordOptions, *, device: str = "cpu", clock: Stopwatch | None = None
) -> Recorded:
    """Send a robot through a scene and record what its camera sees, with exact poses, in the form of MAOMaps bags.

    Args:
        scene: a file, or "flat" or "flat:SEED", the built-in furnished flat.
        output: NAME.bag (ROS 1), NAME.mcap (ROS 2, one file) or NAME (ROS 2, a folder).
        options: see there.
        device: Warp device.
        clock: collects the stages' times.

    Raises:
        InputError: the scene or a place cannot be used, or the bag cannot be written.
    """
    clock = clock or Stopwatch()
    bag_kind(output)
    check_new_bag(output, overwrite=options.overwrite)
    with clock.stage("read scene"):
        world = open_world(scene, options.scene)
    trajectory, free_area = plan_run(world, options, device=device, clock=clock)
    return record_world(world, trajectory, output, options, free_area=free_area, device=device, clock=clock)


def plan_run(
    world: World, options: RecordOptions, *, device: str = "cpu", clock: Stopwatch | None = None
) -> tuple[Trajectory, float | None]:
    """Where the camera of a robot goes through a world.

    Returns:
        Its poses, with stamps, without the shaking of `options.effects`; and the square metres that are free for the
        robot, None where it follows a file.

    Raises:
        InputError: there is no free space, a place is not free, or the file of poses cannot be used.
    """
    clock = clock or Stopwatch()
    if options.trajectory is not None:
        return _followed(options), None
    with clock.stage("free space"):
        around = np.array(options.places[0]) if options.places else None
        space = find_free_space(world, options.robot, around=around, floor_z=options.floor_z, device=device)
    with clock.stage("plan"):
        return _planned(world, space, options), space.area


def record_world(
    world: World,
    trajectory: Trajectory,
    output: Path,
    options: RecordOptions,
    *,
    free_area: float | None = None,
    device: str = "cpu",
    clock: Stopwatch | None = None,
) -> Recorded:
    """Record what a robot on a trajectory sees of a world; see `record`."""
    clock = clock or Stopwatch()
    simulator = MeshSimulator(world, options.camera, device, options.render)
    names = world.parts if options.render.with_parts else ()
    with clock.stage("record") as progress:
        run = record_simulator(
            simulator,
            trajectory,
            output,
            effects=options.effects,
            part_names=names,
            overwrite=options.overwrite,
            progress=progress,
        )
    return Recorded(run, world, free_area)


def record_simulator(
    simulator: Simulator,
    trajectory: Trajectory,
    output: Path,
    *,
    effects: Effects = NO_EFFECTS,
    part_names: Sequence[str] = (),
    overwrite: bool = False,
    progress: Progress | None = None,
) -> RecordedRun:
    """Record what a simulator shows along a trajectory, as MAOMaps bags have it.

    The first Ctrl-C closes the bag after the frame that it is at; the second leaves nothing.

    Args:
        simulator: gives the images; any object with `camera`, `source` and `see`.
        trajectory: the robot's camera's poses, with stamps; `effects` may shake it.
        output: NAME.bag (ROS 1), NAME.mcap (ROS 2, one file) or NAME (ROS 2, a folder).
        effects: what spoils the images.
        part_names: what the numbers in images of parts mean.
        overwrite: replace a bag.
        progress: told how many frames there are (done, total).

    Returns:
        What was recorded.

    Raises:
        InputError: the bag cannot be written.
        ValueError: poses without stamps, or images of a wrong shape or type.
    """
    frames = empty = 0
    trajectory = camera_path(trajectory, effects)
    stream = simulated_frames(simulator, trajectory, effects)

    def read(with_colors: bool) -> Iterator[Frame]:
        nonlocal frames, empty
        for frame in stream.read(with_colors):
            frames += 1
            empty += int(np.count_nonzero(frame.extras.get(EXACT_DEPTH, frame.depth) == 0.0))
            yield frame
            if progress is not None:
                progress(frames, len(trajectory))

    with _asked_to_stop() as stop:
        write_rgbd_bag(
            output,
            replace(stream, read=read),
            trajectory,
            kind=bag_kind(output),
            topics=MAOMAPS_TOPICS,
            part_names=part_names,
            stop=stop,
            overwrite=overwrite,
        )
    pixels = max(1, frames * simulator.camera.width * simulator.camera.height)
    recorded = trajectory.select(np.arange(frames))
    return RecordedRun(recorded, len(trajectory), stop.is_set(), empty / pixels)


@contextmanager
def _asked_to_stop() -> Iterator[Event]:
    """Set by the first Ctrl-C (or SIGTERM, SIGHUP), so that the bag is closed; the second does what it always does."""
    asked = Event()
    if current_thread() is not main_thread():
        yield asked
        return
    before = {number: signal.getsignal(number) for number in _STOPPING_SIGNALS}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def stop(_number: int, _frame: FrameType | None) -> None:
        asked.set()
        restore()

    for number in before:
        signal.signal(number, stop)
    try:
        yield asked
    finally:
        restore()


def open_world(scene: str, options: SceneOptions) -> World:
    """The world of a scene's file, or of "flat" or "flat:SEED".

    Raises:
        InputError: there is no such scene, or it cannot be used.
    """
    if is_flat(scene):
        if options != SceneOptions():
            raise InputError(
                scene, "is built in: there is no file whose up, unit or parts could be chosen", "leave them out"
            )
        _, colon, seed = scene.partition(":")
        if colon and not seed.isdecimal():
            raise InputError(scene, f"{seed!r} is no seed", "flat:SEED takes a whole number, flat is flat:0")
        return furnished_flat(int(seed) if colon else 0).world
    return read_world(Path(scene), options)


def is_flat(scene: str) -> bool:
    """Whether a name stands for a built-in flat, not for a file."""
    return scene.partition(":")[0] == FLAT and not Path(scene).exists()


def _followed(options: RecordOptions) -> Trajectory:
    assert options.trajectory is not None
    trajectory = read_trajectory(options.trajectory, pose_frame=options.pose_frame)
    if trajectory.stamps_ns is None:
        steps = np.rint(np.arange(len(trajectory)) * (1e9 / options.driving.rate_hz)).astype(np.int64)
        trajectory = replace(trajectory, stamps_ns=START_NS + steps)
    return trajectory


def _planned(world: World, space: FreeSpace, options: RecordOptions) -> Trajectory:
    planner, duration = Planner(space), options.duration
    wanted = [_free_place(space, np.array(place), options.robot) for place in options.places]
    if options.start is None and len(wanted) < 2:
        wanted = [free_start(world, space, options), *wanted]
    if options.waypoints:
        way = planner.along(np.stack(wanted))
    else:
        duration = duration or DEFAULT_DURATION_S
        way = planner.exploration(wanted[0], options.driving.speed * duration, options.seed)
    if len(way) < 2:
        raise InputError("--waypoint", "all of them are one place", "give two places, or none to explore")
    return driven(way, space, options, duration)


def driven(way: NDArray[np.float64], space: FreeSpace, options: RecordOptions, duration: float | None) -> Trajectory:
    """The camera's poses on a way, (K, 2) metres, cell by cell; for so many seconds at most, None: to its end."""
    height = space.floor_z + options.robot.camera_height
    return drive_along(rounded(way, space), height, options.driving, duration)


def free_start(world: World, space: FreeSpace, options: RecordOptions) -> NDArray[np.float64]:
    """The start of the options, (2,) metres, else the free place nearest to the scene's middle.

    Raises:
        InputError: the start is not free.
    """
    if options.start is None:
        return space.nearest(world.bounds[:, :2].mean(axis=0))
    return _free_place(space, np.array(options.start), options.robot)


def _free_place(space: FreeSpace, place: NDArray[np.float64], robot: Robot) -> NDArray[np.float64]:
    if not space.holds(place[None])[0]:
        nearest = space.nearest(place)
        raise InputError(
            f"({place[0]:g}, {place[1]:g})",
            f"no place for a robot of radius {robot.radius:g} m, or cut off from the others or the largest free space",
            f"the nearest free place is ({nearest[0]:.2f}, {nearest[1]:.2f})",
        )
    return place
