"""Disturbs a perfect recording as a SLAM method and a depth sensor would."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory

# What the random numbers of a seed are for; each use has its own sequence, so that none depends on another.
_FOR_DRIFT, _FOR_JITTER, _FOR_DEPTH, _FOR_LOSSES = 1, 2, 3, 4


@dataclass(frozen=True)
class SlamDisturbance:
    """How an estimate differs from the ground truth. All zeros and no limits change nothing.

    The drift is that of odometry: errors of the rates, which add up along the path. It is 0 at the first
    pose and varies smoothly.

    Attributes:
        seed: of everything random.
        scale_error: share by which every step is too long, dimensionless.
        yaw_drift: standard deviation of the error of the heading's rate, radians per metre travelled.
        position_drift: standard deviation per axis of the error of each step, metres per metre travelled.
        drift_length: travelled length over which the error of the rates changes, metres.
        position_jitter: standard deviation per axis of each pose's own error, metres.
        rotation_jitter: standard deviation per axis of each pose's own error, radians.
        closures: how often a loop is closed, evenly over the way: the pose jumps back towards the truth.
        closure_correction: by what share of its error; the drift starts anew from there.
        losses: how often tracking is lost, somewhere on the way: poses and frames are missing there.
        loss_length: travelled length of each loss, metres.
        keyframe_every: keep one pose and frame of so many, beginning with the first; 1 keeps all.
        depth_scale_error: share by which every depth is too large, dimensionless.
        depth_noise: standard deviation of the depth error at 1 m, metres; it grows with the depth squared.
        disparity_step: the inverse depth comes in multiples of this, 1/metres; 0 = continuous.
        edge_threshold: pixels where a surface breaks off are missing: where the second difference of the
            inverse depth (which is 0 on every plane), times the depth, exceeds this; dimensionless; 0 keeps
            all.
        border: this many pixels at each side of the image are missing.
        min_depth, max_depth: nearer and farther surfaces are missing, metres.
    """

    seed: int = 0
    scale_error: float = 0.01
    yaw_drift: float = 0.008
    position_drift: float = 0.012
    drift_length: float = 5.0
    position_jitter: float = 0.002
    rotation_jitter: float = 0.001
    closures: int = 0
    closure_correction: float = 0.9
    losses: int = 0
    loss_length: float = 1.0
    keyframe_every: int = 1
    depth_scale_error: float = 0.0
    # Khoshelham and Oude Elberink 2012, Accuracy and resolution of Kinect depth data: 1.4 mm and 2.8 mm at a
    # depth of 1 m, both growing with the depth squared.
    depth_noise: float = 0.0014
    disparity_step: float = 0.0028
    edge_threshold: float = 0.08
    border: int = 2
    min_depth: float = 0.3
    max_depth: float = 6.0

    def __post_init__(self) -> None:
        if not all(np.isfinite(value) for value in vars(self).values()):
            raise ValueError(f"all figures must be finite: {self}")
        if self.seed < 0 or self.border < 0 or self.keyframe_every < 1:
            raise ValueError(f"seed and border must not be negative, keyframe_every must be at least 1: {self}")
        if min(self.closures, self.losses) < 0 or not 0.0 <= self.closure_correction <= 1.0:
            raise ValueError(f"closures and losses must not be negative, a correction within 0 and 1: {self}")
        if self.scale_error <= -1.0 or self.depth_scale_error <= -1.0 or not self.loss_length > 0.0:
            raise ValueError(f"scale errors must be above -1, loss_length positive: {self}")
        if not self.drift_length > 0.0:
            raise ValueError(f"drift_length must be positive, got {self.drift_length}")
        spreads = (self.yaw_drift, self.position_drift, self.position_jitter, self.rotation_jitter)
        sensor = (self.depth_noise, self.disparity_step, self.edge_threshold, self.min_depth)
        if min(*spreads, *sensor) < 0.0 or self.max_depth <= self.min_depth:
            raise ValueError(f"spreads, steps and thresholds must not be negative, max_depth above min_depth: {self}")


def disturbed_trajectory(gt: Trajectory, disturbance: SlamDisturbance) -> Trajectory:
    """The trajectory that a SLAM method would give for `gt`.

    It starts at the first pose of `gt` but for the jitter, has the stamps of the poses that are kept, and is
    in the same world.
    """
    from scipy.spatial.transform import Rotation

    positions, yaw = _drifted(gt.positions, disturbance)
    jitter = np.random.default_rng([disturbance.seed, _FOR_JITTER]).standard_normal((len(gt), 6))
    poses = gt.T_world_camera.copy()
    poses[:, :3, 3] = positions + disturbance.position_jitter * jitter[:, :3]
    heading = Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    shake = Rotation.from_rotvec(disturbance.rotation_jitter * jitter[:, 3:]).as_matrix()
    poses[:, :3, :3] = heading @ poses[:, :3, :3] @ shake

    est = replace(gt, T_world_camera=poses, source="simulated SLAM")
    return est.select(kept_poses(gt, disturbance))


def closed_loops(positions: NDArray[np.float64], disturbance: SlamDisturbance) -> NDArray[np.int64]:
    """Indices of the poses, of positions (N, 3), at which a loop is closed."""
    travelled = _travelled(positions)
    shares = np.arange(1, disturbance.closures + 1) / (disturbance.closures + 1)
    return np.unique(np.searchsorted(travelled, shares * travelled[-1]))


def kept_poses(gt: Trajectory, disturbance: SlamDisturbance) -> NDArray[np.int64]:
    """Indices of the poses, and of the frames that belong to them, that an estimate has: keyframes, while tracked."""
    is_tracked = np.ones(len(gt), dtype=bool)
    if not len(gt):
        return np.flatnonzero(is_tracked)
    travelled = _travelled(gt.positions)
    for center in np.random.default_rng([disturbance.seed, _FOR_LOSSES]).uniform(0.1, 0.9, disturbance.losses):
        is_tracked &= np.abs(travelled - center * travelled[-1]) > 0.5 * disturbance.loss_length
    is_tracked[0] = True
    is_keyframe = np.arange(len(gt)) % disturbance.keyframe_every == 0
    return np.flatnonzero(is_tracked & is_keyframe)


def _travelled(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])


def _drifted(
    positions: NDArray[np.float64], disturbance: SlamDisturbance
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions, (N, 3), with their drift, and by how much the heading has drifted at each, (N,) radians."""
    from scipy.spatial.transform import Rotation

    if len(positions) < 2:
        return positions, np.zeros(len(positions))
    steps = np.diff(positions, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    yaw_rate, *position_rate = _smooth_noise(lengths, 4, disturbance)
    turns = disturbance.yaw_drift * yaw_rate * lengths
    slips = disturbance.position_drift * np.stack(position_rate, axis=1) * lengths[:, None]
    drifted, yaw = positions.copy(), np.zeros(len(positions))
    ends = [*closed_loops(positions, disturbance).tolist(), len(positions) - 1]
    begin, left = 0, 1.0 - disturbance.closure_correction
    for end in ends:
        here = slice(begin, end)
        yaw[begin + 1 : end + 1] = yaw[begin] + np.cumsum(turns[here])
        turned = steps[here]
        if end > begin:
            turned = Rotation.from_rotvec(yaw[here, None] * [0.0, 0.0, 1.0]).apply(turned)
        moved = np.cumsum((1.0 + disturbance.scale_error) * turned + slips[here], axis=0)
        drifted[begin + 1 : end + 1] = drifted[begin] + moved
        if end != ends[-1]:
            drifted[end] = positions[end] + left * (drifted[end] - positions[end])
            yaw[end] *= left
        begin = end
    return drifted, yaw


def _smooth_noise(lengths: NDArray[np.float64], count: int, disturbance: SlamDisturbance) -> list[NDArray[np.float64]]:
    """`count` smooth random functions of the way travelled, at each step: mean 0, variance 1 over seeds."""
    rng = np.random.default_rng([disturbance.seed, _FOR_DRIFT])
    waves = 4
    # Wavelengths of 1 to 4 drift lengths.
    frequencies = 2.0 * np.pi / (disturbance.drift_length * rng.uniform(1.0, 4.0, (count, waves, 1)))
    phases = rng.uniform(0.0, 2.0 * np.pi, (count, waves, 1))
    travelled = np.cumsum(lengths)
    return list(np.sqrt(2.0 / waves) * np.sin(frequencies * travelled + phases).sum(axis=1))


def disturbed_frames(stream: FrameStream, disturbance: SlamDisturbance, kept: NDArray[np.int64]) -> FrameStream:
    """The frames of `stream` as a structured-light sensor would give them; colours stay as they are.

    The noise depends on the seed and the frame's index in `stream` alone: each reading gives the same bytes.

    Args:
        stream: frames, each with a pose.
        disturbance: of their depth.
        kept: indices of the frames that are kept, ascending, as `kept_poses` gives them; they are numbered anew.
    """
    number = {index: place for place, index in enumerate(kept.tolist())}

    def read(with_colors: bool) -> Iterator[Frame]:
        for frame in stream.read(with_colors):
            if frame.index in number:
                rng = np.random.default_rng([disturbance.seed, _FOR_DEPTH, frame.index])
                yield replace(frame, index=number[frame.index], depth=_sensed(frame.depth, disturbance, rng))

    return FrameStream(stream.camera, len(number), read, f"{stream.source}, disturbed")


def _sensed(depth: NDArray[np.float32], disturbance: SlamDisturbance, rng: np.random.Generator) -> NDArray[np.float32]:
    """A depth image (metres, 0 = missing) with the sensor's noise, steps and gaps."""
    seen = (depth >= disturbance.min_depth) & (depth <= disturbance.max_depth)
    inverse = np.divide(
        1.0 / (1.0 + disturbance.depth_scale_error), depth, out=np.zeros(depth.shape), where=depth > 0.0
    )
    if disturbance.edge_threshold > 0.0:
        seen &= _breaks(inverse) <= disturbance.edge_threshold * inverse
    if disturbance.border > 0:
        inner = np.zeros_like(seen)
        inner[disturbance.border : -disturbance.border, disturbance.border : -disturbance.border] = True
        seen &= inner
    # An error of the disparity: constant in the inverse depth, so it grows with the depth squared.
    inverse += disturbance.depth_noise * rng.standard_normal(depth.shape)
    if disturbance.disparity_step > 0.0:
        inverse = np.rint(inverse / disturbance.disparity_step) * disturbance.disparity_step
    seen &= inverse > 0.0
    return np.divide(1.0, inverse, out=np.zeros(depth.shape), where=seen).astype(np.float32)


def _breaks(inverse: NDArray[np.float64]) -> NDArray[np.float64]:
    """Larger magnitude of the second differences along rows and columns; none across the image's border."""
    result = np.zeros_like(inverse)
    result[:, 1:-1] = np.abs(np.diff(inverse, 2, axis=1))
    result[1:-1] = np.maximum(result[1:-1], np.abs(np.diff(inverse, 2, axis=0)))
    return result
