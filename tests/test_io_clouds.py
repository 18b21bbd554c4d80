"""Point clouds in text and NPZ files, what is refused, and what is written."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from cloud_files import POINTS, RGB, ascii_rows, assert_cloud, error_of, packed, pcd, written
from hypothesis import given
from hypothesis import strategies as st
from shared_data import shared_reference

from maomaps_warp.errors import InputError
from maomaps_warp.io.clouds import read_cloud, recognise_cloud, write_pcd, write_xyz


def test_text_clouds_are_read_with_and_without_colours(tmp_path):
    assert_cloud(read_cloud(written(tmp_path, ascii_rows(POINTS))))
    rows = [(*p, *c) for p, c in zip(POINTS, RGB, strict=True)]
    assert_cloud(read_cloud(written(tmp_path, ascii_rows(rows))), RGB)
    assert_cloud(read_cloud(written(tmp_path, "//X,Y,Z,R,G,B\n" + ascii_rows(rows).decode().replace(" ", ","))), RGB)
    more = read_cloud(written(tmp_path, ascii_rows((*row, 0.5) for row in rows)))
    assert_cloud(more, RGB)
    assert "1 more columns are not used" in more.notes[0]


def test_further_columns_that_are_no_colours_are_noted(tmp_path):
    cloud = read_cloud(written(tmp_path, ascii_rows((*p, 0.5) for p in POINTS)))
    assert_cloud(cloud)
    assert cloud.notes == ("1 columns after x y z are not colours and are not used",)


def test_nan_in_text_is_dropped_and_counted(tmp_path):
    cloud = read_cloud(written(tmp_path, ascii_rows(POINTS) + b"nan nan nan\n1 -inf 2\n"))
    assert_cloud(cloud)
    assert cloud.dropped_nonfinite == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 0 0 0 0 0 0 1\n", ["TUM trajectory", "xyz"]),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", ["KITTI trajectory"]),
        ("0 0 0 0.1 0.2 0.3\n", ["MAOMaps trajectory"]),
        ("1 2\n", ["2 values a row"]),
        ("1 2 3\n4 5\n", ["line 2", "2 values"]),
        ("nan nan nan\n", ["all of its 1 points"]),
        ("", ["is empty"]),
        ("lorem ipsum\n", ["line 1", "'lorem'"]),
        (b"#ROSBAG V2.0\n", ["ROS 1 bag"]),
        (b"\x89PNG\r\n\x1a\n", ["PNG"]),
        (b"glTF\x02", ["glTF"]),
        (b"\x00\x01\x02", ["binary"]),
    ],
)
def test_what_is_no_cloud_is_refused_with_what_it_looks_like(tmp_path, text, words):
    path = written(tmp_path, text, "cloud.pcd")
    message = error_of(path)
    for word in words:
        assert word in message


def test_a_forced_text_format_reads_what_looks_like_a_trajectory(tmp_path):
    path = written(tmp_path, "1 2 3 0 0 0 0 1\n", "points.txt")
    assert read_cloud(path, format="xyz").points.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("format", ["pcd", "ply", "npz"])
def test_a_forced_format_that_does_not_fit_is_refused(tmp_path, format):
    assert f"is not a {format.upper()} file" in error_of(written(tmp_path, ascii_rows(POINTS)), format=format)


def test_a_pcd_forced_to_be_text_is_refused(tmp_path):
    path = written(tmp_path, pcd("x y z", "4 4 4", "F F F", ascii_rows(POINTS), "ascii"))
    assert "is a PCD point cloud" in error_of(path, format="xyz")


def test_a_folder_and_a_missing_file_are_told(tmp_path):
    assert recognise_cloud(tmp_path) is None
    assert "is a folder" in error_of(tmp_path)
    assert "no such file" in error_of(tmp_path / "none.ply")


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


P = np.array(POINTS)


@pytest.mark.parametrize(
    ("arrays", "colors"),
    [
        ({"points": P}, None),
        ({"xyz": P.astype(np.float32), "weights": np.ones(3)}, None),
        ({"whatever": P}, None),
        ({"points": P, "colors": np.array(RGB, np.uint8)}, RGB),
        ({"points": P, "colors": np.array(RGB, np.int64)}, RGB),
        ({"points": P, "colors": np.array(RGB) / 255}, RGB),
    ],
)
def test_an_npz_is_read(tmp_path, arrays, colors):
    path = written(tmp_path, npz(**arrays), "cloud.dat")
    assert recognise_cloud(path) == "npz"
    assert_cloud(read_cloud(path), colors)


def test_a_single_numpy_array_is_read_and_its_further_columns_noted(tmp_path):
    buffer = io.BytesIO()
    np.save(buffer, np.hstack([P, P]))
    cloud = read_cloud(written(tmp_path, buffer.getvalue()))
    assert_cloud(cloud)
    assert "3 columns" in cloud.notes[0]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (npz(a=P, b=P), ["NPZ with a, b", "points"]),
        (npz(points=P[:, :2]), ["(3, 2)"]),
        (npz(points=np.array(["a"])), ["points", "numbers"]),
        (npz(points=P, colors=P[:2]), ["colors", "(2, 3)"]),
        (npz(points=np.array([{"a": 1}], dtype=object)), ["NPZ", "allow_pickle"]),
        (npz(points=P)[:-30], ["NPZ"]),
        (npz(points=P[:0]), ["no points"]),
        (b"PK\x03\x04 not really", ["NPZ"]),
    ],
)
def test_a_bad_npz_is_refused(tmp_path, content, words):
    message = error_of(written(tmp_path, content))
    for word in words:
        assert word in message


def test_an_npz_with_any_byte_damaged_is_read_or_refused_and_nothing_else(tmp_path):
    compressed, lone = io.BytesIO(), io.BytesIO()
    np.savez_compressed(compressed, points=np.arange(30.0).reshape(10, 3) ** 2)
    np.save(lone, P)
    refused = 0
    for whole in (compressed.getvalue(), lone.getvalue()[:140]):
        for at in range(8, len(whole)):
            for byte in (0x28, 0xFF):  # 0x28 opens a bracket in the array's header
                path = written(tmp_path, whole[:at] + bytes([byte]) + whole[at + 1 :])
                try:
                    read_cloud(path)
                except InputError as error:
                    assert str(path) in error.where
                    refused += 1
    assert refused > 50


def test_a_written_pcd_has_the_bytes_that_pcl_reads(tmp_path):
    path = tmp_path / "out.pcd"
    write_pcd(path, P, np.array(RGB, np.uint8))
    header, body = path.read_bytes().split(b"DATA binary\n")
    assert b"FIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 3\nHEIGHT 1\n" in header
    assert body == b"".join(struct.pack("<3fI", *p, packed(c)) for p, c in zip(POINTS, RGB, strict=True))
    assert_cloud(read_cloud(path), RGB)


def test_far_coordinates_are_written_without_loss(tmp_path):
    far = np.array([[458074.6042933629942, 5429380.172093272209, 162.9059191997378946], [0.1, -0.2, 0.3]])
    write_pcd(tmp_path / "out.pcd", far)
    write_xyz(tmp_path / "out.txt", far)
    assert (read_cloud(tmp_path / "out.pcd").points == far).all()
    assert (read_cloud(tmp_path / "out.txt").points == far).all()


def test_text_is_written_as_the_originals_do(tmp_path):
    write_xyz(tmp_path / "out.txt", np.array([[-92, -139, 12], [0, 3, -140]]) * 0.05)
    assert (tmp_path / "out.txt").read_text() == "-4.6 -6.95 0.6\n0 0.15 -7\n"


@given(st.lists(st.tuples(*[st.floats(-1e4, 1e4, width=32)] * 3), min_size=1, max_size=20))
def test_written_text_gives_every_float32_back(tmp_path_factory, points):
    path = tmp_path_factory.mktemp("xyz") / "out.txt"
    write_xyz(path, np.array(points))
    assert (read_cloud(path, format="xyz").points.astype(np.float32) == np.array(points, np.float32)).all()


@pytest.mark.parametrize(
    ("name", "count", "first", "last"),
    [
        ("gt_points.txt", 56112, [-4.6, -6.95, 0.6], [2.35, -6.35, 0.15]),
        ("slam_points.txt", 50354, [-4.1, -7.35, 1.1], [2.8, -6.35, 0.35]),
    ],
)
def test_maps_of_the_original_program_are_read_and_written_back_to_the_byte(tmp_path, name, count, first, last):
    path = shared_reference("tum_fr1_rpy_a") / name
    cloud = read_cloud(path)
    assert len(cloud) == count
    assert [cloud.points[0].tolist(), cloud.points[-1].tolist()] == [first, last]
    write_xyz(tmp_path / name, cloud.points)
    assert (tmp_path / name).read_bytes() == path.read_bytes()
