"""Trajectories in text files: what is read, what is refused, what is written."""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shared_data import shared_data, shared_reference

from maomaps_warp.errors import InputError
from maomaps_warp.io.rotations import matrices_from_quaternions, matrices_from_rpy, rpy_from_matrices
from maomaps_warp.io.tables import read_table
from maomaps_warp.io.trajectories import (
    read_trajectory,
    recognise_trajectory,
    write_maomaps_poses,
    write_tum,
)
from maomaps_warp.model.pose_convention import T_BODY_CAMERA
from maomaps_warp.model.trajectory import Trajectory

#: Entries of rotation matrices, dimensionless: a few float64 roundings.
ROTATION_TOLERANCE = 1e-14
#: The same, after trigonometric functions went there and back.
ANGLE_TOLERANCE = 1e-13

TUM = "1.5 1 2 3 0 0 0 1\n1.6 1 2 4 0 0 0 1\n"
KITTI_ROW = "1 0 0 {x} 0 1 0 2 0 0 1 3\n"
EUROC = "#timestamp, x, y, z, w, x, y, z\n1403715524907143168,1,2,3,1,0,0,0\n1403715524912143104,1,2,4,0,1,0,0\n"


def written(folder, text, name="run.txt"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return path


def error_of(path, **options):
    with pytest.raises(InputError) as caught:
        read_trajectory(path, **options)
    return str(caught.value)


def test_tum_stamps_are_exact_to_the_nanosecond(tmp_path):
    texts = ["1403715529.112143517", "1.403715529212142944e+09", "1403715530"]
    rows = "".join(f"{text} 0 0 0 0 0 0 1\n" for text in texts)
    stamps = read_trajectory(written(tmp_path, rows)).stamps_ns
    assert stamps.tolist() == [1403715529112143517, 1403715529212142944, 1403715530000000000]


def test_tum_quaternions_are_xyzw(tmp_path):
    half = math.sqrt(0.5)
    run = read_trajectory(written(tmp_path, f"0 1 2 3 0 0 {half!r} {half!r}\n"))
    quarter_turn_about_z = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(run.T_world_camera, [quarter_turn_about_z], rtol=0, atol=ROTATION_TOLERANCE)


def test_euroc_quaternions_come_w_first_and_further_columns_are_ignored(tmp_path):
    run = read_trajectory(written(tmp_path, EUROC, "data.csv"))
    assert run.stamps_ns.tolist() == [1403715524907143168, 1403715524912143104]
    half_turn_about_x = np.diag([1.0, -1.0, -1.0])
    np.testing.assert_allclose(run.T_world_camera[1, :3, :3], half_turn_about_x, rtol=0, atol=ROTATION_TOLERANCE)
    longer = EUROC.replace(",1,0,0,0\n", ",1,0,0,0,9,9\n").replace(",0,1,0,0\n", ",0,1,0,0,9,9\n")
    again = read_trajectory(written(tmp_path, longer, "longer.csv"))
    assert (again.T_world_camera == run.T_world_camera).all()


def test_kitti_matrices_are_row_major_and_take_the_times_beside_them(tmp_path):
    text = "0 -1 0 5 1 0 0 6 0 0 1 7\n" + KITTI_ROW.format(x=1)
    path = written(tmp_path, text, "00.txt")
    assert read_trajectory(path).stamps_ns is None
    written(tmp_path, "0.1\n2.073381e-01\n", "00_times.txt")
    run = read_trajectory(path)
    assert run.stamps_ns.tolist() == [100_000_000, 207_338_100]
    expected = [[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]
    np.testing.assert_allclose(run.T_world_camera[0], expected, rtol=0, atol=ROTATION_TOLERANCE)


def test_a_common_kitti_times_file_counts_only_if_it_is_as_long(tmp_path):
    path = written(tmp_path, KITTI_ROW.format(x=1) + KITTI_ROW.format(x=2), "00.txt")
    written(tmp_path, "0.0\n0.1\n0.2\n", "times.txt")
    run = read_trajectory(path)
    assert run.stamps_ns is None
    assert "3 stamps for 2 poses" in run.notes[0]
    written(tmp_path, "0.0\n0.1\n", "times.txt")
    assert read_trajectory(path).stamps_ns.tolist() == [0, 100_000_000]


def test_kitti_rotations_of_few_digits_become_exact_rotations(tmp_path):
    exact = matrices_from_rpy(np.array([0.3]), np.array([-0.7]), np.array([2.1]))[0]
    row = " ".join(f"{v:.6e}" for v in np.column_stack([exact, [1, 2, 3]]).ravel())
    R = read_trajectory(written(tmp_path, row)).T_world_camera[0, :3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), rtol=0, atol=ROTATION_TOLERANCE)
    np.testing.assert_allclose(R, exact, rtol=0, atol=1e-6)  # dimensionless: the text has six decimals


def test_maomaps_poses_are_of_the_body_and_become_optical(tmp_path):
    yaw = math.pi / 2
    run = read_trajectory(written(tmp_path, f"1 2 3 0 0 {yaw!r}\n"))
    # Facing +y with z up: the optical axis is +y, the image's right +x, its down -z.
    looks, right, down = (
        run.T_world_camera[0, :3, 2],
        run.T_world_camera[0, :3, 0],
        run.T_world_camera[0, :3, 1],
    )
    np.testing.assert_allclose(looks, [0, 1, 0], rtol=0, atol=ROTATION_TOLERANCE)
    np.testing.assert_allclose(right, [1, 0, 0], rtol=0, atol=ROTATION_TOLERANCE)
    np.testing.assert_allclose(down, [0, 0, -1], rtol=0, atol=ROTATION_TOLERANCE)
    assert run.positions.tolist() == [[1, 2, 3]]


def test_maomaps_stamps_stand_beside_the_poses(tmp_path):
    path = written(tmp_path, "0 0 0 0 0 0\n1 0 0 0 0 0\n", "gt_poses_first.txt")
    written(tmp_path, "10.000000001\n10.5\n", "gt_poses_first_timestamps.txt")
    assert read_trajectory(path).stamps_ns.tolist() == [10_000_000_001, 10_500_000_000]


def test_a_frame_can_be_forced(tmp_path):
    path = written(tmp_path, TUM)
    body, optical = read_trajectory(path, pose_frame="body"), read_trajectory(path, pose_frame="optical")
    assert (optical.T_world_camera[0, :3, :3] == np.eye(3)).all()
    assert (body.T_world_camera[0, :3, :3] == [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]).all()
    assert (body.positions == optical.positions).all()


def test_optical_axes_in_the_body_frame():
    right, down, forward = np.eye(4)[:, 0], np.eye(4)[:, 1], np.eye(4)[:, 2]
    assert (T_BODY_CAMERA @ forward)[:3].tolist() == [1, 0, 0]
    assert (T_BODY_CAMERA @ right)[:3].tolist() == [0, -1, 0]
    assert (T_BODY_CAMERA @ down)[:3].tolist() == [0, 0, -1]


def test_roll_pitch_yaw_multiply_in_the_documented_order():
    roll, pitch, yaw = 0.3, -0.4, 2.0
    Rx = [[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]]
    Ry = [[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]]
    Rz = [[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]]
    expected = np.array(Rz) @ np.array(Ry) @ np.array(Rx)
    found = matrices_from_rpy(np.array([roll]), np.array([pitch]), np.array([yaw]))[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROTATION_TOLERANCE)


@given(st.floats(-4, 4), st.sampled_from([-math.pi / 2, math.pi / 2, 1.5707963, 0.0, 1.2]), st.floats(-4, 4))
def test_angles_give_their_rotation_back_even_looking_straight_up(roll, pitch, yaw):
    R = matrices_from_rpy(np.array([roll]), np.array([pitch]), np.array([yaw]))
    again = matrices_from_rpy(*rpy_from_matrices(R).T)
    np.testing.assert_allclose(again, R, rtol=0, atol=ANGLE_TOLERANCE)


def a_trajectory(seed=0, count=20, stamps=True):
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = matrices_from_quaternions(rng.normal(size=(count, 4)))
    T[:, :3, 3] = rng.normal(size=(count, 3)) * [1, 1e6, 1e-6]
    stamps_ns = 1403715529112143517 + np.arange(count, dtype=np.int64) * 33_333_333 if stamps else None
    return Trajectory(T, stamps_ns)


def test_a_written_tum_file_gives_the_trajectory_back(tmp_path):
    run = a_trajectory()
    write_tum(tmp_path / "run.txt", run)
    again = read_trajectory(tmp_path / "run.txt")
    assert (again.stamps_ns == run.stamps_ns).all()
    assert (again.positions == run.positions).all()
    np.testing.assert_allclose(again.T_world_camera, run.T_world_camera, rtol=0, atol=ROTATION_TOLERANCE)
    assert (tmp_path / "run.txt").read_text().splitlines()[1].startswith("1403715529.112143517 ")


def test_stamps_before_zero_are_written_right(tmp_path):
    write_tum(tmp_path / "run.txt", Trajectory(np.eye(4)[None].repeat(2, 0), np.array([-1_500_000_001, -1])))
    assert read_trajectory(tmp_path / "run.txt").stamps_ns.tolist() == [-1_500_000_001, -1]


def test_tum_needs_stamps(tmp_path):
    with pytest.raises(InputError, match="no stamps"):
        write_tum(tmp_path / "run.txt", a_trajectory(stamps=False))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("stamps", [True, False])
def test_written_maomaps_poses_give_the_trajectory_back(tmp_path, stamps):
    run = a_trajectory(stamps=stamps)
    write_maomaps_poses(tmp_path / "gt_poses.txt", run)
    again = read_trajectory(tmp_path / "gt_poses.txt")
    np.testing.assert_allclose(again.T_world_camera, run.T_world_camera, rtol=0, atol=ANGLE_TOLERANCE)
    assert (again.positions == run.positions).all()
    assert (tmp_path / "gt_poses_timestamps.txt").exists() == stamps
    if stamps:
        assert (again.stamps_ns == run.stamps_ns).all()


def test_old_stamps_are_not_left_beside_new_poses_without_any(tmp_path):
    written(tmp_path, "1\n", "p_timestamps.txt")
    with pytest.raises(InputError, match=r"p_timestamps\.txt"):
        write_maomaps_poses(tmp_path / "p.txt", a_trajectory(stamps=False))
    assert not (tmp_path / "p.txt").exists()


GEOREFERENCED = [4.580746042933629942e05, 5.429380172093272209e06, 1.629059191997378946e02]
#: file, format, poses, first stamp, last stamp, first position, last position; read off the files by eye.
REAL = [
    ("KITTI_00_ORB.txt", "kitti", 4541, None, None, [-4e-9, 0, 0], None),
    ("KITTI_00_SPTAM.txt", "kitti", 4541, None, None, [0, 0, 0], None),
    ("KITTI_00_gt.txt", "kitti", 4541, "0", "4.705816e+02", None, [-5.583931, -3.562758, 96.96153]),
    (
        "V102_groundtruth.csv",
        "euroc",
        16702,
        "1403715524.907143168",
        None,
        [0.515356, 1.996773, 0.971104],
        None,
    ),
    ("fr2_desk_ORB.txt", "tum", 2893, "1311868164.363181", "1311868263.185529", [0, 0, 0], None),
    ("fr2_desk_ORB_kf_mono.txt", "tum", 157, "1311868171.131477", None, [-1.43e-5, -3.4e-6, 3.78e-5], None),
    ("freiburg1_xyz-ORB_kf_mono.txt", "tum", 32, "1305031110.043299", None, [0, 0, 0], None),
    ("freiburg1_xyz-groundtruth.txt", "tum", 3000, "1305031098.6659", None, [1.3563, 0.6305, 1.638], None),
    (
        "freiburg1_xyz-rgbdslam.txt",
        "tum",
        788,
        "1305031102.160407",
        None,
        [1.344379, 0.627206, 1.661754],
        None,
    ),
    ("freiburg1_xyz-rgbdslam_drift.txt", "tum", 788, "1305031102.160407", None, None, None),
    ("freiburg1_xyz-rgbdslam_drift_short.txt", "tum", 40, "1305031102.160407", None, None, None),
    ("georeferenced.tum", "tum", 1000, "1706282470.098386526", None, GEOREFERENCED, None),
]


@pytest.mark.parametrize("case", REAL, ids=[case[0] for case in REAL])
def test_real_trajectories_are_recognised_and_read_to_the_digit(case):
    name, format, count, first_stamp, last_stamp, first, last = case
    path = shared_data("traj_evo") / name
    run = read_trajectory(path)
    assert recognise_trajectory(path) == format
    assert len(run) == count
    assert (run.stamps_ns is None) == (first_stamp is None)
    for index, stamp in ((0, first_stamp), (-1, last_stamp)):
        if stamp is not None:
            assert run.stamps_ns[index] == int(Decimal(stamp) * 10**9)
    for index, position in ((0, first), (-1, last)):
        if position is not None:
            assert run.positions[index].tolist() == position


@pytest.mark.parametrize(
    ("name", "line", "count", "repeated"),
    [("V102.txt", 433, 807, 4), ("fr2_desk_groundtruth.txt", 10863, 20957, 1)],
)
def test_real_files_with_two_poses_at_one_stamp_keep_all_and_say_so(name, line, count, repeated):
    run = read_trajectory(shared_data("traj_evo") / name)
    assert len(run) == count
    assert run.notes[0].startswith(f"{repeated} of {count} poses have the stamp of the pose before")
    assert f"line {line}" in run.notes[0]


def test_poses_of_the_original_program_agree_with_the_tum_file_they_were_made_from():
    folder = shared_reference("tum_fr1_rpy_a")
    body = read_trajectory(folder / "gt_poses.txt")
    stamps = read_table(folder / "stamps.txt").values[:, 0]
    tum = read_trajectory(shared_data("rgbd_tum_fr1_rpy_a") / "groundtruth.txt")
    nearest = np.abs(tum.stamps_ns[None] * 1e-9 - stamps[:, None]).argmin(axis=1)
    assert len(body) == 100
    assert body.stamps_ns is None
    # Metres, and rotation entries: the originals' angles have nine digits.
    np.testing.assert_allclose(body.T_world_camera, tum.T_world_camera[nearest], rtol=0, atol=2e-8)
