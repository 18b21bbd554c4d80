"""PCD files, with their compression: what is read, what is refused, what is written."""

from __future__ import annotations

import struct

import pytest
from cloud_files import (
    POINTS,
    RGB,
    ascii_rows,
    assert_cloud,
    compressed,
    error_of,
    floats,
    lzf_greedy,
    lzf_literals,
    packed,
    pcd,
    written,
)
from hypothesis import given
from hypothesis import strategies as st

from maomaps_warp.io.clouds import read_cloud, recognise_cloud
from maomaps_warp.io.lzf import lzf_decompress


@given(st.lists(st.sampled_from([b"a", b"bc", b"abcabc" * 20, bytes(300), bytes(range(256))]), max_size=60))
def test_lzf_gives_back_what_was_packed(pieces):
    data = b"".join(pieces)
    assert lzf_decompress(lzf_literals(data), len(data)) == data
    assert lzf_decompress(lzf_greedy(data), len(data)) == data


def test_an_lzf_copy_may_overlap_itself():
    assert lzf_decompress(b"\x00a" + bytes([5 << 5, 0]), 8) == b"aaaaaaaa"
    assert lzf_decompress(b"\x01ab" + bytes([7 << 5, 0, 1]), 11) == b"abababababa"


@pytest.mark.parametrize(
    ("data", "size"),
    [
        (b"\x05abc", 6),  # literals cut off
        (b"\x00a" + bytes([1 << 5]), 4),  # copy without its offset
        (b"\x00a" + bytes([7 << 5]), 10),  # copy without its length
        (b"\x00a" + bytes([1 << 5, 9]), 4),  # copy from before the start
        (b"\x00a", 2),
        (b"\x01ab", 1),
    ],
)
def test_damaged_lzf_is_refused(data, size):
    with pytest.raises(ValueError, match=r"."):
        lzf_decompress(data, size)


def test_a_binary_pcd_is_read_and_its_viewpoint_left_alone(tmp_path):
    assert_cloud(read_cloud(written(tmp_path, pcd("x y z", "4 4 4", "F F F", floats()))))


@pytest.mark.parametrize("version", [".5", ".6", ".7", "0.5", "0.7"])
def test_an_old_ascii_header_without_count_and_viewpoint_is_read_under_any_name(tmp_path, version):
    content = pcd("x y z", "4 4 4", "F F F", ascii_rows(POINTS), "ascii", version=version, viewpoint=False)
    path = written(tmp_path, content, "slam_points.txt")
    assert recognise_cloud(path) == "pcd"
    assert_cloud(read_cloud(path))


def test_a_pcd_without_its_comment_line_is_recognised(tmp_path):
    content = pcd("x y z", "4 4 4", "F F F", floats()).split(b"\n", 1)[1]
    assert_cloud(read_cloud(written(tmp_path, content)))


@pytest.mark.parametrize("kind", ["F", "U"])
@pytest.mark.parametrize("alpha", [0, 255])
def test_packed_colours_are_unpacked(tmp_path, kind, alpha):
    body = b"".join(struct.pack("<3fI", *p, packed(c, alpha)) for p, c in zip(POINTS, RGB, strict=True))
    assert_cloud(read_cloud(written(tmp_path, pcd("x y z rgb", "4 4 4 4", f"F F F {kind}", body))), RGB)


def test_packed_colours_in_ascii_are_bits_of_a_float_or_an_integer(tmp_path):
    bits = [packed(color) for color in RGB]
    as_float = [struct.unpack("<f", struct.pack("<I", b))[0] for b in bits]
    signed = [struct.unpack("<i", struct.pack("<I", b | 0xFF000000))[0] for b in bits]
    for kind, values in (("F", [f"{v:.9g}" for v in as_float]), ("U", bits), ("I", signed)):
        body = ascii_rows((*p, v) for p, v in zip(POINTS, values, strict=True))
        content = pcd("x y z rgb", "4 4 4 4", f"F F F {kind}", body, "ascii")
        assert_cloud(read_cloud(written(tmp_path, content)), RGB)


def test_separate_colours_padding_and_fields_of_several_values_are_stepped_over(tmp_path):
    body = b"".join(
        struct.pack("<2xd5fxffBBBd", p[0], 9, 9, 9, 9, 9, p[1], p[2], *c, 0.5) for p, c in zip(POINTS, RGB, strict=True)
    )
    content = pcd(
        "_ x fpfh _ y z r g b t",
        "1 8 4 1 4 4 1 1 1 8",
        "U F F U F F U U U F",
        body,
        counts="2 1 5 1 1 1 1 1 1 1",
    )
    assert_cloud(read_cloud(written(tmp_path, content)), RGB)


def test_float64_coordinates_keep_their_digits(tmp_path):
    easting = [458074.6042933629942, 5429380.172093272209, 162.9059191997378946]
    content = pcd("x y z", "8 8 8", "F F F", struct.pack("<3d", *easting), points=1)
    assert read_cloud(written(tmp_path, content)).points.tolist() == [easting]


@pytest.mark.parametrize("encode", [lzf_literals, lzf_greedy])
def test_a_compressed_pcd_holds_one_column_after_the_other(tmp_path, encode):
    xs, ys, zs = (struct.pack("<3f", *axis) for axis in zip(*POINTS, strict=True))
    normals = struct.pack("<6f", 1, 2, 3, 4, 5, 6)  # two values a point, kept together
    colors = struct.pack("<3I", *(packed(c) for c in RGB))
    fields = ("x n y z rgb", "4 4 4 4 4", "F F F F U", compressed([xs, normals, ys, zs, colors], encode))
    cloud = read_cloud(written(tmp_path, pcd(*fields, "binary_compressed", counts="1 2 1 1 1")))
    assert_cloud(cloud, RGB)


