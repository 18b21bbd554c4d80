"""Trajectory files: which format they are taken for, and which are refused."""

from __future__ import annotations

import pytest

from maomaps_warp.errors import InputError
from maomaps_warp.io.trajectories import (
    read_trajectory,
    recognise_trajectory,
)

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


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (TUM, "tum"),
        (EUROC, "euroc"),
        (KITTI_ROW.format(x=1), "kitti"),
        ("0 0 0 0.1 0 0\n", "maomaps"),
        ("0 0 0 0 0 0\n1 0 0 0 0 0\n", "maomaps"),
        ("0 0 0 255 0 1\n", None),
        ("1 2 3\n", None),
        ("# nothing\n", None),
        ("hello world\n", None),
        ("1 2 3\n1 2\n", None),
        (b"", None),
        (b"\x00\x01\x02", None),
        (b"#ROSBAG V2.0\n1 2 3 4 5 6 7 8\n", None),
    ],
)
def test_a_format_is_recognised_by_content(tmp_path, text, expected):
    assert recognise_trajectory(written(tmp_path, text)) == expected


def test_stamps_beside_it_tell_poses_from_a_coloured_cloud(tmp_path):
    path = written(tmp_path, "0 0 0 1 0 0\n", "poses.txt")
    assert recognise_trajectory(path) is None
    written(tmp_path, "1.0\n", "poses_timestamps.txt")
    assert recognise_trajectory(path) == "maomaps"


def test_a_folder_is_no_trajectory(tmp_path):
    assert recognise_trajectory(tmp_path) is None
    assert "is a folder" in error_of(tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1403715524907143168 0 0 0 0 0 0 1\n", ["line 1", "looks like nanoseconds", "1e9"]),
        ("0 0 0 0 0 0 0 1\n33333333 0 0 0 0 0 0 1\n66666666 1 0 0 0 0 0 1\n", ["look like nanoseconds"]),
        ("1403715524907.5 0 0 0 0 0 0 1\n", ["looks like milliseconds"]),
        ("2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", ["line 2", "comes after a later one", "sort"]),
        ("1 0 0 0 0 0 0 1\n# x\n1 5 0 0 0 0 0 1\n", ["line 3", "stands twice", "keep"]),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 0\n", ["line 2", "norm 0"]),
        ("1 0 0 0 0.5 0.5 0.5 0.6\n", ["line 1", "not 1"]),
        ("1 0 0 0 nan 0 0 1\n", ["line 1", "NaN"]),
        ("1 inf 0 0 0 0 0 1\n", ["line 1", "infinite"]),
        ("nan 0 0 0 0 0 0 1\n", ["line 1", "NaN"]),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", ["line 2", "7 values", "has 8"]),
        ("1 0 0 0 0 0 0 1\n2 0 0 x 0 0 0 1\n", ["line 2", "'x' is not a number"]),
        ("t x y z qx qy qz qw\n1 0 0 0 0 0 0 1\n", ["line 1", "'t'", "#"]),
        ("1,5 2,0 3,0 4,0\n", ["line 1", "decimal commas"]),
        ("1 0 0 1_0 0 0 0 1\n", ["'1_0' is not a number"]),
        ("1 2 3\n", ["3 values a row", "points", "TUM"]),
        ("1 2 3 0 0 0 1\n", ["7 values a row", "without stamps"]),
        ("1\n2\n", ["1 value a row"]),
        ("# only comments\n", ["no rows"]),
        ("", ["is empty"]),
        (b"\x00\x01\x02\x03", ["binary"]),
        ("1 0 0 0 0 0 0 1\n".encode("utf-16"), ["binary", "UTF-16"]),
        (b"1 0 0 0 0 0 0 1\n\xff\xfe 3\n", ["line 2", "UTF-8"]),
        (b"#ROSBAG V2.0\n", ["ROS 1 bag"]),
        (b"PK\x03\x04abc", ["zip or NPZ"]),
        (b"ply\nformat ascii 1.0\n", ["PLY"]),
        (b"# .PCD v0.7\n", ["PCD"]),
        (b"SQLite format 3\x00", ["SQLite"]),
    ],
)
def test_what_is_no_good_trajectory_is_refused_with_its_place(tmp_path, text, words):
    path = written(tmp_path, text)
    message = error_of(path)
    assert message.startswith(str(path))
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("format", "text", "words"),
    [
        ("tum", KITTI_ROW.format(x=1), ["12 values", "KITTI", "TUM has 8"]),
        ("kitti", TUM, ["8 values", "TUM", "KITTI has 12"]),
        ("maomaps", TUM, ["8 values", "MAOMaps has 6"]),
        ("euroc", "1 2 3\n", ["3 values", "8 or more"]),
        ("euroc", TUM, ["line 1", "looks like seconds"]),
        ("euroc", "1403715524,0,0,0,1,0,0,0\n1403715525,0,0,0,1,0,0,0\n", ["look like seconds"]),
        ("kitti", "2 0 0 0 0 2 0 0 0 0 2 0\n", ["line 1", "no rotation"]),
        ("kitti", KITTI_ROW.format(x=1) + "1 0 0 0 0 1 0 0 0 0 -1 0\n", ["line 2", "mirrored"]),
        ("kitti", "0 0 0 0 0 0 0 0 0 0 0 0\n", ["line 1", "no rotation"]),
    ],
)
def test_a_forced_format_that_does_not_fit_is_refused(tmp_path, format, text, words):
    message = error_of(written(tmp_path, text), format=format)
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("name", "text", "stamps", "words"),
    [
        ("00.txt", KITTI_ROW.format(x=1), "0\n1\n", ["00_times.txt", "2 stamps", "1 poses"]),
        ("00.txt", KITTI_ROW.format(x=1) * 2, "1\n0\n", ["00_times.txt, line 2", "sort"]),
        ("p.txt", "0 0 0 0 0 0\n" * 2, "5\n", ["p_timestamps.txt", "1 stamps", "2 poses"]),
        ("p.txt", "0 0 0 0 0 0\n1 0 0 0 0 0\n", "5\n5\n", ["p_timestamps.txt, line 2", "twice"]),
        ("p.txt", "0 0 0 0 0 0\n", "5 6\n", ["p_timestamps.txt", "2 values a row"]),
        ("p.txt", "0 0 0 0 0 0\n", "1403715524907143168\n", ["p_timestamps.txt", "nanoseconds"]),
    ],
)
def test_stamps_beside_the_poses_are_checked_as_well(tmp_path, name, text, stamps, words):
    path = written(tmp_path, text, name)
    beside = name.replace(".txt", "_times.txt" if name == "00.txt" else "_timestamps.txt")
    written(tmp_path, stamps, beside)
    message = error_of(path)
    for word in words:
        assert word in message


