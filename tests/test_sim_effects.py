"""What spoils images: noise of depth, blur of motion, a camera that trembles; and other simulators' images."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from maomaps_warp.model.camera import Camera
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.effects import (
    Effects,
    exposure_poses,
    guessed_depth,
    kinect_depth,
    shaken,
)
from maomaps_warp.sim.simulator import EXACT_DEPTH, Seen, camera_path, simulated_frames

CAMERA = Camera.from_fov(40, 30, 90.0)


def straight(count: int = 50, speed: float = 1.0) -> Trajectory:
    """Along x, turning slowly, at 10 Hz."""
    seconds = 0.1 * np.arange(count)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(0.2 * seconds[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    poses[:, 0, 3] = speed * seconds
    return Trajectory(poses, np.rint(1e9 * (5.0 + seconds)).astype(np.int64))


@dataclass
class Wall:
    """A simulator of somebody else's: a wall across x, whose colour tells the camera's place."""

    distance: float = 10.0
    camera: Camera = CAMERA
    source: str = "a wall"

    def see(self, T_world_camera: NDArray[np.float64], *, with_colors: bool = True) -> Seen:
        depth = np.full((30, 40), self.distance - T_world_camera[0, 3], dtype=np.float32)
        return Seen(depth, np.full((30, 40, 3), round(20.0 * T_world_camera[0, 3]), dtype=np.uint8))


def test_kinect_depth_has_the_noise_and_the_steps_of_the_literature() -> None:
    # Barron and Malik: z = 351.3 / k for whole k (metres), k of a Gaussian of 1/6 about the true disparity.
    for true in (0.8, 2.0, 4.0):
        measured = kinect_depth(np.full((200, 300), true, np.float32), np.random.default_rng(1)).astype(np.float64)
        disparity = 351.3 / measured
        np.testing.assert_allclose(disparity, np.rint(disparity), rtol=0, atol=1e-3)  # of float32
        # The variance of rounding a Gaussian, at 351.3 / true +- 1/6, summed over the whole numbers.
        from scipy.stats import norm

        k = np.arange(np.floor(351.3 / true) - 3, np.ceil(351.3 / true) + 4)
        p = norm.cdf(k + 0.5, 351.3 / true, 1 / 6) - norm.cdf(k - 0.5, 351.3 / true, 1 / 6)
        shares = [(np.rint(disparity) == value).mean() for value in k]
        np.testing.assert_allclose(shares, p, rtol=0, atol=0.01)  # of 60,000 draws: 3 sigma is 0.006


def test_kinect_depth_is_missing_out_of_range_and_where_there_is_none() -> None:
    depth = np.full((20, 20), 2.0, np.float32)
    depth[:5], depth[5:10], depth[10:15] = 0.49, 5.1, 0.0
    measured = kinect_depth(depth, np.random.default_rng(0))
    assert not measured[:3].any() and not measured[7].any() and not measured[10:15].any()
    assert measured[17:].all()
    for limit in (0.51, 4.9):
        assert kinect_depth(np.full((20, 20), limit, np.float32), np.random.default_rng(0)).all()


def test_kinect_depth_is_that_of_a_place_half_a_pixel_away() -> None:
    from scipy.stats import norm

    # Depth tells the pixel: how often each neighbour was read, by rows and by columns.
    for axis in (0, 1):
        ramp = 1.0 + 0.1 * np.indices((30, 30))[axis]
        read = np.array([kinect_depth(ramp.astype(np.float32), np.random.default_rng(i)) for i in range(40)])
        offset = np.rint((read[:, 8:14, 8:14] - ramp[8:14, 8:14]) / 0.1)
        expected = norm.cdf(0.5, scale=0.5) - norm.cdf(-0.5, scale=0.5)
        assert (offset == 0).mean() == pytest.approx(expected, abs=0.03)  # 0.683, of 1,440 draws
        assert abs(offset.mean()) < 0.05


def test_an_edge_of_kinect_depth_is_ragged_but_holds_no_depth_in_between() -> None:
    depth = np.full((100, 100), 1.0, np.float32)
    depth[:, 50:] = 3.0
    measured = kinect_depth(depth, np.random.default_rng(0))
    near = np.abs(measured - 1.0) < 0.02
    assert (near | (np.abs(measured - 3.0) < 0.15)).all()
    assert 0.05 < near[:, 50].mean() < 0.6 and not near[:, 53:].any()


def test_depth_of_a_network_is_wrong_by_as_much_as_the_literature_says_and_smooth() -> None:
    depth = np.full((60, 80), 2.0, np.float32)
    relative = np.array([guessed_depth(depth, 3.0, seed) / 2.0 - 1.0 for seed in range(200)])
    assert np.abs(relative).mean() == pytest.approx(0.127, abs=0.012)
    logs = np.log1p(relative)
    # One factor a run, of 8 %, and one that goes over the image, of 13 %, most of which differs within an image.
    assert logs.std() == pytest.approx(np.hypot(0.08, 0.13), abs=0.012)
    assert 0.07 < logs.mean(axis=(1, 2)).std() < 0.14
    assert 0.06 < logs.std(axis=(1, 2)).mean() < 0.13
    # Neighbours differ by far less than the error itself.
    assert np.abs(np.diff(relative, axis=2)).max() < 0.05
    soon, later = (guessed_depth(depth, seconds, 0) / 2.0 - 1.0 for seconds in (3.1, 30.0))
    assert 1e-4 < np.abs(soon - relative[0]).max() < 0.06 < np.abs(later - relative[0]).max()


def test_depth_of_a_network_runs_over_edges_and_stays_missing_where_it_is() -> None:
    depth = np.full((60, 120), 1.0, np.float32)
    depth[:, 60:] = 3.0
    depth[:10] = 0.0
    guess = guessed_depth(depth, 0.0, 5)
    assert not guess[:10].any() and guess[10:].all()
    assert (np.diff(guess[30, 58:62]) > 0.2).all(), "the step is spread over several pixels"


def test_a_shaken_camera_trembles_as_much_as_stated_and_stands_still_where_the_robot_does() -> None:
    way = straight(4000)
    moved = shaken(way, 3)
    turn = Rotation.from_matrix(np.swapaxes(way.T_world_camera[:, :3, :3], 1, 2) @ moved.T_world_camera[:, :3, :3])
    turns, moves = turn.as_rotvec(), moved.positions - way.positions
    np.testing.assert_allclose(turns.std(axis=0), np.radians(0.3), rtol=0.15)
    np.testing.assert_allclose(moves.std(axis=0), 0.002, rtol=0.15)
    # Six tracks that have nothing to do with each other, made of 0.5 to 3 Hz.
    shaking = np.hstack([turns / np.radians(0.3), moves / 0.002])
    assert np.abs(np.corrcoef(shaking.T) - np.eye(6)).max() < 0.3
    power, hertz = np.abs(np.fft.rfft(shaking, axis=0)) ** 2, np.fft.rfftfreq(len(way), 0.1)
    assert power[(hertz > 0.45) & (hertz < 3.05)].sum() > 0.98 * power.sum()
    assert power[(hertz > 0.45) & (hertz < 1.5)].sum() > 0.1 * power.sum() < 10 * power[hertz > 1.5].sum()
    slow = shaken(straight(4000, speed=0.25), 3)
    np.testing.assert_allclose((slow.positions - straight(4000, speed=0.25).positions).std(axis=0), 0.001, rtol=0.15)
    np.testing.assert_array_equal(moved.T_world_camera, shaken(way, 3).T_world_camera)
    still = replace(way, T_world_camera=np.repeat(way.T_world_camera[:1], len(way), axis=0))
    np.testing.assert_allclose(shaken(still, 3).T_world_camera, still.T_world_camera, rtol=0, atol=1e-15)


def test_the_exposure_lies_around_the_stamp() -> None:
    way = straight()
    poses = exposure_poses(way, 20)
    steps = 0.02 * ((np.arange(8) + 0.5) / 8 - 0.5)
    np.testing.assert_allclose(poses[:, 0, 3], 2.0 + steps, rtol=0, atol=1e-9)
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    np.testing.assert_allclose(yaw, 0.2 * (2.0 + steps), rtol=0, atol=1e-9)
    assert exposure_poses(way, 0)[0, 0, 3] == 0.0, "before the first pose the camera rests"
    np.testing.assert_allclose(exposure_poses(way, 49)[-1], way.T_world_camera[49], rtol=0, atol=1e-15)


def test_blurred_colours_are_the_mean_over_the_exposure() -> None:
    way = straight(speed=50.0)  # 1 m, and so 20 grey values, an exposure
    frames = list(simulated_frames(Wall(), way.select(np.arange(3)), Effects(blur=True)).read(True))
    steps = 0.02 * ((np.arange(8) + 0.5) / 8 - 0.5)
    expected = np.mean(np.rint(20.0 * (50.0 * (0.1 + steps))))
    assert frames[1].colors is not None
    np.testing.assert_allclose(frames[1].colors.astype(float), expected, rtol=0, atol=0.5)
    assert frames[1].depth[0, 0] == np.float32(5.0), "depth is that of the stamp"


@pytest.mark.parametrize("names", [("kinect",), ("cnn",), ("blur", "shake", "kinect")])
def test_effects_depend_on_the_seed_and_the_frame_alone(names: tuple[str, ...]) -> None:
    effects = Effects.of(names, 7)
    stream = simulated_frames(Wall(4.0), camera_path(straight(6), effects), effects)
    first, again = list(stream.read(True)), list(stream.read(True))
    unlike = Effects.of(names, 8)
    other = list(simulated_frames(Wall(4.0), camera_path(straight(6), unlike), unlike).read(True))
    for a, b in zip(first, again, strict=True):
        assert a.depth.tobytes() == b.depth.tobytes() and a.colors.tobytes() == b.colors.tobytes()
    assert any(a.depth.tobytes() != b.depth.tobytes() for a, b in zip(first, other, strict=True))


def test_exact_depth_lies_beside_depth_with_noise() -> None:
    (frame,) = simulated_frames(Wall(), straight(1), Effects(cnn=True)).read(True)
    assert (frame.extras[EXACT_DEPTH] == 10.0).all() and (frame.depth != 10.0).all()
    (bare,) = simulated_frames(Wall(), straight(1)).read(False)
    assert bare.colors is None and not bare.extras


def test_effects_that_do_not_exist_or_contradict_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match="'fog' is no effect; allowed: kinect, cnn, blur, shake"):
        Effects.of(["fog"], 0)
    with pytest.raises(ValueError, match="both about depth"):
        Effects.of(["kinect", "cnn"], 0)
    for effects, words in ((Effects(blur=True), "blur"), (Effects(shake=True), "shaking")):
        with pytest.raises(ValueError, match=f"{words} needs poses with stamps"):
            simulated_frames(Wall(), camera_path(replace(straight(3), stamps_ns=None), effects), effects)


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (Seen(np.ones((30, 41), np.float32), np.zeros((30, 40, 3), np.uint8)), r"a wall: depth must be \(30, 40\)"),
        (Seen(np.ones((30, 40)), np.zeros((30, 40, 3), np.uint8)), "float32, got .* float64"),
        (Seen(np.full((30, 40), np.nan, np.float32), np.zeros((30, 40, 3), np.uint8)), "finite and not negative"),
        (Seen(np.full((30, 40), -1.0, np.float32), np.zeros((30, 40, 3), np.uint8)), "finite and not negative"),
        (Seen(np.ones((30, 40), np.float32), None), "got none"),
        (Seen(np.ones((30, 40), np.float32), np.zeros((30, 40, 4), np.uint8)), r"colors must be \(30, 40, 3\) uint8"),
    ],
)
def test_images_of_another_simulator_are_checked(seen: Seen, words: str) -> None:
    wall = Wall()
    wall.see = lambda *_, **__: seen  # type: ignore[method-assign]
    with pytest.raises(ValueError, match=words):
        list(simulated_frames(wall, straight(1)).read(True))


def test_every_frame_has_noise_of_its_own_whatever_was_read_before() -> None:
    still = straight(5, speed=0.0)
    frames = list(simulated_frames(Wall(4.0), still, Effects(kinect=True, seed=3)).read(True))
    assert len({frame.depth.tobytes() for frame in frames}) == 5
    np.testing.assert_array_equal(
        Effects(kinect=True, seed=3).depth(frames[4].extras[EXACT_DEPTH], 4, 0.4), frames[4].depth
    )
