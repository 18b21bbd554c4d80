"""`maomaps-warp map`: what it makes, writes and prints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from map_command import CAMERA, INFO, POSE, Drive, assert_refused, entries, names, recorded_drive, run_map, write
from scipy.spatial.transform import Rotation
from shared_data import shared_data


@pytest.fixture(scope="module")
def recorded() -> Drive:
    return recorded_drive()


@pytest.fixture
def bag(recorded, tmp_path) -> Path:
    return write(tmp_path, entries(recorded))


def test_a_bag_becomes_a_run_of_a_sample_directory(bag, tmp_path):
    outcome = run_map(tmp_path, bag, "--pose-frame", "optical")
    assert outcome.code == 0, outcome.stderr
    assert outcome.files == names("first")
    assert {Path(file).name for file in outcome.document["files"]} == names("first")
    counts = outcome.document["counts"]
    assert (counts["frames"], counts["frames_without_pose"], counts["frames_without_color"]) == (30, 0, 0)
    assert counts["pixels"] == 30 * 80 * 60
    assert counts["voxels"] == len(np.loadtxt(tmp_path / "out/gt_points_first.txt"))
    assert outcome.document["protocol"]["voxel_size"] == 0.05
    assert outcome.document["versions"]["maomaps-warp"]
    assert outcome.document["camera"]["fx"] == CAMERA.fx
    for words in (
        str(bag),
        "ROS 1 bag",
        "optical",
        "30, 0 without pose, 0 without color",
        f"{counts['voxels']} voxels",
    ):
        assert words in outcome.stdout


def test_the_same_input_gives_the_same_files(bag, tmp_path):
    contents = []
    for _ in range(2):
        run_map(tmp_path, bag, "--pose-frame", "optical", "--overwrite")
        contents.append({path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()})
    assert contents[0] == contents[1] and len(contents[0]) == 7


def test_undeclared_poses_are_proved_by_the_depth_images(bag, recorded, tmp_path):
    found = run_map(tmp_path, bag)
    assert found.code == 0, found.stderr
    assert found.document["pose_frame"] == "optical"
    assert any("proved by the depth images: optical" in note for note in found.document["notes"])
    declared = run_map(tmp_path, bag, "--pose-frame", "optical", "--run", "second")
    assert declared.files == names("first") | names("second")
    assert (tmp_path / "out/gt_points_first.txt").read_bytes() == (tmp_path / "out/gt_points_second.txt").read_bytes()


def test_poses_of_a_body_are_found_to_be_that(recorded, tmp_path):
    body = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    poses = {t: T @ np.linalg.inv(body) for t, T in recorded.poses.items()}
    outcome = run_map(tmp_path, write(tmp_path, entries(Drive(recorded.depths, recorded.colors, poses))))
    assert outcome.code == 0, outcome.stderr
    assert outcome.document["pose_frame"] in ("body", "maomaps-c")
    assert any("optical is what such sources usually mean" in note for note in outcome.document["notes"])
    straight = run_map(
        tmp_path, write(tmp_path / "out", entries(recorded)), "--pose-frame", "optical", "--run", "second"
    )
    first, second = (np.loadtxt(tmp_path / f"out/gt_points_{run}.txt") for run in ("first", "second"))
    assert straight.code == 0
    # Float rounding of the pose moves samples on walls that lie on voxel faces.
    common = len(set(map(tuple, first.tolist())) & set(map(tuple, second.tolist())))
    assert common > 0.99 * max(len(first), len(second))


def test_poses_that_nothing_proves_must_be_declared(recorded, tmp_path):
    still = next(iter(recorded.poses.values()))
    image = next(iter(recorded.depths.values()))
    images = Drive(dict.fromkeys(recorded.depths, image), recorded.colors, dict.fromkeys(recorded.poses, still))
    path = write(tmp_path, entries(images))
    assert_refused(run_map(tmp_path, path), f"topic {POSE}", "not declared", "does not move", "--pose-frame")
    assert run_map(tmp_path, path, "--pose-frame", "body").code == 0


def test_a_map_without_colours_has_no_file_of_colours(bag, tmp_path):
    outcome = run_map(tmp_path, bag, "--pose-frame", "optical", "--no-colors")
    assert outcome.files == names("first") - {"gt_colors_first.txt"}
    assert "frames_without_color" not in outcome.document["counts"]
    assert outcome.document["map"]["has_colors"] is False


def test_options_change_the_protocol_that_the_result_states(bag, tmp_path):
    words = ("--voxel-size", 0.1, "--min-range", 0.5, "--max-range", 3, "--stride", 2, "--ceiling", 1.5)
    outcome = run_map(tmp_path, bag, "--pose-frame", "optical", "--max-stamp-gap", 0.9, "--color-gap", 0, *words)
    assert outcome.code == 0, outcome.stderr
    protocol = outcome.document["protocol"]
    expected = {"voxel_size": 0.1, "min_range": 0.5, "max_range": 3.0, "pixel_stride": 2, "ceiling": "height"}
    expected |= {"ceiling_height": 1.5, "max_stamp_gap": 0.9, "color_gap": 0.0}
    assert {name: protocol[name] for name in expected} == expected
    points = np.loadtxt(tmp_path / "out/gt_points_first.txt")
    assert points[:, 2].max() <= 1.5
    np.testing.assert_allclose(points / 0.1, np.rint(points / 0.1), rtol=0, atol=1e-9)
    assert outcome.document["counts"]["ceiling_removed"] > 0


def test_a_camera_may_be_given_where_the_recording_states_none(recorded, tmp_path):
    path = write(tmp_path, [entry for entry in entries(recorded) if entry[0] != INFO])
    assert_refused(run_map(tmp_path, path), "no camera_info topic", "--camera")
    outcome = run_map(tmp_path, path, "--camera", "80x60@90", "--pose-frame", "optical")
    assert outcome.code == 0 and outcome.document["camera"]["fx"] == pytest.approx(40.0)


def test_poses_of_a_file_replace_those_of_the_bag(recorded, tmp_path):
    path = write(tmp_path, [entry for entry in entries(recorded) if entry[0] != POSE])
    assert_refused(run_map(tmp_path, path), "depth images without poses", "--trajectory")
    lines = []
    for t, T in recorded.poses.items():
        values = [*T[:3, 3].tolist(), *Rotation.from_matrix(T[:3, :3]).as_quat().tolist()]
        lines.append(f"{t // 10**9}.{t % 10**9:09d} {' '.join(map(str, values))}\n")
    (tmp_path / "poses.txt").write_text("".join(lines))
    outcome = run_map(tmp_path, path, "--trajectory", tmp_path / "poses.txt", "--pose-frame", "optical")
    assert outcome.code == 0, outcome.stderr


def test_jumping_poses_are_told_with_their_place(recorded, tmp_path):
    poses = dict(recorded.poses)
    for t in list(poses)[20:]:
        poses[t] = poses[t] + np.array([[0, 0, 0, 30.0], *np.zeros((3, 4))])
    path = write(tmp_path, entries(Drive(recorded.depths, recorded.colors, poses)))
    outcome = run_map(tmp_path, path, "--pose-frame", "optical")
    assert any("the poses jump: 30" in note and "from pose 20 to pose 21" in note for note in outcome.document["notes"])
    for t in list(poses)[20:]:
        poses[t] = poses[t] + np.array([[0, 0, 0, 1e6], *np.zeros((3, 4))])
    (tmp_path / "far").mkdir()
    path = write(tmp_path / "far", entries(Drive(recorded.depths, recorded.colors, poses)))
    assert_refused(run_map(tmp_path / "far", path, "--pose-frame", "optical"), "beyond the reach", "pose that jumps")


@pytest.mark.slow
def test_a_real_rgbd_folder_becomes_a_run(tmp_path):
    folder = shared_data("rgbd_tum_fr1_rpy_a")
    outcome = run_map(tmp_path, folder, "--stride", 4)
    assert outcome.code == 0, outcome.stderr
    assert outcome.files == names("first")
    assert outcome.document["counts"]["frames_without_color"] < outcome.document["counts"]["frames"]


def test_a_world_that_is_not_z_up_is_told(tmp_path):
    found = run_map(tmp_path, shared_data("rgbd_open3d_sample"))
    assert found.code == 0, found.stderr
    assert any("the cameras' up is the world's +y" in note for note in found.document["notes"])


def test_poses_of_another_recording_are_refused_with_that_reason(bag, tmp_path):
    other = tmp_path / "other.txt"
    other.write_text("1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n3 2 0 0 0 0 0 1\n")
    found = run_map(tmp_path, bag, "--trajectory", other)
    assert_refused(found, "other.txt", "not those of the depth images", "--trajectory")
