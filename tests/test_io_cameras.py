from __future__ import annotations

import math
from pathlib import Path

import pytest

from maomaps_warp.errors import InputError
from maomaps_warp.io.cameras import parse_camera
from maomaps_warp.model.camera import Camera

CALIBRATION = """\
image_width: 640
image_height: 480
camera_name: kinect
camera_matrix:
  rows: 3
  cols: 3
  data: [525.0, 0.0, 319.5, 0.0, 526.5, 239.5, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.0, 0.0, 0.0, 0.0, 0.0]
"""
ROS1_ECHO = """\
header:
  seq: 7
  stamp:
    secs: 1
    nsecs: 2
  frame_id: "camera"
height: 480
width: 640
distortion_model: "plumb_bob"
D: [0.0, 0.0, 0.0, 0.0, 0.0]
K: [525.0, 0.0, 319.5, 0.0, 526.5, 239.5, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
---
"""
ROS2_ECHO = """\
height: 480
width: 640
distortion_model: plumb_bob
d: []
k:
- 525.0
- 0.0
- 319.5
- 0.0
- 526.5
- 239.5
- 0.0
- 0.0
- 1.0
---
height: 1
width: 1
k: [1, 0, 0, 0, 1, 0, 0, 0, 1]
"""
EXPECTED = Camera(640, 480, 525.0, 526.5, 319.5, 239.5)


def test_a_field_of_view_gives_square_pixels_and_a_centred_axis() -> None:
    camera = parse_camera("320x240@90")
    assert (camera.width, camera.height, camera.cx, camera.cy) == (320, 240, 159.5, 119.5)
    # tan(45 degrees) = 1: the focal length is half the width, but for the rounding of tan.
    assert math.isclose(camera.fx, 160.0, rel_tol=1e-15) and camera.fx == camera.fy
    assert parse_camera(" 640x480@57.5 ").width == 640


def test_intrinsics_are_taken_as_written() -> None:
    assert parse_camera("640x480:525,526.5,319.5,239.5") == EXPECTED


@pytest.mark.parametrize("text", [CALIBRATION, ROS1_ECHO, ROS2_ECHO], ids=["file", "rostopic", "ros2 topic"])
def test_calibration_files_and_echoed_messages_are_read(text: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    assert parse_camera(str(path)) == EXPECTED


@pytest.mark.parametrize(
    "spec",
    ["", "320x240", "320x240@", "320x240@ninety", "320x240:1,2,3", "axb@90", "none.yaml", "320x240@90@90"],
)
def test_a_spec_of_another_form_is_refused_with_the_forms(spec: str) -> None:
    with pytest.raises(InputError, match=r"320x240@90\), WIDTHxHEIGHT:fx,fy,cx,cy, or a ROS calibration YAML"):
        parse_camera(spec)


@pytest.mark.parametrize(
    "spec",
    [
        "0x240@90",
        "320x240@0",
        "320x240@180",
        "320x240@-5",
        "320x240@1e",
        "320x240:0,1,1,1",
        "320x240:1,1,e,1",
    ],
)
def test_impossible_numbers_are_refused(spec: str) -> None:
    with pytest.raises(InputError, match=f"camera '{spec}'"):
        parse_camera(spec)


@pytest.mark.parametrize("text", [CALIBRATION, ROS1_ECHO], ids=["file", "echo"])
def test_distortion_is_refused_with_the_way_out(text: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text.replace("[0.0, 0.0, 0.0, 0.0, 0.0]", "[0.0, 0.0, 1.0e-3, 0.0, 0.0]"))
    with pytest.raises(InputError, match=r"lens distortion 0, 0, 0\.001, 0, 0 \(rectify .*--camera"):
        parse_camera(str(path))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "not a camera calibration"),
        ("just words", "not a camera calibration"),
        ("a: [1, 2", "not a YAML file"),
        ("\x00\x01", "not a YAML file"),
        ("width: 3\nheight: 2", "no k"),
        (CALIBRATION.replace("image_width", "img_width"), "no width"),
        (CALIBRATION.replace("525.0, ", ""), "K has 8 numbers"),
        (CALIBRATION.replace("525.0", "fx"), "K is not a list of numbers"),
        (CALIBRATION.replace("525.0", ".nan"), "finite"),
        (CALIBRATION.replace("image_width: 640", "image_width: .inf"), "infinity"),
        (CALIBRATION.replace("525.0, 0.0,", "525.0, 0.3,"), "skew"),
        (ROS1_ECHO.replace("K: [", "K: [0, 0, 0, 0, 0, 0, 0, 0, 0] # "), "not calibrated"),
    ],
)
def test_a_file_without_a_usable_camera_is_refused_with_its_name(text: str, found: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=found) as caught:
        parse_camera(str(path))
    assert caught.value.where == str(path)


@pytest.mark.parametrize("more", ["binning_x: 2", "roi: {x_offset: 8}", "roi: {width: 320, height: 480}"])
def test_a_binned_or_cropped_image_is_refused(more: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(ROS1_ECHO.replace("height: 480\n", f"height: 480\n{more}\n"))
    with pytest.raises(InputError, match="binned or cropped"):
        parse_camera(str(path))
