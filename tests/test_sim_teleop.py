"""A robot driven by keys."""

from __future__ import annotations

import numpy as np

from maomaps_warp.sim.driving import Driving
from maomaps_warp.sim.free_space import FreeSpace
from maomaps_warp.sim.teleop import HOLD_S, Teleop

#: 4 m x 3 m, free but for a wall of half a metre around and a pillar; floor at 0.5 m.
FREE = np.zeros((81, 61), dtype=bool)
FREE[10:71, 10:51] = True
FREE[40:50, 25:35] = False
SPACE = FreeSpace(np.array([0.0, 0.0]), 0.05, FREE, 0.5)
DRIVING = Driving(speed=0.5, turn_rate=1.0, rate_hz=10.0)


class Clock:
    """Seconds that pass only when they are told to."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


def robot(x: float = 1.0, y: float = 1.5, yaw: float = 0.0, driving: Driving = DRIVING) -> Teleop:
    return turned(Teleop(SPACE, driving, 1.0, np.array([x, y]), now=Clock()), yaw)


def turned(teleop: Teleop, yaw: float) -> Teleop:
    teleop.yaw = yaw
    return teleop


def step(teleop: Teleop, seconds: float = 0.1) -> None:
    teleop._now.seconds += seconds
    teleop.step()


def hold(teleop: Teleop, key: str, seconds: float) -> None:
    for _ in range(round(10 * seconds)):
        teleop.press(key)  # type: ignore[arg-type]
        step(teleop)


def test_it_speeds_up_goes_and_comes_to_rest() -> None:
    teleop = robot(0.6)
    hold(teleop, "forward", 1.0)
    assert teleop.speed == 0.5
    # 0.1, 0.2, ... 0.5 m/s at an acceleration of 1 m/s2, then five steps of 0.5 m/s, a tenth of a second each.
    np.testing.assert_allclose(teleop.place, [0.6 + 0.15 + 0.25, 1.5], rtol=0, atol=1e-9)
    for _ in range(round(10 * (HOLD_S + 0.6))):
        step(teleop)
    assert teleop.speed == 0.0, "a key that is not heard of any more is let go"


def test_stop_lets_go_of_all_keys() -> None:
    teleop = robot()
    hold(teleop, "forward", 1.0)
    teleop.press("stop")
    for _ in range(5):
        step(teleop)
    assert teleop.speed == 0.0


def test_left_turns_left_and_back_goes_back() -> None:
    teleop = robot()
    hold(teleop, "left", 1.0)
    assert 0.5 < teleop.yaw < 1.0
    teleop = robot()
    hold(teleop, "back", 0.8)
    assert teleop.place[0] < 0.8 and teleop.place[1] == 1.5


def test_it_never_leaves_the_free_space_and_slides_along_walls() -> None:
    teleop = robot(1.0, 1.0, yaw=-0.5)
    hold(teleop, "forward", 8.0)
    assert SPACE.holds(teleop.place[None])[0]
    np.testing.assert_allclose(teleop.place[1], 0.5, rtol=0, atol=0.05)
    assert teleop.place[0] > 3.0, "it slid along the wall"
    rng = np.random.default_rng(0)
    wild = robot()
    for _ in range(2000):
        wild.press(rng.choice(["forward", "forward", "back", "left", "right"]))
        step(wild)
        assert SPACE.holds(wild.place[None])[0]


def test_the_camera_looks_where_the_robot_goes() -> None:
    T = robot(1.0, 1.5, yaw=np.pi / 2).T_world_camera
    np.testing.assert_allclose(T[:3, 3], [1.0, 1.5, 1.5])
    np.testing.assert_allclose(T[:3, 2], [0.0, 1.0, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(T[:3, 1], [0.0, 0.0, -1.0], rtol=0, atol=1e-12)


def test_a_key_counts_for_one_step_however_long_that_is() -> None:
    teleop = robot(y=0.8, driving=Driving(speed=0.5, turn_rate=1.0, rate_hz=0.5))
    teleop.press("forward")
    step(teleop, 2.0)
    assert teleop.speed == 0.5 and teleop.place[0] > 1.5
    step(teleop, 2.0)
    assert teleop.speed == 0.0


def test_keys_are_timed_by_the_clock_and_not_by_the_robots_steps() -> None:
    slow = robot()
    slow.press("forward")
    step(slow, 1.0)  # a view that takes a second a frame
    step(slow, 1.0)
    assert slow.speed == 0.0


def test_it_slides_along_a_slanted_wall_and_stands_before_one_that_it_meets_head_on() -> None:
    free = np.ones((121, 121), dtype=bool)
    x, y = np.indices(free.shape) * 0.05
    free[y < 1.0 + 0.105 * x] = False  # 6 degrees
    space = FreeSpace(np.zeros(2), 0.05, free, 0.0)
    for heading in (5.0, 15.0, 30.0, 45.0, 60.0):
        slanted = turned(Teleop(space, DRIVING, 1.0, np.array([1.0, 1.3]), now=Clock()), -np.radians(heading))
        hold(slanted, "forward", 16.0)
        assert slanted.place[0] > 4.0 and slanted.place[1] > 1.4 and space.holds(slanted.place[None])[0], heading
    head_on = robot(1.0, 1.0, yaw=-np.pi / 2)
    hold(head_on, "forward", 4.0)
    assert head_on.speed == 0.0 and abs(head_on.place[0] - 1.0) < 0.01


def test_left_and_right_are_mirror_images_and_stop_stops_turning_too() -> None:
    left, right = robot(), robot()
    hold(left, "left", 0.5)
    hold(right, "right", 0.5)
    assert left.yaw == -right.yaw > 0.05
    left.press("stop")
    for _ in range(5):
        step(left)
    assert left.turn_rate == 0.0


def test_a_key_is_held_for_six_tenths_of_a_second() -> None:
    for seconds, is_held in ((0.55, True), (0.65, False)):
        teleop = robot()
        teleop.press("forward")
        step(teleop, 0.01)
        before = teleop.speed
        step(teleop, seconds - 0.01)
        assert (teleop.speed > before) == is_held
