"""Recording what a virtual robot sees on its way through a scene."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, current_thread, main_thread
from types import FrameType

import numpy as np

from maomaps_warp.io.bags.writing import bag_kind, check_new_bag
from maomaps_warp.jobs.run_plan import RecordOptions, open_world, plan_run
from maomaps_warp.model.frame import Frame
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.driving import Driving
from maomaps_warp.sim.effects import EFFECTS, NO_EFFECTS, Effects
from maomaps_warp.sim.free_space import Robot
from maomaps_warp.sim.recorder import MAOMAPS_TOPICS, write_rgbd_bag
from maomaps_warp.sim.render import MeshSimulator, RenderOptions
from maomaps_warp.sim.scene_files import SceneOptions
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
