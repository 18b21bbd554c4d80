"""Where a virtual robot goes: the scene, its free space, and a way through it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.trajectories import read_trajectory
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.agent import stamps_at
from maomaps_warp.sim.driving import Driving, drive_along
from maomaps_warp.sim.effects import NO_EFFECTS, Effects
from maomaps_warp.sim.free_space import FreeSpace, Robot, find_free_space
from maomaps_warp.sim.planning import Planner, rounded
from maomaps_warp.sim.render import RenderOptions
from maomaps_warp.sim.scene import furnished_flat
from maomaps_warp.sim.scene_files import SceneOptions, read_world
from maomaps_warp.sim.world import World
from maomaps_warp.stopwatch import Stopwatch

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


def _followed(options: RecordOptions) -> Trajectory:
    assert options.trajectory is not None
    trajectory = read_trajectory(options.trajectory, pose_frame=options.pose_frame)
    if trajectory.stamps_ns is None:
        trajectory = replace(trajectory, stamps_ns=stamps_at(len(trajectory), options.driving.rate_hz))
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
