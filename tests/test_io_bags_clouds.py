from __future__ import annotations

import struct
from pathlib import Path

import bags
import numpy as np
import pytest
from bag_samples import FLOAT32, FLOAT64, T0_NS, UINT8, UINT32, bag_cloud, xyz_cloud
from bags import write_bag

from maomaps_warp.errors import InputError


def read_one_cloud(tmp_path: Path, item: object):
    return bag_cloud(write_bag(tmp_path / "cloud.bag", "ros1", [("/map", T0_NS, item)]))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("letter", "datatype"), [("f", FLOAT32), ("d", FLOAT64)])
def test_a_cloud_of_any_layout_is_unpacked(order: str, letter: str, datatype: int, tmp_path: Path) -> None:
    size = struct.calcsize(letter)
    step = 3 + 3 * size + 5
    rows, row_padding = [], b"\xaa" * 7
    points = [
        [1.5, -2.25, 3.0],
        [0.5, 4.0, -8.0],
        [16.0, 0.125, 1.0],
        [2.0, 2.0, 2.5],
        [0, 0, 0],
        [7.0, 9.0, -1.0],
    ]
    for row in (points[:3], points[3:]):
        # z before x before y, with bytes of no meaning between and behind.
        packed = [b"\xff" * 3 + struct.pack(order + 3 * letter, z, x, y) + b"\xff" * 5 for x, y, z in row]
        rows.append(b"".join(packed) + row_padding)
    fields = [("z", 3, datatype), ("x", 3 + size, datatype), ("y", 3 + 2 * size, datatype)]
    item = bags.cloud_message(
        "ros1",
        T0_NS,
        fields,
        b"".join(rows),
        height=2,
        width=3,
        point_step=step,
        row_step=3 * step + 7,
        is_bigendian=order == ">",
    )
    cloud = read_one_cloud(tmp_path, item)
    np.testing.assert_array_equal(cloud.points, points)
    assert cloud.points.dtype == np.float64 and cloud.colors is None


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("form", ["rgb float", "rgb uint32", "rgba uint32", "bytes"])
def test_colours_are_unpacked_from_every_form(order: str, form: str, tmp_path: Path) -> None:
    colors = [[10, 20, 30], [255, 0, 128]]
    fields = [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32)]
    data = b""
    for i, (r, g, b) in enumerate(colors):
        data += struct.pack(order + "fff", i, 0, 0)
        data += bytes([r, g, b, 9]) if form == "bytes" else struct.pack(order + "I", r << 16 | g << 8 | b)
    if form == "bytes":
        fields += [("r", 12, UINT8), ("g", 13, UINT8), ("b", 14, UINT8)]
    else:
        name, kind = form.split()
        fields.append((name, 12, FLOAT32 if kind == "float" else UINT32))
    item = bags.cloud_message("ros1", T0_NS, fields, data, width=2, point_step=16, is_bigendian=order == ">")
    cloud = read_one_cloud(tmp_path, item)
    np.testing.assert_array_equal(cloud.colors, colors)
    np.testing.assert_array_equal(cloud.points[:, 0], [0, 1])


def test_points_that_are_not_finite_are_dropped_and_counted(tmp_path: Path) -> None:
    points = [[1, 2, 3], [np.nan, 0, 0], [0, np.inf, 0], [4, 5, 6]]
    cloud = read_one_cloud(tmp_path, xyz_cloud("ros1", T0_NS, points))
    np.testing.assert_array_equal(cloud.points, [[1, 2, 3], [4, 5, 6]])
    assert cloud.dropped_nonfinite == 2


@pytest.mark.parametrize(("points", "found"), [([], "empty"), ([[np.nan] * 3] * 4, "all 4 points")])
def test_a_cloud_without_a_finite_point_is_refused(points: list, found: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"topic /map.*{found}"):
        read_one_cloud(tmp_path, xyz_cloud("ros1", T0_NS, points))


def test_a_cloud_that_contradicts_itself_is_refused(tmp_path: Path) -> None:
    fields = [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32)]
    layouts = (
        (fields, {"width": 3, "point_step": 12}),  # more points than bytes
        (fields, {"width": 2, "point_step": 8}),  # z lies beyond the point
        (fields, {"width": 1, "height": 2, "point_step": 12, "row_step": 4}),  # rows overlap
        (fields[:2], {"width": 2, "point_step": 12}),  # no z
        ([*fields[:2], ("z", 8, UINT32)], {"width": 2, "point_step": 12}),  # z is no float
    )
    for i, (described, layout) in enumerate(layouts):
        item = bags.cloud_message("ros1", T0_NS, described, bytes(24), **layout)
        path = write_bag(tmp_path / f"{i}.bag", "ros1", [("/map", T0_NS, item)])
        with pytest.raises(InputError, match="topic /map"):
            bag_cloud(path)
