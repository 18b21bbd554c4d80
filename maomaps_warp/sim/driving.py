"""Cameras on a robot that follows a way: smooth in heading, never too fast, never turning too fast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.agent import looking, stamps_at
from maomaps_warp.sim.planning import WAY_STEP_M
from maomaps_warp.sim.tracks import smoothed

#: How far the gaze lags and leads in a bend, standard deviation, metres.
_HEADING_SMOOTHING_M = 0.3
#: Over so much time speed grows from standstill, seconds.
_START_S = 0.5


@dataclass(frozen=True)
class Driving:
    """How a robot drives.

    Attributes:
        speed: metres per second, at most.
        turn_rate: radians per second, at most.
        rate_hz: poses per second.
        pitch: of the camera, radians, upwards.
    """

    speed: float = 0.5
    turn_rate: float = float(np.radians(45.0))
    rate_hz: float = 10.0
    pitch: float = 0.0

    def __post_init__(self) -> None:
        rates = (self.speed, self.turn_rate, self.rate_hz)
        if not (all(0.0 < rate < np.inf for rate in rates) and abs(self.pitch) < np.pi / 2):
            found = f"{self.speed:g} m/s, {np.degrees(self.turn_rate):g} deg/s, {self.rate_hz:g} Hz"
            found += f", {np.degrees(self.pitch):g} deg"
            raise ValueError(f"speed, turn rate and rate must be positive, the pitch within 90 degrees: {found}")


def drive_along(way: NDArray[np.float64], height: float, driving: Driving, duration: float | None = None) -> Trajectory:
    """Poses of the camera of a robot on a way.

    The camera looks along the way, at its start and end, too. Where the way bends, the robot is so slow that it turns
    no faster than it may.

    Args:
        way: (K, 2) float64, metres, points about `WAY_STEP_M` apart, as `rounded` returns them.
        height: of the camera, metres, world.
        driving: speeds.
        duration: seconds; the drive ends there, or at the end of the way if that comes first. None: at its end.

    Returns:
        Poses of the optical frame (x right, y down, z forward), with stamps.
    """
    yaw = _heading(way)
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    slowest = np.maximum(steps / driving.speed, np.abs(np.diff(yaw)) / driving.turn_rate)
    # A mean over neighbours may be faster than the slowest of them: never below it.
    per_step = np.maximum(smoothed(slowest[:, None], 10.0)[:, 0], slowest)
    times = np.concatenate([[0.0], np.cumsum(per_step)])
    end = times[-1] + 0.5 * _START_S
    if duration is not None:
        end = min(end, duration)
    count = int(np.floor(end * driving.rate_hz + 1e-9)) + 1
    seconds = np.arange(count) / driving.rate_hz
    # Eased in: the clock of the way runs slowly at first. It loses half of the time that takes.
    eased = np.where(seconds < _START_S, 0.5 * seconds**2 / _START_S, seconds - 0.5 * _START_S)
    at = np.interp(eased, times, np.arange(len(way)))
    x, y, turned = (np.interp(at, np.arange(len(way)), track) for track in (way[:, 0], way[:, 1], yaw))
    positions = np.stack([x, y, np.full(count, height)], axis=1)
    stamps = stamps_at(count, driving.rate_hz)
    return Trajectory(looking(positions, turned, np.full(count, driving.pitch)), stamps, "simulated drive", "world")


def _heading(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Direction of a way at each of its points, radians, smoothed and without jumps."""
    step = np.gradient(way, axis=0)
    raw = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    return smoothed(raw[:, None], _HEADING_SMOOTHING_M / WAY_STEP_M)[:, 0]
