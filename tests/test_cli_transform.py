"""`maomaps-warp transform` against plain NumPy."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shared_data import shared_data
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.io.clouds import read_cloud, write_cloud
from maomaps_warp.io.trajectories import read_trajectory, write_maomaps_poses, write_tum
from maomaps_warp.model.trajectory import Trajectory

RNG = np.random.default_rng(11)
POINTS = RNG.normal(size=(200, 3)) * 10.0
COLORS = RNG.integers(1, 256, (200, 3), dtype=np.uint8)
STAMPS = 1_305_031_229_000_000_123 + np.arange(9, dtype=np.int64) * 33_333_333
POSES = np.tile(np.eye(4), (9, 1, 1))
POSES[:, :3, :3] = Rotation.random(9, rng=RNG).as_matrix()
POSES[:, :3, 3] = RNG.normal(size=(9, 3))

START_TEXT = "1.5 -2.25 0.75\n0.3\n"
YAW = 0.3 + math.pi
#: Metres, and dimensionless for rotations: some roundings of float64 at 30 m.
ROUNDING = 1e-13
#: A rigid transform by hand: 90 degrees about x, then a shift.
RIGID = np.array([[1.0, 0, 0, 5], [0, 0, -1, 6], [0, 1, 0, 7], [0, 0, 0, 1]])
RIGID_LINE = f"12.5 5 6 7 {math.sqrt(0.5)} 0 0 {math.sqrt(0.5)}"


def turned(yaw: float) -> np.ndarray:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def run(*arguments: object) -> Any:
    result = CliRunner().invoke(app, ["transform", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def moved_cloud(folder: Path, *arguments: object) -> np.ndarray:
    """The points of `cloud.npz` after the command; colours must have stayed."""
    write_cloud(folder / "cloud.npz", POINTS, COLORS)
    result = run(folder / "cloud.npz", "-o", folder / "out.npz", "--overwrite", *arguments)
    assert result.exit_code == 0, result.stderr
    cloud = read_cloud(folder / "out.npz")
    np.testing.assert_array_equal(cloud.colors, COLORS)
    return cloud.points


@pytest.fixture
def start(tmp_path: Path) -> Path:
    path = tmp_path / "start_pose_first.txt"
    path.write_text(START_TEXT)
    return path


@pytest.fixture
def matrix(tmp_path: Path) -> Path:
    path = tmp_path / "T.txt"
    np.savetxt(path, RIGID)
    return path


@pytest.mark.parametrize(("correction", "radians"), [(None, 0.0), ("0.25", 0.25), ("-0.45", -0.45), ("sample7", 1.51)])
def test_a_start_pose_turns_by_yaw_and_pi_and_the_correction_then_shifts(
    tmp_path: Path, start: Path, correction: str | None, radians: float
) -> None:
    more = () if correction is None else ("--yaw-correction", correction)
    expected = POINTS @ turned(YAW + radians).T + [1.5, -2.25, 0.75]
    np.testing.assert_allclose(moved_cloud(tmp_path, "--start-pose", start, *more), expected, rtol=0, atol=ROUNDING)


def test_the_inverse_of_a_start_pose_shifts_back_then_turns_back(tmp_path: Path, start: Path) -> None:
    found = moved_cloud(tmp_path, "--start-pose", start, "--yaw-correction", "0.07", "--inverse")
    expected = (POINTS - [1.5, -2.25, 0.75]) @ turned(YAW + 0.07)
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING)


def test_a_matrix_and_a_tum_line_move_alike_and_scale_comes_before_the_shift(tmp_path: Path, matrix: Path) -> None:
    expected = POINTS @ RIGID[:3, :3].T + RIGID[:3, 3]
    np.testing.assert_allclose(moved_cloud(tmp_path, "--matrix", matrix), expected, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(moved_cloud(tmp_path, "--tum", RIGID_LINE), expected, rtol=0, atol=ROUNDING)
    scaled = 2.5 * POINTS @ RIGID[:3, :3].T + RIGID[:3, 3]
    found = moved_cloud(tmp_path, "--matrix", matrix, "--scale", 2.5)
    np.testing.assert_allclose(found, scaled, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("way", ["start", "matrix"])
@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_inverse_restores(tmp_path: Path, request: pytest.FixtureRequest, way: str, scale: float) -> None:
    option = "--start-pose" if way == "start" else "--matrix"
    arguments = (option, request.getfixturevalue(way), "--scale", scale)
    write_cloud(tmp_path / "cloud.ply", POINTS, COLORS)
    assert run(tmp_path / "cloud.ply", "-o", tmp_path / "there.ply", *arguments).exit_code == 0
    assert run(tmp_path / "there.ply", "-o", tmp_path / "back.txt", *arguments, "--inverse").exit_code == 0
    back = read_cloud(tmp_path / "back.txt")
    assert np.abs(read_cloud(tmp_path / "there.ply").points - POINTS).max() > 1.0
    np.testing.assert_allclose(back.points, POINTS, rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(back.colors, COLORS)


def test_poses_move_with_their_rotations_and_keep_their_stamps(tmp_path: Path, start: Path) -> None:
    write_tum(tmp_path / "poses.txt", Trajectory(POSES, STAMPS))
    out = tmp_path / "out.txt"
    result = run(tmp_path / "poses.txt", "-o", out, "--start-pose", start, "--scale", 2)
    assert result.exit_code == 0, result.stderr
    rows = np.loadtxt(out)
    R = turned(YAW)
    np.testing.assert_allclose(rows[:, 1:4], 2 * POSES[:, :3, 3] @ R.T + [1.5, -2.25, 0.75], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(Rotation.from_quat(rows[:, 4:]).as_matrix(), R @ POSES[:, :3, :3], rtol=0, atol=ROUNDING)
    assert [line.split()[0] for line in out.read_text().splitlines()[1:]] == [
        f"{s // 10**9}.{s % 10**9:09d}" for s in STAMPS
    ]


def test_poses_of_maomaps_stay_so_with_their_stamps_and_become_tum_on_request(tmp_path: Path, matrix: Path) -> None:
    write_maomaps_poses(tmp_path / "poses.txt", Trajectory(POSES, STAMPS))
    result = run(tmp_path / "poses.txt", "-o", tmp_path / "out.txt", "--matrix", matrix)
    assert result.exit_code == 0, result.stderr
    assert len((tmp_path / "out.txt").read_text().splitlines()[0].split()) == 6
    assert (tmp_path / "out_timestamps.txt").read_bytes() == (tmp_path / "poses_timestamps.txt").read_bytes()
    assert run(tmp_path / "poses.txt", "-o", tmp_path / "tum.txt", "--matrix", matrix, "--to", "tum").exit_code == 0
    for name in ("out.txt", "tum.txt"):
        moved = read_trajectory(tmp_path / name)
        np.testing.assert_allclose(moved.T_world_camera, RIGID @ POSES, rtol=0, atol=ROUNDING)
        np.testing.assert_array_equal(moved.stamps_ns, STAMPS)


def test_poses_without_stamps_become_maomaps_and_tum_is_refused(tmp_path: Path, matrix: Path) -> None:
    np.savetxt(tmp_path / "kitti.txt", POSES[:, :3].reshape(-1, 12))
    result = run(tmp_path / "kitti.txt", "-o", tmp_path / "out.txt", "--matrix", matrix)
    assert result.exit_code == 0, result.stderr
    assert "taken for optical" in result.stdout
    np.testing.assert_allclose(read_trajectory(tmp_path / "out.txt").T_world_camera, RIGID @ POSES, rtol=0, atol=1e-12)
    assert not (tmp_path / "out_timestamps.txt").exists()
    refused(tmp_path, "no stamps", tmp_path / "kitti.txt", "-o", tmp_path / "x.txt", "--matrix", matrix, "--to", "tum")


def test_pose_frame_says_how_poses_are_read(tmp_path: Path, matrix: Path) -> None:
    write_tum(tmp_path / "poses.txt", Trajectory(np.linalg.inv(POSES), STAMPS))
    arguments = ("--matrix", matrix, "--pose-frame", "optical-inverse")
    result = run(tmp_path / "poses.txt", "-o", tmp_path / "out.txt", *arguments)
    assert "read as optical-inverse" in result.stdout
    found = read_trajectory(tmp_path / "out.txt").T_world_camera
    np.testing.assert_allclose(found, RIGID @ POSES, rtol=0, atol=1e-12)


def test_millimetres_survive_a_move_far_out(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.ply", POINTS)
    for suffix in (".pcd", ".txt"):
        out = tmp_path / f"out{suffix}"
        assert run(tmp_path / "cloud.ply", "-o", out, "--tum", "4000000 -700000 0 0 0 0 1").exit_code == 0
        np.testing.assert_array_equal(read_cloud(out).points, POINTS + [4e6, -7e5, 0])


def test_a_real_trajectory_comes_back_after_there_and_back(tmp_path: Path) -> None:
    path = shared_data("rgbd_tum_fr1_rpy_a") / "groundtruth.txt"
    arguments = ("--tum", "0 1 -2 3 0.5 0.5 -0.5 0.5")
    assert run(path, "-o", tmp_path / "there.txt", *arguments).exit_code == 0
    assert run(tmp_path / "there.txt", "-o", tmp_path / "back.txt", *arguments, "--inverse").exit_code == 0
    former, back = np.loadtxt(path), np.loadtxt(tmp_path / "back.txt")
    np.testing.assert_allclose(back[:, :4], former[:, :4], rtol=0, atol=1e-12)
    # Files hold quaternions of four decimals, whose norm is mended in reading, and either sign.
    assert np.abs((back[:, 4:] * former[:, 4:]).sum(axis=1)).min() > 0.999


def refused(folder: Path, words: str, *arguments: object) -> None:
    """Exit code 2, one line with the words, and no file that was not there before."""
    before = {path: path.read_bytes() for path in folder.iterdir()}
    result = run(*arguments)
    assert result.exit_code == 2 and result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("maomaps-warp: error: ") and words in line, line
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_exactly_one_way_is_needed(tmp_path: Path, start: Path, matrix: Path) -> None:
    write_cloud(tmp_path / "cloud.npz", POINTS)
    call = (tmp_path / "cloud.npz", "-o", tmp_path / "out.npz")
    refused(tmp_path, "no transform given", *call)
    refused(tmp_path, "--start-pose and --matrix given together", *call, "--start-pose", start, "--matrix", matrix)
    refused(tmp_path, "--matrix and --tum given together", *call, "--matrix", matrix, "--tum", RIGID_LINE)
    refused(tmp_path, "given without --start-pose", *call, "--matrix", matrix, "--yaw-correction", "0.1")
    refused(tmp_path, "sample1 to sample20", *call, "--start-pose", start, "--yaw-correction", "sample21")


@pytest.mark.filterwarnings("error")
def test_a_move_beyond_all_numbers_is_refused(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.npz", POINTS)
    write_tum(tmp_path / "poses.txt", Trajectory(POSES, STAMPS))
    for name, out in (("cloud.npz", "out.npz"), ("poses.txt", "out.txt")):
        call = (tmp_path / name, "-o", tmp_path / out, "--tum", RIGID_LINE, "--scale", "1.7e308")
        refused(tmp_path, "beyond what numbers hold", *call)


def test_a_matrix_with_a_scale_is_sent_to_the_option(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.npz", POINTS)
    similarity = RIGID.copy()
    similarity[:3, :3] *= 1.25
    np.savetxt(tmp_path / "S.txt", similarity)
    refused(
        tmp_path, "--scale 1.25", tmp_path / "cloud.npz", "-o", tmp_path / "out.npz", "--matrix", tmp_path / "S.txt"
    )


@pytest.mark.parametrize("scale", ["0", "-1", "inf", "nan"])
def test_scales_that_are_none_are_refused(tmp_path: Path, matrix: Path, scale: str) -> None:
    write_cloud(tmp_path / "cloud.npz", POINTS)
    call = (tmp_path / "cloud.npz", "-o", tmp_path / "out.npz")
    refused(tmp_path, "a number above 0", *call, "--matrix", matrix, "--scale", scale)


def test_outputs_are_neither_guessed_nor_overwritten(tmp_path: Path, matrix: Path) -> None:
    write_cloud(tmp_path / "cloud.npz", POINTS)
    write_maomaps_poses(tmp_path / "poses.txt", Trajectory(POSES, STAMPS))
    (tmp_path / "old.ply").write_text("precious")
    (tmp_path / "old_timestamps.txt").write_text("precious")
    by = ("--matrix", matrix)
    cloud, poses = tmp_path / "cloud.npz", tmp_path / "poses.txt"
    refused(tmp_path, "exists already", cloud, "-o", tmp_path / "old.ply", *by)
    refused(tmp_path, "is the input", cloud, "-o", cloud, "--overwrite", *by)
    refused(tmp_path, "no cloud can be written as '.las'", cloud, "-o", tmp_path / "out.las", *by)
    refused(tmp_path, "holds poses", poses, "-o", tmp_path / "out.ply", *by)
    refused(tmp_path, "old_timestamps.txt: exists already", poses, "-o", tmp_path / "old.txt", *by)
    refused(tmp_path, "belongs to it", poses, "-o", tmp_path / "poses_timestamps.txt", "--overwrite", *by)
    refused(tmp_path, "no folder", cloud, "-o", tmp_path / "nowhere" / "out.ply", *by)
    refused(tmp_path, "--pose-frame", cloud, "-o", tmp_path / "out.ply", "--pose-frame", "body", *by)
    refused(tmp_path, "--to", cloud, "-o", tmp_path / "out.ply", "--to", "tum", *by)


def test_other_inputs_are_refused(tmp_path: Path, matrix: Path) -> None:
    by = ("-o", tmp_path / "out.txt", "--matrix", matrix)
    (tmp_path / "letter.txt").write_text("Dear Sir\n")
    refused(tmp_path, "no such file", tmp_path / "nothing.txt", *by)
    refused(tmp_path, "letter.txt: cannot be recognised", tmp_path / "letter.txt", *by)
    result = run(shared_data("bags_pointcloud") / "ros_numpy_test.bag", *by)
    assert result.exit_code == 2 and "is a bag" in result.stderr and "`extract`" in result.stderr
    result = run(tmp_path, *by)
    assert result.exit_code == 2 and "is a folder" in result.stderr
