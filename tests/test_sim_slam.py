"""The simulated SLAM: drift of the trajectory, noise of the depth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.agent import drive
from maomaps_warp.sim.scene import furnished_flat
from maomaps_warp.sim.slam import SlamDisturbance, closed_loops, disturbed_frames, disturbed_trajectory, kept_poses

#: No disturbance of the poses, and none of the depth.
STILL = {
    "scale_error": 0.0,
    "yaw_drift": 0.0,
    "position_drift": 0.0,
    "position_jitter": 0.0,
    "rotation_jitter": 0.0,
}
CLEAR = {
    "depth_noise": 0.0,
    "disparity_step": 0.0,
    "edge_threshold": 0.0,
    "border": 0,
    "min_depth": 0.0,
    "max_depth": 100.0,
}
#: Share: float32 keeps 7 digits, 1 / (1 / z) loses less than one of them.
ROUNDING = 1e-6
#: Share: a standard deviation from 20,000 samples is good to about 0.5 %.
SPREAD_TOLERANCE = 0.03
#: The only frame of a stream.
ONE = np.array([0])


def gt_drive(seed: int = 0, frames: int = 240) -> Trajectory:
    return drive(furnished_flat(seed), frames=frames, seed=seed, rate_hz=frames / 24.0)


def stream_of(*depths: np.ndarray) -> FrameStream:
    def read(with_colors: bool) -> Iterator[Frame]:
        for index, depth in enumerate(depths):
            colors = np.full((*depth.shape, 3), index, np.uint8) if with_colors else None
            yield Frame(index, 1000 + index, depth.astype(np.float32), colors)

    height, width = depths[0].shape
    return FrameStream(Camera.from_fov(width, height, 90), len(depths), read)


def sensed(depth: np.ndarray, **settings: float) -> np.ndarray:
    disturbance = SlamDisturbance(**{**CLEAR, **settings})
    return next(disturbed_frames(stream_of(depth), disturbance, ONE).read(False)).depth


def ate(gt: Trajectory, est: Trajectory) -> float:
    return float(np.sqrt(((gt.positions - est.positions) ** 2).sum(1).mean()))


def test_no_disturbance_changes_nothing() -> None:
    gt = gt_drive()
    nothing = SlamDisturbance(**STILL, **CLEAR)
    np.testing.assert_allclose(disturbed_trajectory(gt, nothing).T_world_camera, gt.T_world_camera, rtol=0, atol=1e-12)
    depth = np.random.default_rng(0).uniform(0.4, 9.0, (20, 30))
    depth[3, 4] = 0.0
    frame = next(disturbed_frames(stream_of(depth), nothing, ONE).read(True))
    np.testing.assert_allclose(frame.depth, depth, rtol=ROUNDING)


@pytest.mark.parametrize("seed", range(10))
def test_the_default_error_is_that_of_a_usable_slam(seed: int) -> None:
    gt = gt_drive(seed)
    assert 0.04 < ate(gt, disturbed_trajectory(gt, SlamDisturbance(seed=seed))) < 0.3


def test_the_demonstrations_error_lies_between_10_and_20_centimetres() -> None:
    gt = gt_drive()
    assert 0.1 < ate(gt, disturbed_trajectory(gt, SlamDisturbance())) < 0.2


def test_the_drift_does_not_depend_on_how_densely_the_way_is_sampled() -> None:
    still = {**STILL, "yaw_drift": 0.008, "position_drift": 0.012}
    dense, sparse = (gt_drive(0, frames) for frames in (961, 241))
    ends = [
        disturbed_trajectory(gt, SlamDisturbance(**still)).positions[-1] - gt.positions[-1] for gt in (dense, sparse)
    ]
    assert np.linalg.norm(ends[0]) > 0.02
    # Metres: the integration's step differs by a factor of four.
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=0.01)


def test_drift_starts_at_zero_and_changes_smoothly() -> None:
    gt = gt_drive()
    est = disturbed_trajectory(gt, SlamDisturbance(position_jitter=0.0, rotation_jitter=0.0))
    np.testing.assert_allclose(est.T_world_camera[0], gt.T_world_camera[0], rtol=0, atol=1e-12)
    error = est.positions - gt.positions
    step = np.linalg.norm(np.diff(gt.positions, axis=0), axis=1)
    # A share of each step: scale 1 %, heading and slip some per cent.
    assert (np.linalg.norm(np.diff(error, axis=0), axis=1) < 0.15 * step).all()


def test_yaw_drift_turns_about_the_vertical_and_keeps_the_steps_lengths() -> None:
    gt = gt_drive()
    est = disturbed_trajectory(gt, SlamDisturbance(**{**STILL, "yaw_drift": 0.02}))
    turn = est.T_world_camera[:, :3, :3] @ gt.T_world_camera[:, :3, :3].transpose(0, 2, 1)
    np.testing.assert_allclose(turn[:, 2], np.tile([0.0, 0.0, 1.0], (len(gt), 1)), rtol=0, atol=1e-12)
    assert np.abs(np.arctan2(turn[:, 1, 0], turn[:, 0, 0])).max() > 0.01
    lengths = [np.linalg.norm(np.diff(t.positions, axis=0), axis=1) for t in (gt, est)]
    np.testing.assert_allclose(lengths[0], lengths[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(est.positions[:, 2], gt.positions[:, 2], rtol=0, atol=1e-12)


def test_a_scale_error_makes_the_way_longer_by_its_share() -> None:
    gt = gt_drive()
    est = disturbed_trajectory(gt, SlamDisturbance(**{**STILL, "scale_error": 0.01}))
    assert est.path_length / gt.path_length == pytest.approx(1.01, rel=1e-9)


def test_jitter_has_its_standard_deviation() -> None:
    gt = gt_drive(0, 2400)
    est = disturbed_trajectory(gt, SlamDisturbance(**{**STILL, "position_jitter": 0.005, "rotation_jitter": 0.003}))
    assert (est.positions - gt.positions).std() == pytest.approx(0.005, rel=SPREAD_TOLERANCE)
    turn = gt.T_world_camera[:, :3, :3].transpose(0, 2, 1) @ est.T_world_camera[:, :3, :3]
    tilt = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]])
    assert tilt.std() == pytest.approx(0.003, rel=SPREAD_TOLERANCE)


def test_keyframes_of_trajectory_and_frames_are_the_same_and_keep_their_stamps() -> None:
    gt = gt_drive(0, 25)
    disturbance = SlamDisturbance(keyframe_every=4)
    every, keyframes = disturbed_trajectory(gt, SlamDisturbance()), disturbed_trajectory(gt, disturbance)
    assert gt.stamps_ns is not None
    np.testing.assert_array_equal(keyframes.stamps_ns, gt.stamps_ns[::4])
    np.testing.assert_array_equal(keyframes.T_world_camera, every.T_world_camera[::4])
    stream = stream_of(*(np.full((12, 16), 2.0) for _ in range(25)))
    kept = disturbed_frames(stream, disturbance, kept_poses(gt, disturbance))
    frames = list(kept.read(True))
    assert kept.count == len(frames) == len(keyframes)
    assert [f.index for f in frames] == list(range(7))
    assert [f.stamp_ns for f in frames] == [1000 + 4 * i for i in range(7)]
    everything = list(disturbed_frames(stream, SlamDisturbance(), np.arange(25)).read(True))
    for frame in frames:
        assert frame.colors is not None and frame.colors.max() == 4 * frame.index
        np.testing.assert_array_equal(frame.depth, everything[4 * frame.index].depth)


def test_reading_twice_gives_the_same_bytes_and_frames_differ_from_one_another() -> None:
    frames = stream_of(*(np.full((12, 16), 2.0) for _ in range(3)))
    stream = disturbed_frames(frames, SlamDisturbance(seed=4), np.arange(3))
    first, second = ([f.depth.tobytes() for f in stream.read(False)] for _ in range(2))
    assert first == second and len(set(first)) == 3
    other = disturbed_frames(stream_of(np.full((12, 16), 2.0)), SlamDisturbance(seed=5), ONE)
    assert next(other.read(False)).depth.tobytes() != first[0]
    gt = gt_drive()
    a, b, c = (disturbed_trajectory(gt, SlamDisturbance(seed=s)).T_world_camera.tobytes() for s in (1, 1, 2))
    assert a == b != c


@pytest.mark.parametrize("depth", [0.5, 1.0, 2.0, 4.0])
def test_depth_noise_grows_with_the_square_of_the_depth(depth: float) -> None:
    found = sensed(np.full((120, 200), depth), depth_noise=0.0014)
    assert found.dtype == np.float32
    assert (found - depth).std() == pytest.approx(0.0014 * depth**2, rel=SPREAD_TOLERANCE)
    # A second-order bias of sigma^2 / z remains when the error is one of the inverse depth.
    assert abs((found - depth).mean()) < 0.1 * 0.0014 * depth**2


def test_depth_comes_in_steps_of_the_disparity() -> None:
    depth = np.linspace(0.5, 6.0, 4000).reshape(40, 100)
    found = sensed(depth, disparity_step=0.0028)
    steps = 1.0 / found.astype(float) / 0.0028
    np.testing.assert_allclose(steps, np.rint(steps), rtol=0, atol=1e-3)
    assert (np.abs(found - depth) <= 0.51 * 0.0028 * depth**2 * 1.02).all()
    assert len(np.unique(found)) < 700


def test_pixels_at_a_break_are_missing_and_those_on_a_slope_are_not() -> None:
    v, u = np.mgrid[:60, :80].astype(float)
    floor = 1.2 / ((v + 3.0) / 40.0)  # a plane seen at grazing angles, in the pinhole model
    assert sensed(floor, edge_threshold=0.08).min() > 0.0
    step = np.where(u < 40, 1.0, 2.0)
    missing = sensed(step, edge_threshold=0.08) == 0.0
    np.testing.assert_array_equal(missing, (u == 39) | (u == 40))
    np.testing.assert_array_equal(sensed(step.T, edge_threshold=0.08) == 0.0, missing.T)


def test_border_range_and_missing_pixels_are_missing() -> None:
    depth = np.full((10, 12), 2.0)
    found = sensed(depth, border=3)
    inner = np.zeros(depth.shape, bool)
    inner[3:-3, 3:-3] = True
    np.testing.assert_array_equal(found > 0.0, inner)
    depth[0, :4] = (0.0, 0.25, 6.5, 3.0)
    found = sensed(depth, min_depth=0.3, max_depth=6.0, depth_noise=0.001)
    np.testing.assert_array_equal(found[0, :4] > 0.0, [False, False, False, True])
    assert (found[1:] > 0.0).all()


def test_a_drive_without_steps_or_poses_has_no_drift() -> None:
    gt = gt_drive()
    for count in (0, 1):
        est = disturbed_trajectory(gt.select(np.arange(count)), SlamDisturbance(**STILL))
        np.testing.assert_array_equal(est.T_world_camera, gt.T_world_camera[:count])


@pytest.mark.parametrize(
    "settings",
    [{"keyframe_every": 0}, {"seed": -1}, {"drift_length": 0.0}, {"depth_noise": -1.0}, {"max_depth": 0.1}]
    + [
        {"closures": -1},
        {"closure_correction": 1.5},
        {"losses": -1},
        {"loss_length": 0.0},
        {"depth_scale_error": -1.0},
    ],
)
def test_senseless_settings_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(settings))):
        SlamDisturbance(**settings)


def test_a_closed_loop_takes_back_its_share_of_the_drift_which_then_starts_anew() -> None:
    gt = gt_drive(2)
    open_loop = SlamDisturbance(seed=2, position_jitter=0.0, rotation_jitter=0.0)
    closing = replace(open_loop, closures=3, closure_correction=1.0)
    at = closed_loops(gt.positions, closing)
    assert len(at) == 3
    drifted, closed = (disturbed_trajectory(gt, d) for d in (open_loop, closing))
    np.testing.assert_array_equal(closed.T_world_camera[: at[0]], drifted.T_world_camera[: at[0]])
    np.testing.assert_allclose(closed.T_world_camera[at], gt.T_world_camera[at], rtol=0, atol=1e-12)
    jumps = np.linalg.norm(np.diff(closed.positions - gt.positions, axis=0), axis=1)
    assert jumps[at - 1].min() > 3 * np.median(jumps)
    assert ate(gt, closed) < 0.6 * ate(gt, drifted)
    half = disturbed_trajectory(gt, replace(closing, closures=1, closure_correction=0.5))
    (once,) = closed_loops(gt.positions, replace(closing, closures=1))
    error = drifted.positions[once] - gt.positions[once]
    np.testing.assert_allclose(half.positions[once] - gt.positions[once], 0.5 * error, rtol=0, atol=1e-9)


def test_where_tracking_is_lost_poses_and_their_frames_are_missing_together() -> None:
    gt = gt_drive(3)
    losing = SlamDisturbance(seed=3, losses=2, loss_length=0.8)
    kept, est = kept_poses(gt, losing), disturbed_trajectory(gt, losing)
    assert kept[0] == 0 and gt.stamps_ns is not None
    np.testing.assert_array_equal(est.stamps_ns, gt.stamps_ns[kept])
    gaps = np.flatnonzero(np.diff(kept) > 1)
    assert 1 <= len(gaps) <= 2
    for gap in gaps:
        missing = gt.positions[kept[gap] : kept[gap + 1] + 1]
        assert 0.7 < np.linalg.norm(np.diff(missing, axis=0), axis=1).sum() < 2.0
    np.testing.assert_array_equal(kept, kept_poses(gt, losing))
    everything = disturbed_trajectory(gt, replace(losing, losses=0))
    np.testing.assert_array_equal(est.T_world_camera, everything.T_world_camera[kept])


def test_a_depth_scale_error_is_a_factor() -> None:
    depth = np.random.default_rng(7).uniform(0.5, 4.0, (20, 30))
    np.testing.assert_allclose(sensed(depth, depth_scale_error=0.1), 1.1 * depth, rtol=ROUNDING)