@pytest.mark.parametrize("has_padding", [True, False])
def test_padding_may_be_present_in_compressed_data_or_not(tmp_path, has_padding):
    axes = [struct.pack("<3f", *axis) for axis in zip(*POINTS, strict=True)]
    body = compressed([axes[0], bytes(3 * 4) if has_padding else b"", *axes[1:]], lzf_literals)
    content = pcd("x _ y z", "4 1 4 4", "F U F F", body, "binary_compressed", counts="1 4 1 1")
    assert_cloud(read_cloud(written(tmp_path, content)))


def test_points_that_are_not_finite_are_dropped_counted_and_noted(tmp_path):
    nan, inf = float("nan"), float("inf")
    rows = [POINTS[0], (nan, nan, nan), POINTS[1], (1, inf, 1), POINTS[2]]
    body = b"".join(struct.pack("<3fI", *p, i) for i, p in enumerate(rows))
    cloud = read_cloud(written(tmp_path, pcd("x y z rgb", "4 4 4 4", "F F F U", body, points=5)))
    assert_cloud(cloud, [(0, 0, 0), (0, 0, 2), (0, 0, 4)])
    assert cloud.dropped_nonfinite == 2
    assert any("2 of 5 points" in note for note in cloud.notes)


def test_a_signalling_nan_is_dropped_without_a_warning(tmp_path, recwarn):
    body = struct.pack("<3I", 0x7FA00000, 0, 0) + struct.pack("<3f", 1, 2, 3)
    cloud = read_cloud(written(tmp_path, pcd("x y z", "4 4 4", "F F F", body, points=2)))
    assert cloud.points.tolist() == [[1, 2, 3]]
    assert not recwarn.list


def test_colours_that_are_not_understood_are_noted(tmp_path):
    body = b"".join(struct.pack("<3fH", *p, 1) for p in POINTS)
    cloud = read_cloud(written(tmp_path, pcd("x y z rgb", "4 4 4 2", "F F F U", body)))
    assert_cloud(cloud)
    assert "no colours" in cloud.notes[0]


XS = [struct.pack("<3f", *axis) for axis in zip(*POINTS, strict=True)]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (pcd("x y z", "4 4 4", "F F F", floats()[:-1]), ["2 of 3 points"]),
        (pcd("x y z", "4 4 4", "F F F", floats() * 2), ["6 points", "POINTS 3"]),
        (pcd("x y z", "4 4 4", "F F F", ascii_rows(POINTS[:2]), "ascii"), ["2 rows", "POINTS 3"]),
        (pcd("x y z", "4 4 4", "F F F", ascii_rows([*POINTS, (1, 2, 3)]), "ascii"), ["4 rows", "POINTS 3"]),
        (pcd("x y z", "4 4 4", "F F F", b"1 2 3\n4 a 6\n7 8 9\n", "ascii"), ["line 12", "'a'"]),
        (pcd("x y z i", "4 4 4 4", "F F F F", ascii_rows(POINTS), "ascii"), ["line 11", "need 4"]),
        (pcd("x y", "4 4", "F F", floats()), ["without field z", "x y"]),
        (pcd("x y z", "4 4", "F F F", floats()), ["3 FIELDS, 2 SIZE"]),
        (pcd("x y z", "4 4 3", "F F F", floats()), ["TYPE F SIZE 3"]),
        (pcd("x y z", "4 4 4", "F F Q", floats()), ["TYPE Q"]),
        (pcd("x y z", "4 4 four", "F F F", floats()), ["SIZE", "whole numbers"]),
        (pcd("x y z", "4 4 4", "F F F", floats(), "zstd"), ["DATA zstd", "binary_compressed"]),
        (pcd("x y z", "4 4 4", "F F F", floats(), extra="POINTS 4"), ["POINTS 4", "= 3"]),
        (pcd("x y z", "4 4 4", "F F F", floats(), extra="HELLO 4"), ["line 10", "HELLO"]),
        (pcd("x y z", "4 4 4", "F F F", b"", points=0), ["no points"]),
        (
            pcd("x y z", "4 4 4", "F F F", struct.pack("<3f", *[float("nan")] * 3), points=1),
            ["all of its 1 points"],
        ),
        (pcd("x y z", "4 4 4", "F F F", b"").replace(b"DATA binary\n", b""), ["without a DATA line"]),
        (pcd("x y z", "4 4 4", "F F F", b"\x01", "binary_compressed"), ["missing"]),
        (
            pcd("x y z", "4 4 4", "F F F", compressed(XS, lzf_literals)[:-1], "binary_compressed"),
            ["ends after"],
        ),
        (
            pcd("x y z", "4 4 4", "F F F", compressed(XS[:2], lzf_literals), "binary_compressed"),
            ["24 bytes", "36"],
        ),
        (
            pcd("x y z", "4 4 4", "F F F", struct.pack("<II", 2, 36) + b"\x00a", "binary_compressed"),
            ["damaged", "1 bytes instead of 36"],
        ),
    ],
)
def test_a_damaged_pcd_is_refused_with_its_place(tmp_path, content, words):
    message = error_of(written(tmp_path, content))
    for word in words:
        assert word in message


def test_points_may_stand_in_width_and_height_alone(tmp_path):
    content = pcd("x y z", "4 4 4", "F F F", floats()).replace(b"POINTS 3\n", b"").replace(b"WIDTH 3", b"WIDTH 1")
    assert_cloud(read_cloud(written(tmp_path, content.replace(b"HEIGHT 1", b"HEIGHT 3"))))
