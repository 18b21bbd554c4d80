"""What spoils the images of a real camera: noise of depth, blur of motion, a robot that shakes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.pose_interpolation import interpolate_poses
from maomaps_warp.model.trajectory import Trajectory

#: Effects by name.
EFFECTS = ("kinect", "blur", "shake")

# What the random numbers of a seed are for.
_FOR_DEPTH, _FOR_SHAKING = 11, 12

#: Barron and Malik 2013, Intrinsic scene properties from a single RGB-D image: disparity is this over the depth in
#: metres, in steps of 1, and its standard deviation; that of the place where it is measured, pixels per axis.
_DISPARITY_AT_1M, _DISPARITY_NOISE, _PLACE_NOISE_PX = 351.3, 1.0 / 6.0, 0.5
#: Khoshelham and Oude Elberink 2012, Accuracy and resolution of Kinect depth data: the sensor's range, metres.
_KINECT_NEAR, _KINECT_FAR = 0.5, 5.0

#: Seconds that the shutter is open, half of them before the stamp; pictures that are taken in between.
EXPOSURE_S, EXPOSURE_FRAMES = 0.02, 8

#: Standard deviations per axis at full speed: radians, metres; the range of its frequencies, hertz, and their number.
SHAKE_RAD, SHAKE_M, _SHAKE_HZ, _SHAKE_WAVES = float(np.radians(0.3)), 0.002, (0.5, 3.0), 8


@dataclass(frozen=True)
class Effects:
    """Which effects there are; each is random by the seed alone.

    Attributes:
        kinect: depth as a structured-light camera measures it.
        blur: colours are the mean over the time of the exposure.
        shake: the camera trembles as the robot rolls; its poses are still exact.
        seed: of all of them.
    """

    kinect: bool = False
    blur: bool = False
    shake: bool = False
    seed: int = 0

    @classmethod
    def of(cls, names: Sequence[str], seed: int) -> Effects:
        """Those of EFFECTS that are named.

        Raises:
            ValueError: another name.
        """
        for name in names:
            if name not in EFFECTS:
                raise ValueError(f"{name!r} is no effect; allowed: {', '.join(EFFECTS)}")
        return cls(**dict.fromkeys(names, True), seed=seed)

    def rng(self, index: int) -> np.random.Generator:
        """Random numbers for the depth of one frame, the same each time."""
        return np.random.default_rng([self.seed, _FOR_DEPTH, index])


#: Perfect images.
NO_EFFECTS = Effects()


def kinect_depth(depth: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """A depth image (metres, 0 = missing) as a Kinect of the first generation measures it.

    The disparity is that of a place nearby, has noise and comes in whole steps (Barron and Malik 2013, who interpolate
    between pixels; here it is the nearest pixel, so that no depth lies between two surfaces). Depth beyond the sensor's
    range is missing. Shadows of the projector and the loss of light on slanted surfaces are not modelled.
    """
    rows, columns = np.indices(depth.shape)
    offsets = np.rint(_PLACE_NOISE_PX * rng.standard_normal((2, *depth.shape))).astype(np.int64)
    row = np.clip(rows + offsets[0], 0, depth.shape[0] - 1)
    column = np.clip(columns + offsets[1], 0, depth.shape[1] - 1)
    there = depth[row, column].astype(np.float64)
    seen = (there >= _KINECT_NEAR) & (there <= _KINECT_FAR) & (depth > 0.0)
    disparity = np.divide(_DISPARITY_AT_1M, there, out=np.ones(depth.shape), where=seen)
    steps = np.rint(disparity + _DISPARITY_NOISE * rng.standard_normal(depth.shape))
    return np.where(seen, _DISPARITY_AT_1M / np.maximum(steps, 1.0), 0.0).astype(np.float32)


def exposure_poses(trajectory: Trajectory, index: int) -> NDArray[np.float64]:
    """Poses, (EXPOSURE_FRAMES, 4, 4), during the exposure at pose `index`; beyond both ends the camera rests."""
    assert trajectory.stamps_ns is not None
    seconds = (trajectory.stamps_ns - trajectory.stamps_ns[index]).astype(np.float64) * 1e-9
    when = EXPOSURE_S * ((np.arange(EXPOSURE_FRAMES) + 0.5) / EXPOSURE_FRAMES - 0.5)
    at = np.interp(when, seconds, np.arange(len(seconds)))
    before = np.minimum(at.astype(np.int64), len(seconds) - 1)
    after = np.minimum(before + 1, len(seconds) - 1)
    T = trajectory.T_world_camera
    return interpolate_poses(T[before], T[after], at - before)


def blurred(pictures: Sequence[NDArray[np.uint8] | None]) -> NDArray[np.uint8]:
    """The mean of pictures, (H, W, 3) uint8 each."""
    total = np.sum([picture for picture in pictures if picture is not None], axis=0, dtype=np.uint32)
    count = len(pictures)
    return np.asarray((2 * total + count) // (2 * count)).astype(np.uint8)


def shaken(trajectory: Trajectory, seed: int) -> Trajectory:
    """A trajectory whose camera trembles: smoothly, the more the faster it goes, not at all where it stands.

    Raises:
        ValueError: poses without stamps.
    """
    from scipy.spatial.transform import Rotation

    if trajectory.stamps_ns is None:
        raise ValueError("shaking needs poses with stamps")
    if len(trajectory) < 2:
        return trajectory
    seconds = (trajectory.stamps_ns - trajectory.stamps_ns[0]).astype(np.float64) * 1e-9
    rng = np.random.default_rng([seed, _FOR_SHAKING])
    frequency = rng.uniform(*_SHAKE_HZ, (6, _SHAKE_WAVES, 1))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, _SHAKE_WAVES, 1))
    # Each wave has a variance of 1/2.
    waves = np.sqrt(2.0 / _SHAKE_WAVES) * np.sin(2.0 * np.pi * frequency * seconds + phase).sum(axis=1)
    steps = np.linalg.norm(np.gradient(trajectory.positions, axis=0), axis=1)
    waves = (waves * (steps / max(steps.max(), 1e-12))).T
    T = trajectory.T_world_camera.copy()
    T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(SHAKE_RAD * waves[:, :3]).as_matrix()
    T[:, :3, 3] += SHAKE_M * waves[:, 3:]
    return replace(trajectory, T_world_camera=T)
