"""The proof of what poses mean, on an exact room and poses written without our own code."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from check_scenes import drive, handheld, on_the_spot, stream_of, trajectory_of, written, written_by_maomaps
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from maomaps_warp.checking.proof import prove, prove_convention, recorded_poses, says_the_same
from maomaps_warp.checking.sampling import FRAMES_KEPT, FRAMES_LOOKED_AT, sample_frames
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.pose_convention import CONVENTIONS, SAMPLE_YAW_CORRECTIONS, parse_convention

#: Rotations pass through quaternions of float64, dimensionless: a few rounding errors.
ROTATION_TOLERANCE = 1e-12
#: The search's grid is 0.005 rad wide, and depth of a small image tells no finer.
YAW_TOLERANCE_RAD = 0.02
#: Under the right convention an exact room agrees but for the grain of a small image, share of the pixels that land.
EXACT_AGREEMENT = 0.95


@pytest.fixture(scope="module")
def samples():
    return {path.__name__: (path(), sample_frames(stream_of(path()))) for path in (drive, handheld, on_the_spot)}


@pytest.mark.parametrize(
    ("axes", "inverse", "wxyz"), list(product(("optical", "body", "opengl"), (False, True), (False, True)))
)
def test_every_convention_is_found_in_poses_that_were_written_so(samples, axes, inverse, wxyz):
    T, sample = samples["handheld"]
    proof = prove(sample, trajectory_of(written(T, axes, inverse=inverse, wxyz=wxyz)))
    assert proof.is_clear, proof.reason
    assert proof.best.name == axes + "-inverse" * inverse + "-wxyz" * wxyz
    best, second = proof.candidates[:2]
    assert best.agreement_of_landed > EXACT_AGREEMENT > second.agreement_of_landed
    assert best.ahead == 0.0
    assert second.ahead > 0.9
    assert best.pixels > best.pairs > 0


@pytest.mark.parametrize(
    ("orientation", "correction", "name"),
    [
        ("a", 0.0, "maomaps-a"),
        ("a", -0.45, "maomaps-a:sample1"),
        ("a", 1.51, "maomaps-a:sample5"),
        ("b", 0.0, "maomaps-b"),
        ("b", 0.06, "maomaps-b:sample12"),
        ("c", 0.0, "body"),
        ("c", -0.45, "maomaps-c:sample1"),
        ("c", 0.06, "maomaps-c:sample12"),
    ],
)
def test_the_orientations_of_maomaps_are_found_with_their_yaw_correction(samples, orientation, correction, name):
    T, sample = samples["drive"]
    proof = prove(sample, trajectory_of(written_by_maomaps(T, orientation, correction)))
    assert proof.is_clear, proof.reason
    assert proof.best.name == name
    turn = proof.candidates[0].yaw_found_rad - correction - (0.0 if orientation == "c" else np.pi)
    assert abs(np.angle(np.exp(1j * turn))) < YAW_TOLERANCE_RAD


def test_a_yaw_that_is_not_published_is_found_as_a_number(samples):
    T, sample = samples["drive"]
    proof = prove(sample, trajectory_of(written_by_maomaps(T, "c", 0.7)))
    assert proof.is_clear, proof.reason
    assert 0.7 not in SAMPLE_YAW_CORRECTIONS.values()
    assert proof.best.name.startswith("maomaps-c:")
    assert parse_convention(proof.best.name).yaw == pytest.approx(0.7, abs=YAW_TOLERANCE_RAD)


def test_on_the_spot_every_yaw_says_the_same_and_the_plain_name_is_given(samples):
    T, sample = samples["on_the_spot"]
    proof = prove(sample, trajectory_of(written_by_maomaps(T, "b", 0.3)))
    assert proof.is_clear, proof.reason
    assert proof.best.name == "body"
    assert {"maomaps-b", "maomaps-c"} <= set(proof.candidates[0].equivalents)


def test_a_camera_that_does_not_move_proves_nothing():
    T = np.repeat(drive(1), 20, axis=0)
    proof = prove_convention(stream_of(T), trajectory_of(T))
    assert not proof.is_clear
    assert proof.best is None
    assert "does not move" in proof.reason


def test_a_camera_that_only_trembles_proves_nothing():
    T = np.repeat(drive(1), 20, axis=0)
    T[:, :3, 3] += np.random.default_rng(0).normal(scale=0.003, size=(20, 3))
    proof = prove_convention(stream_of(T), trajectory_of(T))
    assert not proof.is_clear


def test_a_camera_tilted_in_the_recorded_body_fits_no_convention(samples):
    T, sample = samples["handheld"]
    tilted = T.copy()
    tilted[:, :3, :3] = T[:, :3, :3] @ Rotation.from_euler("x", 20.0, degrees=True).as_matrix()
    proof = prove(sample, trajectory_of(written(tilted, "body")))
    assert not proof.is_clear
    assert "tilted" in proof.reason or "no convention fits" in proof.reason


def test_poses_of_another_recording_fit_no_convention(samples):
    T, sample = samples["handheld"]
    rng = np.random.default_rng(0)
    proof = prove(sample, trajectory_of(T[rng.permutation(len(T))]))
    assert not proof.is_clear
    assert proof.best is None


def test_a_wall_that_fills_the_view_proves_nothing():
    T = handheld(30)
    images = [np.full((36, 48), 2.0, np.float32)] * len(T)
    stream = replace(stream_of(T), read=lambda _: (Frame(i, None, depth) for i, depth in enumerate(images)))
    still = T.copy()
    still[:, :3, :3] = T[0, :3, :3]
    still[:, :3, 3] = T[0, :3, 3] + np.linspace(0.0, 0.05, len(T))[:, None]
    assert not prove_convention(stream, trajectory_of(still)).is_clear


def test_frames_and_poses_without_stamps_pair_by_index():
    T = handheld()
    recorded = replace(trajectory_of(written(T, "body")), stamps_ns=None)
    proof = prove_convention(stream_of(T, with_stamps=False), recorded)
    assert proof.is_clear, proof.reason
    assert proof.best.name == "body"


def test_poses_between_which_frames_lie_are_interpolated_under_each_convention():
    # A dense path whose every fourth frame falls between recorded poses.
    T = handheld(161)
    poses = trajectory_of(written(T, "opengl", inverse=True))
    stamps = poses.stamps_ns[0] + (poses.stamps_ns - poses.stamps_ns[0]) // 4
    recorded = replace(poses, stamps_ns=stamps).select(np.flatnonzero(np.arange(161) % 4 != 0))
    proof = prove_convention(stream_of(T[::4]), recorded)
    assert proof.best is not None, proof.reason
    assert proof.best.name == "opengl-inverse"
    assert proof.frames_without_pose == 2  # the first and the last: nothing is extrapolated


def test_frames_without_poses_are_counted_and_prove_nothing():
    T = handheld(10)
    far = replace(trajectory_of(T), stamps_ns=trajectory_of(T).stamps_ns + 10**12)
    proof = prove_convention(stream_of(T), far)
    assert not proof.is_clear
    assert proof.frames == 0
    assert proof.frames_without_pose == 10
    assert "0 of 10 frames have a pose" in proof.reason


def test_depth_that_is_missing_everywhere_proves_nothing():
    T = handheld(10)
    proof = prove_convention(stream_of(T, factor=0.0), trajectory_of(T))
    assert not proof.is_clear
    assert "same place" in proof.reason


def test_few_frames_of_a_long_recording_are_kept_evenly():
    camera = stream_of(drive(1)).camera
    read: list[int] = []

    def endless(with_colors: bool):
        for i in range(10**6):
            read.append(i)
            yield Frame(i, 10**9 + i, np.full((camera.height, camera.width), i + 1, np.float32))

    sample = sample_frames(FrameStream(camera, None, endless))
    assert len(read) <= FRAMES_LOOKED_AT
    assert FRAMES_KEPT / 2 <= len(sample) <= FRAMES_KEPT
    assert len(set(np.diff(sample.index))) == 1
    np.testing.assert_array_equal(sample.depth[:, 0, 0], sample.index + 1)
    np.testing.assert_array_equal(sample.stamps_ns, 10**9 + sample.index)


def test_the_small_camera_sees_the_same_rays():
    camera = replace(stream_of(drive(1)).camera, width=644, height=480, fx=520.0, fy=530.0, cx=320.3, cy=241.1)
    _, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32)
    slope = (u - np.float32(camera.cx)) / np.float32(camera.fx)
    sample = sample_frames(FrameStream(camera, 1, lambda _: iter([Frame(0, 1, slope)])))
    small = sample.camera
    assert sample.depth.shape == (1, small.height, small.width)
    expected = (np.arange(small.width) - small.cx) / small.fx
    np.testing.assert_allclose(sample.depth[0, 0], expected, rtol=0, atol=1e-6)  # float32 slopes


@given(st.sampled_from([*CONVENTIONS, "maomaps-a:0.4", "maomaps-b:sample7", "body-inverse-wxyz"]), st.integers(0, 99))
def test_undoing_a_reading_gives_the_poses_back(name, seed):
    recorded = np.tile(np.eye(4), (3, 1, 1))
    recorded[:, :3, :3] = Rotation.random(3, random_state=seed).as_matrix()
    recorded[:, :3, 3] = np.random.default_rng(seed).normal(size=(3, 3))
    read = replace(trajectory_of(parse_convention(name).camera_poses(recorded)), pose_frame=name)
    undone = recorded_poses(read)
    assert undone.pose_frame == "optical"
    np.testing.assert_allclose(undone.T_world_camera, recorded, rtol=0, atol=ROTATION_TOLERANCE)


def test_what_says_the_same_as_the_proof(samples):
    T, sample = samples["drive"]
    proof = prove(sample, trajectory_of(written_by_maomaps(T, "c", -0.45)))
    assert says_the_same(proof, parse_convention("maomaps-c:-0.44"))
    assert says_the_same(proof, parse_convention("maomaps-b:2.69"))
    assert not says_the_same(proof, parse_convention("body"))
    assert not says_the_same(proof, parse_convention("optical"))


def test_a_declared_yaw_is_a_candidate_that_may_lose(samples):
    T, sample = samples["handheld"]
    proof = prove(sample, trajectory_of(written(T, "body")), also=parse_convention("maomaps-c:0.5"))
    assert proof.is_clear, proof.reason
    assert proof.best.name == "body"
    assert "maomaps-c:0.5" in [candidate.convention.name for candidate in proof.candidates]
    assert not says_the_same(proof, parse_convention("maomaps-c:0.5"))
