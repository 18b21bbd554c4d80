"""Drives a camera through a scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.scene import Scene
from maomaps_warp.sim.tracks import resampled, smoothed

#: Stamp of the first pose, nanoseconds since 1970: a plausible date, the same on every run.
START_NS = 1_700_000_000_000_000_000

#: Step of the path's samples, metres.
_STEP = 0.01
#: How far corners of the tour are rounded, and how far the gaze lags and leads in a bend; standard
#: deviations, metres.
_CORNER_ROUNDING = 0.22
_HEADING_SMOOTHING = 0.45
#: The gaze sweeps to both sides of the way, radians, so many times a round: not once a room, or else each
#: would be seen from the same side.
_SWEEP = 0.75
_SWEEPS = 5
#: Greatest turn rate about the vertical, radians per second; pitch adds to it.
_TURN_RATE = np.radians(50.0)
#: Mean pitch (negative looks down) and its swing, radians; swing of the height, metres.
_PITCH = np.radians(-8.0)
_PITCH_SWING = np.radians(5.0)
_BOB = 0.012


def drive(scene: Scene, *, frames: int = 240, rate_hz: float = 10.0, seed: int = 0, height: float = 1.2) -> Trajectory:
    """One round through all rooms of a scene, from the middle of its first room and back to it.

    The camera looks along the way, sweeping to both sides, slightly downwards, and slows down where it
    turns: it never turns faster than 60 degrees per second.

    Args:
        scene: whose tour is followed.
        frames: how many poses.
        rate_hz: poses per second; frames / rate_hz is the duration.
        seed: of the sweeping, the swing of pitch and height.
        height: of the camera above the floor, metres.

    Returns:
        Poses of the optical frame (x right, y down, z forward) with stamps.

    Raises:
        ValueError: the duration is too short for the round at the greatest turn rate.
    """
    if frames < 2 or not rate_hz > 0.0:
        raise ValueError(f"a drive needs at least 2 frames and a positive rate, got {frames} at {rate_hz} Hz")
    way = _rounded_way(scene.tour)
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 3)
    turn = np.linspace(0.0, 2.0 * np.pi, len(way))
    yaw = _heading(way) + _SWEEP * np.sin(_SWEEPS * turn + phases[0])
    pitch = _PITCH + _PITCH_SWING * np.sin(5.0 * turn + phases[1])
    z = scene.floor_z + height + _BOB * np.sin(23.0 * turn + phases[2])

    times = _times(yaw, (frames - 1) / rate_hz)
    at = np.interp(np.linspace(0.0, times[-1], frames), times, np.arange(len(way)))
    x, y, z, yaw, pitch = (np.interp(at, np.arange(len(way)), track) for track in (way[:, 0], way[:, 1], z, yaw, pitch))
    stamps = stamps_at(frames, rate_hz)
    return Trajectory(looking(np.stack([x, y, z], axis=1), yaw, pitch), stamps, "simulated drive", "world")


def _rounded_way(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points of the closed polygon, about `_STEP` apart, corners rounded; the last one equals the first."""
    smooth = smoothed(resampled(corners, _STEP, closed=True), _CORNER_ROUNDING / _STEP, closed=True)
    return np.vstack([smooth, smooth[:1]])


def _heading(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Direction of the closed way at each of its points, radians, smoothed and without jumps."""
    step = np.diff(way, axis=0)
    raw = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    total = 2.0 * np.pi * np.rint((raw[-1] - raw[0]) / (2.0 * np.pi))
    ramp = np.linspace(0.0, total, len(way))
    # What is left after the ramp is periodic and can be smoothed round the corner.
    smooth = smoothed((raw - ramp[:-1])[:, None], _HEADING_SMOOTHING / _STEP, closed=True)[:, 0]
    return np.append(smooth, smooth[0]) + ramp


def _times(yaw: NDArray[np.float64], duration: float) -> NDArray[np.float64]:
    """Seconds at which the points of the way are passed: one speed, except where that would turn too fast."""
    turning = np.abs(np.diff(yaw)) / _TURN_RATE
    if turning.sum() >= duration:
        raise ValueError(
            f"the round needs more than {turning.sum():.1f} s, got {duration:.1f} s: raise frames or lower rate_hz"
        )
    # The time per step that makes the sum right lies between 0 and the mean; the sum grows with it.
    low, high = 0.0, duration / len(turning)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if np.maximum(turning, middle).sum() > duration else (middle, high)
    per_step = smoothed(np.maximum(turning, high)[:, None], 0.05 / _STEP, closed=True)[:, 0]
    return np.concatenate([[0.0], np.cumsum(per_step)])


def stamps_at(count: int, rate_hz: float) -> NDArray[np.int64]:
    """Stamps of poses at a rate, (count,) nanoseconds, from START_NS on."""
    return np.asarray(START_NS + np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64))


def looking(
    positions: NDArray[np.float64], yaw: NDArray[np.float64], pitch: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Optical poses, (N, 4, 4), that look along yaw (about z, from x) and pitch (upwards) without roll."""
    forward = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=1)
    right = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros_like(yaw)], axis=1)
    poses = np.tile(np.eye(4), (len(yaw), 1, 1))
    poses[:, :3, :3] = np.stack([right, np.cross(forward, right), forward], axis=2)
    poses[:, :3, 3] = positions
    return poses
