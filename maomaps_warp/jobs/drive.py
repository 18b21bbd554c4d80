"""A drive through a scene by hand: seen while it goes on, and recorded afterwards, in full quality."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.jobs.run_plan import RecordOptions, free_start, open_world
from maomaps_warp.mapping.depth_samples import DepthLimits
from maomaps_warp.mapping.merging import merge_maps
from maomaps_warp.mapping.voxel_map import build_voxel_map
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap
from maomaps_warp.sim.agent import stamps_at
from maomaps_warp.sim.free_space import FreeSpace, find_free_space
from maomaps_warp.sim.render import MeshSimulator
from maomaps_warp.sim.simulator import Seen
from maomaps_warp.sim.teleop import Key, Teleop
from maomaps_warp.sim.world import World

__all__ = ["Drive", "Glance", "Key", "State"]

State = Literal["waiting", "recording", "done", "left"]

_AFTER_TOGGLE: dict[State, State] = {"waiting": "recording", "recording": "done", "done": "done", "left": "left"}
_AFTER_LEAVING: dict[State, State] = {"waiting": "left", "recording": "done", "done": "done", "left": "left"}
#: The key that begins and ends a run is not listened to again so soon, seconds.
DEBOUNCE_S = 0.7
#: Voxels of the map so far, metres; it takes one of so many glances, and depth up to so many metres.
_MAP_VOXEL_M, _MAP_EVERY, _MAP_RANGE_M = 0.1, 5, 8.0


@dataclass(frozen=True, eq=False)
class Glance:
    """What there is to be shown after a step.

    Attributes:
        seen: images from where the robot is, of the drive's own, small camera.
        T_world_camera: (4, 4), optical frame.
        seconds: recorded so far.
        state: of the drive.
        map: what was seen so far; None where nothing was added to it.
    """

    seen: Seen
    T_world_camera: NDArray[np.float64]
    seconds: float
    state: State
    map: VoxelMap | None


class Drive:
    """A robot in a scene that obeys keys. A run begins and ends with `toggle`, and is left without one by `leave`.

    Args:
        scene: a file, or "flat" or "flat:SEED".
        options: the robot, how it drives, where it starts.
        shown: size of the images to look at meanwhile, columns and rows.
        device: Warp device.
        now: seconds of a clock that keys are timed by.

    Raises:
        InputError: the scene or the start cannot be used.
    """

    def __init__(
        self,
        scene: str,
        options: RecordOptions,
        shown: tuple[int, int],
        *,
        device: str = "cpu",
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.world: World = open_world(scene, options.scene)
        around = None if options.start is None else np.array(options.start)
        self.space: FreeSpace = find_free_space(
            self.world, options.robot, around=around, floor_z=options.floor_z, device=device
        )
        start = free_start(self.world, self.space, options)
        self.robot = Teleop(self.space, options.driving, options.robot.camera_height, start, now=now)
        self.camera = options.camera.resized(*shown)
        self.state: State = "waiting"
        self._now, self._toggled = now, -math.inf
        self._options, self._device = options, device
        quick = replace(options.render, samples=1, with_normals=False, with_parts=False)
        self._simulator = MeshSimulator(self.world, self.camera, device, quick)
        self._poses: list[NDArray[np.float64]] = []
        self._glances = 0
        middle = np.append(start, self.space.floor_z)
        self._grid = VoxelGrid.around(middle[None], _MAP_VOXEL_M)
        self._map: VoxelMap | None = None

    @property
    def step_s(self) -> float:
        """Seconds from one step to the next."""
        return 1.0 / self._options.driving.rate_hz

    def press(self, key: Key) -> None:
        """A key of the robot went down, or is still down."""
        self.robot.press(key)

    def toggle(self) -> None:
        """Begin the run, or end it. A key that is held, or pressed twice by mistake, counts once."""
        before, self._toggled = self._toggled, self._now()
        if self._toggled - before > DEBOUNCE_S:
            self.state = _AFTER_TOGGLE[self.state]

    def leave(self) -> None:
        """End a run that has begun; leave without one that has not."""
        self.state = _AFTER_LEAVING[self.state]

    def step(self, *, with_map: bool = False) -> Glance:
        """Go on by `step_s`, and look."""
        self.robot.step()
        T_world_camera = self.robot.T_world_camera
        if self.state == "recording":
            self._poses.append(T_world_camera)
        seen = self._simulator.see(T_world_camera)
        grown = with_map and self._glances % _MAP_EVERY == 0
        if grown:
            self._grow_map(seen, T_world_camera)
        self._glances += 1
        seconds = max(0, len(self._poses) - 1) * self.step_s
        return Glance(seen, T_world_camera, seconds, self.state, self._map if grown else None)

    @property
    def trajectory(self) -> Trajectory:
        """The run, as it is to be recorded.

        Raises:
            InputError: it is no longer than a moment.
        """
        if len(self._poses) < 2:
            raise InputError("the drive", "nothing was recorded", "a run begins with the key r and ends with it")
        stamps = stamps_at(len(self._poses), self._options.driving.rate_hz)
        return Trajectory(np.stack(self._poses), stamps, "driven by hand", "world")

    def _grow_map(self, seen: Seen, T_world_camera: NDArray[np.float64]) -> None:
        frame = Frame(0, None, seen.depth, seen.colors)
        built = build_voxel_map(
            FrameStream(self.camera, 1, lambda with_colors: iter([frame]), "the drive"),
            lambda frame: T_world_camera,
            self._grid,
            DepthLimits(max_range=_MAP_RANGE_M),
            colors="rounded",
            device=self._device,
        )
        maps = [one for one in (self._map, built.voxels) if one is not None and len(one)]
        self._map = merge_maps(maps) if len(maps) > 1 else (maps[0] if maps else None)
