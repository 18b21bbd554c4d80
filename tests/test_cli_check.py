"""`maomaps-warp check`."""

from __future__ import annotations

import json
from pathlib import Path

import bags
import numpy as np
import pytest
from check_scenes import CAMERA, drive, handheld, stream_of, trajectory_of, written
from shared_data import shared_data
from tum_sample import read_tum, write_run
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.io.trajectories import write_tum

FRAME_NS = 100_000_000


def run(*arguments: object):
    result = CliRunner().invoke(app, ["check", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def assert_refused(result, *words: str) -> None:
    assert result.exit_code == 2, (result.exit_code, result.stderr)
    (line,) = result.stderr.splitlines()
    assert line.startswith("maomaps-warp: error: ")
    for word in words:
        assert word in line
    assert result.stdout == ""


def entries_of(T, recorded, *, colors: tuple[int, int] | None = None, camera=CAMERA, kind="ros1"):
    """Depth, perhaps colours of (height, width), camera_info, and poses as recorded."""
    poses = trajectory_of(recorded)
    entries = bags.pose_messages(kind, "/pose", poses.stamps_ns.tolist(), poses.T_world_camera)
    for frame in stream_of(T).read(False):
        stamp = frame.stamp_ns
        entries += [
            ("/depth/camera_info", stamp, bags.camera_info(kind, stamp, camera)),
            ("/depth/image", stamp, bags.depth_message(kind, stamp, frame.depth)),
        ]
        if colors:
            image = np.zeros((*colors, 3), np.uint8)
            entries.append(("/rgb/image", stamp + 3_000_000, bags.color_message(kind, stamp + 3_000_000, image)))
    return sorted(entries, key=lambda entry: entry[1])


def write(folder: Path, entries, kind="ros1") -> Path:
    return bags.write_bag(bags.bag_path(folder, kind), kind, entries)


@pytest.mark.parametrize("run_name", ["first", "second"])
def test_a_real_bag_is_proved_to_be_optical(tmp_path, run_name):
    path = write_run(bags.bag_path(tmp_path, "ros1"), "ros1", read_tum(), run_name)
    document = tmp_path / "check.json"
    result = run(path, "--json", document)
    assert result.exit_code == 0, result.stderr
    assert "--pose-frame optical" in result.stdout
    found = json.loads(document.read_text())
    assert found["convention"]["best"] == "optical"
    assert found["convention"]["candidates"][0]["agreement"] > found["convention"]["candidates"][1]["agreement"]
    assert found["frames"] == 60
    streams = {stream["what"]: stream for stream in found["stamps"]}
    assert set(streams) == {"depth", "colour", "poses"}
    assert streams["poses"]["rate_hz"] == pytest.approx(100.0, rel=0.02)  # real clocks
    assert found["jumps"] == []
    assert found["declared"] == {"pose_frame": "optical", "by": "nobody", "is_contradicted": False}


@pytest.mark.parametrize("name", ["rgbd_nvblox_3dmatch", "rgbd_open3d_sample"])
def test_a_real_folder_is_proved_to_be_optical(name):
    result = run(shared_data(name))
    assert result.exit_code == 0, result.stderr
    assert "clear: --pose-frame optical" in result.stdout


def test_a_camera_can_be_given():
    result = run(shared_data("rgbd_slambook2_ch5"), "--camera", "640x480:518,519,325.5,253.5")
    assert result.exit_code == 0, result.stderr
    assert "clear: --pose-frame optical" in result.stdout
    assert "-y" in result.stdout


def test_the_option_to_paste_is_printed(tmp_path):
    path = write(tmp_path, entries_of(handheld(), written(handheld(), "opengl", inverse=True)))
    result = run(path)
    assert result.exit_code == 0, result.stderr
    assert "clear: --pose-frame opengl-inverse" in result.stdout
    again = run(path, "--pose-frame", "opengl-inverse")
    assert again.exit_code == 0
    assert "opengl-inverse" in again.stdout


def test_a_declared_convention_that_is_proved_wrong_is_said_so(tmp_path):
    path = write(tmp_path, entries_of(handheld(), handheld()))
    result = run(path, "--pose-frame", "body")
    assert result.exit_code == 3
    assert "--pose-frame body: the poses are optical" in result.stderr
    assert "NOT body" in result.stdout


def test_a_camera_that_stands_still_is_not_clear(tmp_path):
    T = np.repeat(drive(1), 10, axis=0)
    document = tmp_path / "check.json"
    result = run(write(tmp_path, entries_of(T, T)), "--json", document)
    assert result.exit_code == 3
    assert "NOT CLEAR" in result.stdout
    assert "does not move" in result.stderr
    assert json.loads(document.read_text())["convention"]["best"] is None


def test_poses_may_come_from_a_file(tmp_path):
    T = handheld()
    path = write(tmp_path, entries_of(T, T))
    other = tmp_path / "poses.txt"
    write_tum(other, trajectory_of(written(T, "body")))
    result = run(path, "--trajectory", other)
    assert result.exit_code == 0, result.stderr
    assert "clear: --pose-frame body" in result.stdout


def test_what_is_missing_and_what_jumps_is_found(tmp_path):
    T = handheld()
    recorded = T.copy()
    recorded[30:, 0, 3] += 4.0
    stamps = [frame.stamp_ns for frame in stream_of(T).read(False)]
    lost = {stamps[10], stamps[11], stamps[12]}
    entries = [e for e in entries_of(T, recorded, colors=(36, 48)) if e[0] != "/depth/image" or e[1] not in lost]
    document = tmp_path / "check.json"
    result = run(write(tmp_path, entries), "--json", document)
    found = json.loads(document.read_text())
    depth = next(stream for stream in found["stamps"] if stream["what"] == "depth")
    assert (depth["count"], depth["gaps"], depth["missing"]) == (37, 1, 3)
    assert [jump["index"] for jump in found["jumps"]] == [30]
    assert "depth: 3 messages are missing in 1 gaps" in result.stdout
    assert "poses jump: pose 31 by 4." in result.stdout
    assert found["color_gaps"]["median_s"] == pytest.approx(0.003, abs=1e-9)  # as written
    assert found["color_gaps"]["without"] == 0


def test_frames_without_a_pose_are_counted(tmp_path):
    T = handheld()
    entries = [e for e in entries_of(T, T) if e[0] != "/pose" or e[1] < 10**12 + 35 * FRAME_NS]
    result = run(write(tmp_path, entries))
    assert "5 of 40 depth frames have no pose" in result.stdout


def test_colours_of_another_size_are_a_finding(tmp_path):
    result = run(write(tmp_path, entries_of(handheld(), handheld(), colors=(72, 96))))
    assert result.exit_code == 0, result.stderr
    assert "colours cannot be used" in result.stdout
    assert "96x72" in result.stdout


def test_two_colour_topics_are_a_finding(tmp_path):
    T = handheld()
    entries = entries_of(T, T, colors=(36, 48))
    entries += [("/other/image", stamp, message) for topic, stamp, message in entries if topic == "/rgb/image"]
    result = run(write(tmp_path, entries))
    assert result.exit_code == 0, result.stderr
    assert result.stdout.count("colours cannot be used") == 1
    assert "--topic" in result.stdout


def test_a_bag_without_depth_is_refused(tmp_path):
    entries = [e for e in entries_of(handheld(4), handheld(4)) if e[0] == "/pose"]
    assert_refused(run(write(tmp_path, entries)), "no depth images")


def test_two_depth_topics_are_refused_with_their_names(tmp_path):
    entries = entries_of(handheld(), handheld())
    entries += [("/other/image", stamp, message) for topic, stamp, message in entries if topic == "/depth/image"]
    path = write(tmp_path, entries)
    assert_refused(run(path), "/depth/image", "/other/image", "--topic")
    assert run(path, "--topic", "/depth/image").exit_code == 0


def test_a_bag_without_poses_is_refused_with_the_option_that_helps(tmp_path):
    entries = [e for e in entries_of(handheld(4), handheld(4)) if e[0] != "/pose"]
    assert_refused(run(write(tmp_path, entries)), "--trajectory")


def test_a_camera_info_without_a_matrix_is_refused(tmp_path):
    T = handheld(4)
    entries = entries_of(T, T)
    for topic, _, message in entries:
        if topic == "/depth/camera_info":
            message.K[:] = 0.0
    path = write(tmp_path, entries)
    assert_refused(run(path), "not calibrated", "--camera")


def test_a_distorted_camera_is_refused(tmp_path):
    T = handheld(4)
    entries = entries_of(T, T)
    for topic, _, message in entries:
        if topic == "/depth/camera_info":
            message.D[:] = 0.1
    assert_refused(run(write(tmp_path, entries)), "lens distortion", "--camera")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--pose-frame", "sideways"), ("sideways", "optical")),
        (("--run", "first"), ("--run first", "no MAOMaps sample")),
        (("--topic", "/nothing"), ("/nothing",)),
        (("--camera", "wide"), ("wide",)),
    ],
)
def test_options_that_cannot_be_meant_are_refused(tmp_path, arguments, words):
    path = write(tmp_path, entries_of(handheld(4), handheld(4)))
    assert_refused(run(path, *arguments), *words)


def test_an_output_that_is_an_input_is_refused(tmp_path):
    path = write(tmp_path, entries_of(handheld(4), handheld(4)))
    assert_refused(run(path, "--json", path), "is an input")


def test_what_holds_no_images_is_refused(tmp_path):
    path = tmp_path / "poses.txt"
    write_tum(path, trajectory_of(drive(4)))
    assert_refused(run(path), "no depth images")