def test_a_missing_file_is_told_as_such(tmp_path):
    assert "no such file" in error_of(tmp_path / "none.txt")
    assert "no such file" in error_of(tmp_path / "none.txt", format="tum")


def test_an_unknown_option_is_a_programming_mistake(tmp_path):
    for options in ({"format": "json"}, {"pose_frame": "lidar"}):
        with pytest.raises(ValueError, match="must be|is no pose convention"):
            read_trajectory(written(tmp_path, TUM), **options)


@pytest.mark.parametrize("second", ["1.0 0 0 0 0 0 0 1", "1 8 0 0 0 0 0 1"])
def test_repeated_stamps_are_refused_with_the_line(tmp_path, second):
    message = error_of(written(tmp_path, f"1 0 0 0 0 0 0 1\n{second}\n2 0 0 0 0 0 0 1\n"))
    assert "line 2" in message and "stands twice" in message and "keep one pose a stamp" in message


def test_one_repeated_stamp_in_a_long_recording_is_kept_and_noted(tmp_path):
    rows = [f"{i} {i} 0 0 0 0 0 1" for i in range(120)]
    rows.insert(8, "7 7.001 0 0 0 0 0 1")
    run = read_trajectory(written(tmp_path, "\n".join(rows)))
    assert len(run) == 121
    assert "1 of 121 poses have the stamp of the pose before" in run.notes[0]
    assert "line 9" in run.notes[0]


def test_one_pose_is_a_trajectory(tmp_path):
    assert len(read_trajectory(written(tmp_path, "1 0 0 0 0 0 0 1\n"))) == 1
