"""`record`: a virtual robot's recording, read back, mapped, and refused where it cannot be made."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from typer.testing import CliRunner, Result

from maomaps_warp.cli.app import app
from maomaps_warp.io.sources import SourceOptions, open_source
from maomaps_warp.io.trajectories import write_tum
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.scene import furnished_flat

SMALL = ("--camera", "40x30@90", "--antialias", "1", "--rate", "4", "--device", "cpu")
#: Quaternions in bags are float64.
POSE_TOLERANCE = 1e-12


def record(scene: object, output: Path, *options: str) -> Result:
    return CliRunner().invoke(app, ["record", str(scene), "-o", str(output), *SMALL, *options])


def read(bag: Path) -> tuple[Trajectory, list]:
    source = open_source(bag, SourceOptions(pose_frame="maomaps-c"), "gt")
    assert source.trajectory is not None and source.frames is not None
    return source.trajectory, list(source.frames.read(True))


@pytest.mark.parametrize("name", ["run.bag", "run.mcap", "run"])
def test_an_exploration_is_a_bag_that_the_toolbox_reads(tmp_path: Path, name: str) -> None:
    done = record("flat:1", tmp_path / name, "--duration", "5")
    assert done.exit_code == 0, done.output
    trajectory, frames = read(tmp_path / name)
    assert len(frames) == len(trajectory) == 21
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
    heights = trajectory.positions[:, 2] - furnished_flat(1).floor_z
    np.testing.assert_allclose(heights, 1.0, rtol=0, atol=0.021)
    assert all((frame.depth > 0).all() and frame.colors is not None and frame.colors.std() > 5 for frame in frames)
    assert "21 frames" in done.stdout and "m2 free" in done.stdout


def test_the_same_seed_gives_the_same_bytes_and_another_another_way(tmp_path: Path) -> None:
    for name, seed in (("a.bag", "3"), ("b.bag", "3"), ("c.bag", "4")):
        assert record("flat", tmp_path / name, "--duration", "4", "--seed", seed).exit_code == 0
    a, b, c = ((tmp_path / f"{name}.bag").read_bytes() for name in "abc")
    assert a == b and a != c


def test_the_robot_goes_along_waypoints(tmp_path: Path) -> None:
    scene = furnished_flat(0)
    first, second = scene.tour[0], scene.tour[8]
    places = [option for x, y in (first, second) for option in ("--waypoint", f"{x:.3f},{y:.3f}")]
    done = record("flat:0", tmp_path / "run.bag", *places)
    assert done.exit_code == 0, done.output
    trajectory, _ = read(tmp_path / "run.bag")
    np.testing.assert_allclose(trajectory.positions[[0, -1], :2], [first, second], rtol=0, atol=0.15)


def test_one_waypoint_is_a_goal_from_the_middle(tmp_path: Path) -> None:
    goal = furnished_flat(0).tour[8]
    done = record("flat:0", tmp_path / "run.bag", "--waypoint", f"{goal[0]:.3f},{goal[1]:.3f}")
    assert done.exit_code == 0, done.output
    trajectory, _ = read(tmp_path / "run.bag")
    np.testing.assert_allclose(trajectory.positions[-1, :2], goal, rtol=0, atol=0.15)
    middle = furnished_flat(0).world.bounds[:, :2].mean(axis=0)
    assert np.linalg.norm(trajectory.positions[0, :2] - middle) < 1.5 < trajectory.path_length


def test_a_trajectory_is_followed_exactly(tmp_path: Path) -> None:
    from maomaps_warp.sim.agent import drive

    way = drive(furnished_flat(0), frames=240, seed=1).select(np.arange(0, 240, 24))
    write_tum(tmp_path / "way.txt", way)
    done = record("flat:0", tmp_path / "run.bag", "--trajectory", str(tmp_path / "way.txt"))
    assert done.exit_code == 0, done.output
    trajectory, frames = read(tmp_path / "run.bag")
    np.testing.assert_array_equal(trajectory.stamps_ns, way.stamps_ns)
    np.testing.assert_allclose(trajectory.T_world_camera, way.T_world_camera, rtol=0, atol=POSE_TOLERANCE)
    assert len(frames) == 10


def test_a_recording_is_proved_by_check_and_mapped(tmp_path: Path) -> None:
    from maomaps_warp.mapping.cloud_map import voxelise
    from maomaps_warp.model.voxels import VoxelGrid

    bag = tmp_path / "run.bag"
    done = record("flat:0", bag, "--duration", "20", "--camera", "80x60@90", "--rate", "5")
    assert done.exit_code == 0, done.output
    checked = CliRunner().invoke(app, ["check", str(bag)])
    assert "verdict       clear: --pose-frame body" in checked.stdout, checked.output
    mapped = CliRunner().invoke(app, ["map", str(bag), "-o", str(tmp_path / "sample"), "--device", "cpu"])
    assert mapped.exit_code == 0, mapped.output
    points = np.loadtxt(tmp_path / "sample" / "gt_points_first.txt")
    scene = furnished_flat(0)
    mesh = trimesh.Trimesh(scene.vertices, scene.triangles, process=False)
    surface, _ = trimesh.sample.sample_surface(mesh, 1_000_000, seed=0)
    distance, _ = cKDTree(surface).query(points[:: max(1, len(points) // 5000)])
    # A voxel's centre is at most half its diagonal from a sample in it; points of the surface are 2 cm apart.
    assert distance.max() <= 0.05 * np.sqrt(3) / 2 + 0.02
    assert len(voxelise(points, VoxelGrid.around(points, 0.05))) > 3000


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--start", "100,100"), r"\(100, 100\): no place for a robot .*the nearest free place is"),
        (("--waypoint", "1;2"), "--waypoint 1;2: is no place"),
        (("--duration", "0"), "--duration 0: must be above 0"),
        (("--radius", "3"), "fits nowhere"),
        (("--camera-height", "2"), "camera_height <= height"),
        (("--trajectory", "nowhere.txt"), "nowhere.txt: no such file"),
        (("--trajectory", "t.txt", "--start", "0,0"), "give one or the other"),
        (("--camera", "wide"), "wide"),
        (("--speed", "0"), "must be positive"),
        (("--speed", "inf"), "must be positive"),
        (("--robot-height", "inf"), "camera_height <= height"),
        (("--radius", "inf"), "needs a radius"),
        (("--radius", "1e-9"), "needs a radius of at least 0.02 m"),
        (("--rate", "nan"), "must be positive"),
        (("--turn-rate", "nan"), "must be positive"),
        (("--floor", "nan"), "--floor nan: must be a number"),
        (("--floor", "50"), "no floor lies at 50 m"),
        (("--camera", "100000x100000@90"), "at most 1e8"),
        (("--effect", "fog"), "'fog' is no effect"),
        (("--effect", "kinect", "--effect", "cnn"), "both about depth"),
        (("--trajectory", "t.txt", "--duration", "5"), "given beside --duration"),
    ],
)
def test_what_cannot_be_recorded_is_one_line_and_leaves_nothing(
    tmp_path: Path, options: tuple[str, ...], words: str
) -> None:
    done = record("flat", tmp_path / "run.bag", *options)
    assert done.exit_code == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("maomaps-warp: error: ")
    import re

    assert re.search(words, line), line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("scene", "words"),
    [("flat:x", "is no seed"), ("nowhere.glb", "no such file"), ("room.stl", "is no scene")],
)
def test_what_is_no_scene_is_one_line(tmp_path: Path, scene: str, words: str) -> None:
    done = record(scene, tmp_path / "run.bag")
    assert done.exit_code == 2 and words in done.stderr and not list(tmp_path.iterdir())


def test_a_bag_that_stands_there_is_kept(tmp_path: Path) -> None:
    (tmp_path / "run.bag").write_text("precious")
    assert record("flat", tmp_path / "run.bag").exit_code == 2
    assert (tmp_path / "run.bag").read_text() == "precious"


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_leaves_a_readable_bag_of_what_was_recorded(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "maomaps_warp", "record", "flat", "-o", str(tmp_path / "run.bag"), *SMALL]
    command += ["--duration", "2000", "--antialias", "4"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    started = time.monotonic()
    while not any(file.stat().st_size > 100_000 for file in tmp_path.glob(".*/run.bag")):
        assert running.poll() is None and time.monotonic() - started < 120.0, running.communicate()
        time.sleep(0.02)
    running.send_signal(signal.SIGINT)
    output, errors = running.communicate(timeout=60)
    assert running.returncode == 130, errors
    _, frames = read(tmp_path / "run.bag")
    assert f"stopped after {len(frames)} of " in output and len(frames) > 2
    assert [file.name for file in tmp_path.iterdir()] == ["run.bag"]


def test_waypoints_are_reached_however_long_that_takes(tmp_path: Path) -> None:
    goal = furnished_flat(0).tour[8]
    waypoint = ("--waypoint", f"{goal[0]:.3f},{goal[1]:.3f}", "--speed", "0.04", "--rate", "0.5")
    done = record("flat:0", tmp_path / "run.bag", *waypoint)
    assert done.exit_code == 0, done.output
    trajectory, _ = read(tmp_path / "run.bag")
    assert trajectory.duration_s is not None and trajectory.duration_s > 60.0
    np.testing.assert_allclose(trajectory.positions[-1, :2], goal, rtol=0, atol=0.15)


def test_pitch_and_turn_rate_are_in_degrees(tmp_path: Path) -> None:
    options = ("--pitch", "-20", "--turn-rate", "15", "--duration", "15", "--rate", "10")
    assert record("flat:1", tmp_path / "run.bag", *options).exit_code == 0
    trajectory, _ = read(tmp_path / "run.bag")
    axes = trajectory.T_world_camera[:, :3, 2]
    np.testing.assert_allclose(axes[:, 2], np.sin(np.radians(-20.0)), rtol=0, atol=1e-9)
    yaw = np.unwrap(np.arctan2(axes[:, 1], axes[:, 0]))
    fastest = np.degrees(np.abs(np.diff(yaw)).max() / 0.1)
    assert 10.0 < fastest < 15.1


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_terminated_recording_leaves_a_readable_bag_too(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "maomaps_warp", "record", "flat", "-o", str(tmp_path / "run.bag"), *SMALL]
    running = subprocess.Popen([*command, "--duration", "2000", "--antialias", "4"], stdout=subprocess.PIPE, text=True)
    started = time.monotonic()
    while not any(file.stat().st_size > 100_000 for file in tmp_path.glob(".*/run.bag")):
        assert running.poll() is None and time.monotonic() - started < 120.0
        time.sleep(0.02)
    running.send_signal(signal.SIGTERM)
    running.communicate(timeout=60)
    assert running.returncode == 130
    trajectory, frames = read(tmp_path / "run.bag")
    assert len(frames) == len(trajectory) > 2
    assert [file.name for file in tmp_path.iterdir()] == ["run.bag"]
