"""What spoils the images of a real camera: noise of depth, blur of motion, a robot that shakes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.pose_interpolation import interpolate_poses
from maomaps_warp.model.trajectory import Trajectory

#: Effects by name.
EFFECTS = ("kinect", "cnn", "blur", "shake")

# What the random numbers of a seed are for.
_FOR_DEPTH, _FOR_SHAKING, _FOR_GUESSING = 11, 12, 13

#: Barron and Malik 2013, Intrinsic scene properties from a single RGB-D image: disparity is this over the depth in
#: metres, in steps of 1, and its standard deviation; that of the place where it is measured, pixels per axis.
_DISPARITY_AT_1M, _DISPARITY_NOISE, _PLACE_NOISE_PX = 351.3, 1.0 / 6.0, 0.5
#: Khoshelham and Oude Elberink 2012, Accuracy and resolution of Kinect depth data: the sensor's range, metres.
_KINECT_NEAR, _KINECT_FAR = 0.5, 5.0

#: Depth guessed from colours: errors of its logarithm for a whole recording and for parts of an image, standard
#: deviations, so that the mean relative error is about that of Laina et al. 2016, Deeper depth prediction with fully
#: convolutional residual networks, on NYU Depth v2: 0.127. The number of waves that the latter are made of, how many go
#: over an image, their frequencies in hertz; by what share of the image's width depth runs over edges.
_GUESS_BIAS, _GUESS_WARP, _GUESS_WAVES = 0.08, 0.13, 16
_GUESS_PER_IMAGE, _GUESS_HZ, _GUESS_SMEAR = (0.3, 2.0), (0.02, 0.2), 1.0 / 120.0

#: Seconds that the shutter is open, half of them before the stamp; pictures that are taken in between.
_EXPOSURE_S, _EXPOSURE_FRAMES = 0.02, 8

#: Standard deviations per axis from this speed on (m/s), less below it: radians, metres; the range of frequencies,
#: hertz, and their number.
_SHAKE_SPEED = 0.5
_SHAKE_RAD, _SHAKE_M, _SHAKE_HZ, _SHAKE_WAVES = float(np.radians(0.3)), 0.002, (0.5, 3.0), 8


@dataclass(frozen=True)
class Effects:
    """Which effects there are; each is random by the seed alone.

    Attributes:
        kinect: depth as a structured-light camera measures it.
        cnn: depth as a network guesses it from the colours.
        blur: colours are the mean over the time of the exposure.
        shake: the camera trembles as the robot rolls; its poses are still exact.
        seed: of all of them.
    """

    kinect: bool = False
    cnn: bool = False
    blur: bool = False
    shake: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if self.kinect and self.cnn:
            raise ValueError("kinect and cnn are both about depth: give one")

    @property
    def spoils_depth(self) -> bool:
        """Whether depth is not the exact one."""
        return self.kinect or self.cnn

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

    def depth(self, exact: NDArray[np.float32], index: int, seconds: float) -> NDArray[np.float32]:
        """Depth (metres, 0 = missing) of frame `index`, so many seconds after the first; the same each time."""
        if self.kinect:
            return kinect_depth(exact, np.random.default_rng([self.seed, _FOR_DEPTH, index]))
        return guessed_depth(exact, seconds, self.seed) if self.cnn else exact


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


def guessed_depth(depth: NDArray[np.float32], seconds: float, seed: int) -> NDArray[np.float32]:
    """A depth image (metres, 0 = missing) as a convolutional network might guess it from the colours.

    The scale is wrong by one factor for the whole recording and by another that drifts slowly over image and time, and
    depth runs smoothly over edges. What is missing stays missing.

    Args:
        depth: the exact one.
        seconds: since the recording began.
        seed: of the errors.
    """
    from scipy import ndimage

    rng = np.random.default_rng([seed, _FOR_GUESSING])
    bias = _GUESS_BIAS * rng.standard_normal()
    direction, per_image = rng.uniform(0.0, 2.0 * np.pi, _GUESS_WAVES), rng.uniform(*_GUESS_PER_IMAGE, _GUESS_WAVES)
    hertz, phase = rng.uniform(*_GUESS_HZ, _GUESS_WAVES), rng.uniform(0.0, 1.0, _GUESS_WAVES)
    width = depth.shape[1]
    v, u = np.indices(depth.shape) / width
    warp = np.zeros(depth.shape)
    for angle, count, rate, start in zip(direction, per_image, hertz, phase, strict=True):
        turns = count * (np.cos(angle) * u + np.sin(angle) * v) + rate * seconds + start
        warp += np.sin(2.0 * np.pi * turns)
    warp *= _GUESS_WARP * np.sqrt(2.0 / _GUESS_WAVES)
    # Means of what is there: what is missing does not pull depth towards zero.
    seen, spread = depth > 0.0, _GUESS_SMEAR * width
    weight = ndimage.gaussian_filter(seen.astype(np.float64), spread)
    smooth = ndimage.gaussian_filter(np.where(seen, depth, 0.0).astype(np.float64), spread)
    guess = np.divide(smooth, weight, out=np.zeros(depth.shape), where=seen) * np.exp(bias + warp)
    return np.asarray(guess.astype(np.float32))


def exposure_poses(trajectory: Trajectory, index: int) -> NDArray[np.float64]:
    """Poses, (_EXPOSURE_FRAMES, 4, 4), during the exposure at pose `index`; beyond both ends the camera rests."""
    assert trajectory.stamps_ns is not None
    seconds = (trajectory.stamps_ns - trajectory.stamps_ns[index]).astype(np.float64) * 1e-9
    when = _EXPOSURE_S * ((np.arange(_EXPOSURE_FRAMES) + 0.5) / _EXPOSURE_FRAMES - 0.5)
    at = np.interp(when, seconds, np.arange(len(seconds)))
    before = np.minimum(at.astype(np.int64), len(seconds) - 1)
    after = np.minimum(before + 1, len(seconds) - 1)
    T = trajectory.T_world_camera
    return interpolate_poses(T[before], T[after], at - before)


def blurred(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """The mean of pictures, (H, W, 3) uint8 each."""
    total = np.sum(pictures, axis=0, dtype=np.uint32)
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
    # Stamps may repeat.
    speed = np.linalg.norm(np.gradient(trajectory.positions, seconds + 1e-9 * np.arange(len(seconds)), axis=0), axis=1)
    waves = (waves * np.minimum(speed / _SHAKE_SPEED, 1.0)).T
    T = trajectory.T_world_camera.copy()
    T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(_SHAKE_RAD * waves[:, :3]).as_matrix()
    T[:, :3, 3] += _SHAKE_M * waves[:, 3:]
    return replace(trajectory, T_world_camera=T)
