"""A robot that somebody drives by keys."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.sim.agent import looking
from maomaps_warp.sim.driving import Driving
from maomaps_warp.sim.free_space import FreeSpace

Key = Literal["forward", "back", "left", "right", "stop"]

#: A key counts as held so long after it was last heard of, seconds: terminals and browsers repeat a key that is held,
#: the first time after about half a second.
HOLD_S = 0.6
#: How fast speed grows and falls, metres per second squared; of turning, radians per second squared.
_ACCELERATION, _TURN_ACCELERATION = 1.0, 3.0
#: Walls are looked at through a Gaussian of so many cells: those that run across the grid are flights of steps.
_SMOOTHING_CELLS = 2.0
#: Less of the way than this share goes along the wall: it is met head-on, and the robot stands.
_LEAST_SLIDE = 0.2
#: Of sums of steps; far below any speed.
_ROUNDING = 1e-9
#: Way is looked at in steps so long, metres: shorter than a cell of the free space.
_STEP_M = 0.01


class Teleop:
    """Where the robot is, and what its keys make of it. It never leaves the free space.

    It slides along walls, and stands before one that it meets head-on.

    Args:
        space: where it can go.
        driving: greatest speeds; steps per second; pitch of the camera.
        camera_height: metres above the floor.
        start: (2,) metres, free.
        now: seconds of a clock that keys are timed by.
    """

    def __init__(
        self,
        space: FreeSpace,
        driving: Driving,
        camera_height: float,
        start: NDArray[np.float64],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.place = np.array(start, dtype=np.float64)
        self.yaw = self.speed = self.turn_rate = 0.0
        self._space, self._driving, self._camera_height = space, driving, camera_height
        self._uphill = _uphill(space)
        self._heard: dict[Key, float] = {}
        self._fresh: set[Key] = set()
        self._now = now

    def press(self, key: Key) -> None:
        """A key went down, or is still down; "stop" forgets all others."""
        if key == "stop":
            self._heard.clear()
            self._fresh.clear()
        else:
            self._heard[key] = self._now()
            self._fresh.add(key)

    def step(self) -> None:
        """Go on by one step of 1 / rate seconds."""
        seconds = 1.0 / self._driving.rate_hz
        wanted = self._driving.speed * (self._holds("forward") - self._holds("back"))
        turning = self._driving.turn_rate * (self._holds("left") - self._holds("right"))
        self.speed = _towards(self.speed, wanted, _ACCELERATION * seconds)
        self.turn_rate = _towards(self.turn_rate, turning, _TURN_ACCELERATION * seconds)
        self.yaw += self.turn_rate * seconds
        ahead = self.speed * seconds * np.array([np.cos(self.yaw), np.sin(self.yaw)])
        self._fresh.clear()
        self._go(ahead)

    @property
    def T_world_camera(self) -> NDArray[np.float64]:
        """(4, 4), optical frame."""
        position = np.append(self.place, self._space.floor_z + self._camera_height)
        return np.asarray(looking(position[None], np.array([self.yaw]), np.array([self._driving.pitch]))[0])

    def _holds(self, key: Key) -> bool:
        # However long a step is, a key that was pressed since the last one counts for one.
        return key in self._fresh or self._now() - self._heard.get(key, -np.inf) <= HOLD_S

    def _go(self, way: NDArray[np.float64]) -> None:
        steps = int(np.ceil(np.linalg.norm(way) / _STEP_M))
        for _ in range(steps):
            part = way / steps
            free = next((move for move in self._tries(part) if self._is_free(self.place + move)), None)
            if free is None:
                self.speed = 0.0
                return
            self.place = self.place + free

    def _tries(self, move: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
        """Straight on; else along the wall, or past a step of it: more and more away, in the end only away."""
        yield move
        away = self._uphill[tuple(self._space.cell_of(self.place))]
        along = move - min(0.0, float(move @ away)) * away
        length = float(np.linalg.norm(move))
        if np.linalg.norm(along) >= _LEAST_SLIDE * length:
            yield from (along + share * length * away for share in (0.0, 0.5, 1.0))
            yield length * away

    def _is_free(self, place: NDArray[np.float64]) -> bool:
        return bool(self._space.holds(place[None])[0])


def _uphill(space: FreeSpace) -> NDArray[np.float64]:
    """In each cell of a free space the direction away from the walls, (nx, ny, 2), unit vectors."""
    from scipy import ndimage

    free = np.pad(space.is_free, 1)
    # Signed, so that it has a slope at the wall itself.
    clearance = ndimage.distance_transform_edt(free) - ndimage.distance_transform_edt(~free)
    slope = np.stack(np.gradient(ndimage.gaussian_filter(clearance, _SMOOTHING_CELLS)), axis=-1)[1:-1, 1:-1]
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-9))


def _towards(value: float, goal: float, step: float) -> float:
    """One step nearer to the goal, and exactly there in the end."""
    return goal if abs(goal - value) <= step + _ROUNDING else value + float(np.copysign(step, goal - value))
