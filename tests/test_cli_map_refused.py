"""`maomaps-warp map` with recordings and options that cannot be used: one line, exit code 2, nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest
from map_command import DEPTH, INFO, POSE, RGB, Drive, assert_refused, entries, recorded_drive, run_map, write
from typer.testing import CliRunner

from maomaps_warp.cli.app import app


@pytest.fixture(scope="module")
def recorded() -> Drive:
    return recorded_drive()


@pytest.fixture
def bag(recorded, tmp_path) -> Path:
    return write(tmp_path, entries(recorded))


def test_a_recording_without_depth_is_refused(recorded, tmp_path):
    path = write(tmp_path, [entry for entry in entries(recorded) if entry[0] in (RGB, POSE)])
    assert_refused(run_map(tmp_path, path), str(path), "poses but no depth images", "32FC1")


def test_of_two_depth_topics_one_must_be_named(recorded, tmp_path):
    path = write(tmp_path, entries(recorded) + [e for e in entries(recorded, depth_topic="/other") if e[0] == "/other"])
    assert_refused(run_map(tmp_path, path), "2 topics with depth images", "--topic NAME", "/other", DEPTH)
    outcome = run_map(tmp_path, path, "--topic", DEPTH, "--topic", INFO, "--pose-frame", "optical")
    assert outcome.code == 0, outcome.stderr


def test_colours_of_another_size_are_refused(recorded, tmp_path):
    colors = {t: image[::2, ::2] for t, image in recorded.colors.items()}
    path = write(tmp_path, entries(Drive(recorded.depths, colors, recorded.poses)))
    assert_refused(run_map(tmp_path, path, "--pose-frame", "optical"), f"topic {RGB}", "40x30", "80x60")
    assert run_map(tmp_path, path, "--pose-frame", "optical", "--no-colors").code == 0


def test_a_camera_info_without_k_is_refused(recorded, tmp_path):
    messages = entries(recorded)
    for topic, _, message in messages:
        if topic == INFO:
            message.K[:] = 0
    path = write(tmp_path, messages)
    assert_refused(run_map(tmp_path, path), f"topic {INFO}", "K is all zeros", "--camera")
    assert run_map(tmp_path, path, "--camera", "80x60@90", "--pose-frame", "optical").code == 0


def test_a_recording_without_colours_is_refused_unless_none_are_wanted(recorded, tmp_path):
    path = write(tmp_path, [entry for entry in entries(recorded) if entry[0] != RGB])
    assert_refused(run_map(tmp_path, path, "--pose-frame", "optical"), "has colours", "--no-colors", "--color-gap")
    assert run_map(tmp_path, path, "--pose-frame", "optical", "--no-colors").code == 0


def test_images_whose_stamps_no_pose_has_are_refused(recorded, tmp_path):
    poses = {t + 10**12: T for t, T in recorded.poses.items()}
    path = write(tmp_path, entries(Drive(recorded.depths, recorded.colors, poses)))
    assert_refused(run_map(tmp_path, path, "--pose-frame", "optical"), "not one of 30", "--max-stamp-gap")


def test_limits_that_leave_nothing_are_refused(bag, tmp_path):
    near = run_map(tmp_path, bag, "--pose-frame", "optical", "--min-range", 9.9, "--max-range", 9.95)
    assert_refused(near, "between 9.9 and 9.95 m", "--max-range")
    low = run_map(tmp_path, bag, "--pose-frame", "optical", "--ceiling", -5)
    assert_refused(low, "removes all", "--ceiling keep")


def test_a_cloud_is_no_recording(tmp_path):
    (tmp_path / "map.xyz").write_text("0 0 0\n1 2 3\n0.5 0.5 0.5\n")
    assert_refused(run_map(tmp_path, tmp_path / "map.xyz"), "holds points but no depth images", "depth images")


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("--voxel-size", "0"), "--voxel-size"),
        (("--voxel-size", "nan"), "--voxel-size"),
        (("--stride", "0"), "--stride"),
        (("--max-range", "0.001"), "min_range"),
        (("--ceiling", "roof"), "--ceiling roof"),
        (("--ceiling", "nan"), "--ceiling nan"),
        (("--max-stamp-gap", "-1"), "--max-stamp-gap"),
        (("--color-gap", "inf"), "--color-gap"),
        (("--camera", "big"), "big"),
        (("--protocol", "paper"), "maomaps, gt_map_creator"),
        (("--run", "eleventh"), "first, second"),
        (("--device", "tpu"), "--device tpu"),
        (("--pose-frame", "ship"), "--pose-frame ship"),
        (("--topic", "/nothing"), "/nothing"),
        (("--format", "gif"), "--format gif"),
    ],
)
def test_an_impossible_option_is_refused_by_name(words, found, bag, tmp_path):
    assert_refused(run_map(tmp_path, bag, *words), found)


def test_a_run_that_is_there_is_replaced_only_if_told(bag, tmp_path):
    words = (bag, "--pose-frame", "optical")
    assert run_map(tmp_path, *words).code == 0
    before = (tmp_path / "out/gt_points_first.txt").read_bytes()
    again = run_map(tmp_path, *words, "--voxel-size", 0.2)
    assert again.code == 2 and "--overwrite" in again.stderr and again.document is None
    assert (tmp_path / "out/gt_points_first.txt").read_bytes() == before
    assert run_map(tmp_path, *words, "--voxel-size", 0.2, "--overwrite", "--no-colors").code == 0
    assert (tmp_path / "out/gt_points_first.txt").read_bytes() != before
    assert not (tmp_path / "out/gt_colors_first.txt").exists()


def test_inputs_are_never_replaced(bag, tmp_path):
    outcome = run_map(tmp_path, bag, "--json", bag)
    assert outcome.code == 2 and "is an input" in outcome.stderr
    assert bag.stat().st_size > 10_000


def test_what_cannot_be_written_is_found_out_before_the_work(tmp_path):
    (tmp_path / "out").write_text("a file")
    result = CliRunner().invoke(app, ["map", "no such bag", "-o", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert str(tmp_path / "out") in result.stderr and "no such bag" not in result.stderr
