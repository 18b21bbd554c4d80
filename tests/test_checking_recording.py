"""Depth units, gaps in stamps, poses that jump, the world's up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from check_scenes import handheld, on_the_spot, stream_of, trajectory_of
from scipy.spatial.transform import Rotation

from maomaps_warp.checking.depth_unit import prove_depth_unit
from maomaps_warp.checking.proof import prove
from maomaps_warp.checking.recording import frames_without_pose, partner_gaps, pose_jumps, stamp_facts, up_axis
from maomaps_warp.checking.sampling import sample_frames
from maomaps_warp.model.trajectory import Trajectory

#: Seconds and radians that pass through float64 sums of nanoseconds.
ROUNDING = 1e-9


@pytest.mark.parametrize("factor", [1.0, 5.0, 0.2, 1000.0, 0.001])
def test_a_wrong_depth_unit_is_found(factor):
    T = handheld()
    sample, poses = sample_frames(stream_of(T, factor=factor)), trajectory_of(T)
    unit = prove_depth_unit(sample, poses, prove(sample, poses))
    assert unit.fits is (factor == 1.0), unit.reason
    assert unit.factor == pytest.approx(1.0 / factor)


def test_without_a_way_the_depth_unit_cannot_be_told():
    T = on_the_spot()
    sample, poses = sample_frames(stream_of(T, factor=5.0)), trajectory_of(T)
    unit = prove_depth_unit(sample, poses, prove(sample, poses))
    assert unit.fits is None
    assert "too little" in unit.reason


def test_the_extent_of_depth_is_stated():
    stream = stream_of(handheld(4))
    images = np.stack([frame.depth for frame in stream.read(False)])
    images[:, :, :12] = 0.0
    frames = [replace(frame, depth=image) for frame, image in zip(stream.read(False), images, strict=True)]
    sample = sample_frames(replace(stream, read=lambda _: iter(frames)))
    unit = prove_depth_unit(sample, trajectory_of(handheld(4)), prove(sample, trajectory_of(handheld(4))))
    valid = images[images > 0]
    assert (unit.nearest_m, unit.farthest_m) == (valid.min(), valid.max())
    assert unit.median_m == pytest.approx(np.median(valid), rel=1e-6)  # float32 median of an even count
    assert unit.missing == pytest.approx(12 / 48, abs=ROUNDING)


def test_missing_messages_are_counted_from_the_gaps():
    stamps = np.array([0, 100, 200, 500, 600, 740, 840, 1090], dtype=np.int64) * 1_000_000 + 10**15
    facts = stamp_facts("depth", stamps)
    # 300 ms hold two more messages, 250 ms one or two (rounded half to even: one), 140 ms are jitter.
    assert (facts.count, facts.gaps, facts.missing) == (8, 2, 3)
    assert facts.rate_hz == pytest.approx(10.0, rel=ROUNDING)
    assert facts.largest_gap_s == pytest.approx(0.3, abs=ROUNDING)
    assert facts.largest_at_s == pytest.approx(0.2, abs=ROUNDING)


def test_one_stamp_has_no_gaps():
    facts = stamp_facts("poses", np.array([5], dtype=np.int64))
    assert (facts.count, facts.median_gap_s, facts.rate_hz, facts.missing) == (1, 0.0, 0.0, 0)


def test_the_distance_to_the_nearest_colours_is_taken():
    gaps = partner_gaps(np.array([10, 20, 33]), np.array([0, 12, 31, 40]))
    np.testing.assert_array_equal(gaps, [2, 8, 2])


def test_a_frame_in_a_gap_of_the_poses_has_none():
    seconds = np.array([0.0, 0.1, 0.2, 0.9, 1.0])
    poses = Trajectory(np.tile(np.eye(4), (5, 1, 1)), (seconds * 1e9).astype(np.int64))
    stamps = (np.array([0.05, 0.2, 0.5, 0.95, 1.1]) * 1e9).astype(np.int64)
    assert frames_without_pose(stamps, poses) == 2


def test_a_pose_that_jumps_is_named():
    T = np.tile(np.eye(4), (50, 1, 1))
    T[:, 0, 3] = 0.03 * np.arange(50)
    T[30:, 1, 3] += 2.5
    poses = trajectory_of(T)
    (jump,) = pose_jumps(poses)
    assert jump.index == 30
    assert jump.at_s == pytest.approx(3.0, abs=ROUNDING)
    assert jump.step_m == pytest.approx(np.hypot(2.5, 0.03), abs=ROUNDING)
    assert jump.speed == pytest.approx(10.0 * np.hypot(2.5, 0.03), abs=1e-6)  # metres a second
    (without,) = pose_jumps(replace(poses, stamps_ns=None))
    assert (without.index, without.speed) == (30, None)


def test_steady_and_resting_poses_do_not_jump():
    T = np.tile(np.eye(4), (50, 1, 1))
    assert pose_jumps(trajectory_of(T)) == ()
    T[25:, 0, 3] = 0.05 * np.arange(25)
    assert pose_jumps(trajectory_of(T)) == ()
    assert pose_jumps(trajectory_of(T[:1])) == ()


@pytest.mark.parametrize(
    ("turn", "axis"),
    [((0, 0, 0), "-y"), ((-90, 0, 0), "+z"), ((90, 0, 0), "-z"), ((0, 0, 180), "+y"), ((0, 0, 90), "+x")],
)
def test_the_worlds_up_is_the_cameras_mean_up(turn, axis):
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
    up = up_axis(T)
    assert (up.axis, up.is_clear) == (axis, True)
    assert up.away_rad < 1e-6


def test_a_camera_that_looks_everywhere_tells_no_up():
    T = np.tile(np.eye(4), (60, 1, 1))
    T[:, :3, :3] = Rotation.random(60, random_state=0).as_matrix()
    assert not up_axis(T).is_clear


def path(positions, seconds):
    T = np.tile(np.eye(4), (len(positions), 1, 1))
    T[:, 0, 3] = positions
    return Trajectory(T, (np.array(seconds) * 1e9).astype(np.int64))


def test_a_jump_is_faster_than_the_rest():
    number = np.arange(20)
    walk, at, later = number * 0.1, number * 0.1, number >= 12
    assert pose_jumps(path(walk, at)) == ()
    (jump,) = pose_jumps(path(walk + 3.0 * later, at))
    assert jump.index == 12
    assert pose_jumps(path(walk + 3.0 * later, at + 5.0 * later)) == ()  # lost for five seconds
    assert pose_jumps(path(number * 2.0, at)) == ()  # a car
    assert pose_jumps(path(0.15 * later, number)) == ()  # a camera that rests, and is carried once
    assert len(pose_jumps(path(walk + 5.0 * (number // 5), at))) == 3  # so many that they are usual
