"""PLY files: what is read and what is refused."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from cloud_files import (
    FLOAT32_TOLERANCE,
    POINTS,
    RGB,
    ascii_rows,
    assert_cloud,
    error_of,
    floats,
    ply,
    written,
)
from shared_data import shared_data

from maomaps_warp.io.clouds import read_cloud, recognise_cloud

XYZ = ["float x", "float y", "float z"]
RGB_BYTES = ["uchar red", "uchar green", "uchar blue"]
FACES = "element face 2\nproperty list uchar int vertex_indices\n"


@pytest.mark.parametrize(("encoding", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
def test_a_binary_ply_is_read_in_either_byte_order(tmp_path, encoding, order):
    body = b"".join(struct.pack(f"{order}3f3B", *p, *c) for p, c in zip(POINTS, RGB, strict=True))
    path = written(tmp_path, ply(encoding, XYZ + RGB_BYTES, body))
    assert recognise_cloud(path) == "ply"
    assert_cloud(read_cloud(path), RGB)


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_an_ascii_ply_is_read(tmp_path, line_end):
    body = ascii_rows((*p, *c) for p, c in zip(POINTS, RGB, strict=True))
    content = ply("ascii", XYZ + RGB_BYTES, body).replace(b"\n", line_end.encode())
    assert_cloud(read_cloud(written(tmp_path, content)), RGB)


def test_colours_of_zero_and_one_in_bytes_are_nearly_black(tmp_path):
    body = ascii_rows((*p, 0, 1, 1) for p in POINTS)
    assert_cloud(read_cloud(written(tmp_path, ply("ascii", XYZ + RGB_BYTES, body))), [(0, 1, 1)] * 3)


def test_float_colours_run_from_zero_to_one(tmp_path):
    body = ascii_rows((*p, 0, 0.5, 1) for p in POINTS)
    content = ply("ascii", [*XYZ, "float red", "float green", "float blue"], body)
    assert_cloud(read_cloud(written(tmp_path, content)), [(0, 128, 255)] * 3)


def test_float64_vertices_keep_their_digits(tmp_path):
    easting = [458074.6042933629942, 5429380.172093272209, 162.9059191997378946]
    content = ply("binary_little_endian", ["double x", "double y", "double z"], struct.pack("<3d", *easting), 1)
    assert read_cloud(written(tmp_path, content)).points.tolist() == [easting]


def test_properties_may_come_in_any_order_with_others_between(tmp_path):
    body = b"".join(struct.pack("<fdfHf", p[2], 9, p[0], 9, p[1]) for p in POINTS)
    vertex = ["float z", "double confidence", "float x", "ushort label", "float y"]
    assert_cloud(read_cloud(written(tmp_path, ply("binary_little_endian", vertex, body))))


@pytest.mark.parametrize(
    "faces",
    [
        struct.pack("<B3iB3i", 3, 0, 1, 2, 3, 2, 1, 0),
        struct.pack("<B3iB4i", 3, 0, 1, 2, 4, 2, 1, 0, 0),
        struct.pack("<B4iB3i", 4, 0, 1, 2, 0, 3, 2, 1, 0),
    ],
    ids=["triangles", "mixed", "mixed, the larger first"],
)
def test_a_mesh_gives_its_vertices_none_merged_whatever_its_faces(tmp_path, faces):
    twice = b"".join(struct.pack("<3f", *p) for p in [*POINTS, *POINTS])
    path = written(tmp_path, ply("binary_little_endian", XYZ, twice + faces, 6, FACES))
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.points, POINTS * 2, rtol=0, atol=FLOAT32_TOLERANCE)
    assert cloud.notes == ("a mesh of 2 faces: its vertices are the points",)
    cut = written(tmp_path, path.read_bytes()[:-1], "cut.ply")
    assert "data ends within the 2 elements face" in error_of(cut)


@pytest.mark.parametrize("encoding", ["binary_little_endian", "ascii"])
def test_elements_before_the_vertices_are_stepped_over(tmp_path, encoding):
    before = "element camera 1\nproperty list uchar float k\nproperty float f\n"
    if encoding == "ascii":
        body = b"2 5.0 6.0 7.0\n" + ascii_rows(POINTS)
    else:
        body = struct.pack("<B3f", 2, 5, 6, 7) + floats()
    assert_cloud(read_cloud(written(tmp_path, ply(encoding, XYZ, body, before=before))))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (ply("binary_little_endian", XYZ, floats()[:-1]), ["data ends within the 3 elements vertex"]),
        (ply("ascii", XYZ, ascii_rows(POINTS[:2])), ["2 lines", "need 3"]),
        (ply("ascii", XYZ, ascii_rows(POINTS) + b"3 0 1 2\n", after=FACES), ["4 lines", "need 5"]),
        (ply("ascii", XYZ, b"1 2 3\n4 5 x\n7 8 9\n"), ["line 11", "'x'"]),
        (ply("ascii", XYZ, ascii_rows([(1, 2, 3, 4)] * 3)), ["line 10", "4 values", "3 properties"]),
        (ply("ascii", XYZ[:2], ascii_rows(POINTS)), ["without z", "x y"]),
        (ply("ascii", XYZ, b"", 0), ["no points"]),
        (ply("zip", XYZ, floats()), ["format 'zip'", "ascii"]),
        (ply("ascii", ["quad x"], b""), ["line 6", "property quad x"]),
        (ply("binary_little_endian", [*XYZ, "list uchar int n"], floats()), ["list property"]),
        (b"ply\nformat ascii 1.0\nelement vertex 1\n", ["without end_header"]),
        (b"ply\nformat ascii 1.0\nend_header\n", ["without an element vertex"]),
    ],
)
def test_a_damaged_ply_is_refused_with_its_place(tmp_path, content, words):
    message = error_of(written(tmp_path, content))
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("name", "count", "faces"),
    [
        ("scene_aws_small_house/aws_small_house_zup_vertexcolour.ply", 129700, 146484),
        ("scene_living_room/living_room_zup_vertexcolour.ply", 119519, 143163),
    ],
)
def test_real_meshes_agree_with_trimesh(name, count, faces):
    trimesh = pytest.importorskip("trimesh")
    folder, file = name.split("/")
    path = shared_data(folder) / file
    cloud = read_cloud(path)
    mesh = trimesh.load(path, process=False)
    assert len(cloud) == count
    assert f"{faces} faces" in cloud.notes[0]
    assert (cloud.points == mesh.vertices).all()
    assert (cloud.colors == mesh.visual.vertex_colors[:, :3]).all()
