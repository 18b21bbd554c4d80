"""RGB-D folders of every layout, made here; real ones are in test_io_real_input.py."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from maomaps_warp.errors import InputError
from maomaps_warp.io.rgbd_folders import read_rgbd_folder, recognise_rgbd_folder
from maomaps_warp.io.source import Part, Side, Source, SourceOptions
from maomaps_warp.io.sources import open_source
from maomaps_warp.model.camera import Camera

#: Half a unit in the last place of float32 at a few metres, metres.
FLOAT32_TOLERANCE_M = 5e-7
SMALL = Camera(4, 3, 2.0, 2.0, 1.5, 1.0)
#: camera-to-world: turned by 90 degrees about y, moved.
T_TURNED = np.array([[0.0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1]])


def write_depth(path: Path, value: int, size: tuple[int, int] = (4, 3)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full(size[::-1], value, np.uint16)).save(path)


def write_color(path: Path, red: int, size: tuple[int, int] = (4, 3)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((*size[::-1], 3), (red, 0, 0), np.uint8)).save(path)


def matrix_text(matrix: NDArray[np.float64]) -> str:
    return "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in matrix)


def opened(path: Path, camera: Camera | None = None, part: Part = "all") -> Source:
    layout = recognise_rgbd_folder(path)
    assert layout is not None
    return read_rgbd_folder(path, layout=layout, camera=camera, part=part)


def refusal(path: Path, camera: Camera | None = None) -> str:
    with pytest.raises(InputError) as caught:
        opened(path, camera)
    return str(caught.value)


# TUM RGB-D


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    for stamp, value in (("1305031229.528784001", 5000), ("1305031229.60", 10000), ("1305031230.0", 65535)):
        write_depth(tmp_path / "depth" / f"{stamp}.png", value)
    # 20 ms before the first, 20 ms and 1 ns after the second.
    write_color(tmp_path / "rgb" / "1305031229.508784001.png", 7)
    write_color(tmp_path / "rgb" / "1305031229.620000001.png", 8)
    rows = [f"130503122{second}.5 {second} 0 0 0 0 0 1" for second in (8, 9)] + ["1305031230.5 9 0 0 0 0 0 1"]
    (tmp_path / "groundtruth.txt").write_text("# ground truth\n" + "\n".join(rows) + "\n")
    return tmp_path


def test_poses_of_a_folder_that_the_user_declared_are_not_assumed(tum: Path) -> None:
    declared = open_source(tum, SourceOptions(camera=SMALL, pose_frame="body"), "one").trajectory
    left_open = open_source(tum, SourceOptions(camera=SMALL), "one").trajectory
    assert declared is not None and declared.pose_frame == "body" and not declared.is_assumed
    assert left_open is not None and left_open.is_assumed


def test_names_of_tum_images_are_stamps_to_the_nanosecond(tum: Path) -> None:
    frames = list(opened(tum, SMALL).frames.read(False))
    stamps = [frame.stamp_ns for frame in frames]
    assert stamps == [1305031229_528784001, 1305031229_600000000, 1305031230_000000000]
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert all(frame.colors is None for frame in frames)


def test_tum_depth_is_value_by_5000_and_65535_is_missing(tum: Path) -> None:
    depths = [float(frame.depth.max()) for frame in opened(tum, SMALL).frames.read(False)]
    np.testing.assert_allclose(depths, [1.0, 2.0, 0.0], rtol=0, atol=FLOAT32_TOLERANCE_M)


def test_colour_joins_up_to_20_ms_and_not_a_nanosecond_more(tum: Path) -> None:
    folder = opened(tum, SMALL)
    colors = [frame.colors for frame in folder.frames.read(True)]
    assert colors[0] is not None and colors[0][0, 0].tolist() == [7, 0, 0]
    assert colors[1] is None and colors[2] is None
    assert "2 of 3 depth images have no colour image" in folder.notes


def test_frames_can_be_read_again(tum: Path) -> None:
    frames = opened(tum, SMALL).frames
    assert [f.stamp_ns for f in frames.read(False)] == [f.stamp_ns for f in frames.read(True)]


def test_the_lists_of_a_tum_folder_win_over_its_file_names(tum: Path) -> None:
    first = "depth/1305031229.528784001.png"
    (tum / "depth.txt").write_text(f"# depth\n7.25 depth/1305031229.60.png\n5.5 {first}\n")
    (tum / "rgb.txt").write_text("5.5 rgb/1305031229.620000001.png\n")
    frames = list(opened(tum, SMALL).frames.read(True))
    assert [frame.stamp_ns for frame in frames] == [5_500_000_000, 7_250_000_000]
    assert frames[0].colors is not None and frames[0].colors[0, 0, 0] == 8


@pytest.mark.parametrize("depth_first", [True, False])
def test_associations_may_name_depth_or_colour_first(tum: Path, depth_first: bool) -> None:
    pair = ["1305031229.6 depth/1305031229.60.png", "1305031229.5 rgb/1305031229.508784001.png"]
    (tum / "associations.txt").write_text(" ".join(pair if depth_first else pair[::-1]) + "\n")
    folder = opened(tum, SMALL)
    (frame,) = folder.frames.read(True)
    assert frame.stamp_ns == 1305031229_600000000
    assert frame.colors is not None and frame.colors[0, 0, 0] == 7
    assert "2 depth images are not in associations.txt, not used" in folder.notes


def test_a_listed_image_that_is_missing_is_refused_with_its_name(tum: Path) -> None:
    (tum / "depth.txt").write_text("1.0 depth/1305031229.60.png\n2.0 depth/gone.png\n")
    message = refusal(tum, SMALL)
    assert "depth.txt: 1 of 2 listed files are missing" in message and "gone.png" in message


@pytest.mark.parametrize("name", ["cloud", "1305031229528784000", "nan"])
def test_a_tum_image_whose_name_is_no_stamp_is_refused(tum: Path, name: str) -> None:
    write_depth(tum / "depth" / f"{name}.png", 1)
    assert f"{name}.png" in refusal(tum, SMALL)


def test_the_assumed_tum_camera_is_said_and_another_image_size_refused(tum: Path) -> None:
    assert "4x3, the camera 640x480" in refusal(tum)
    for path in (tum / "depth").iterdir():
        write_depth(path, 5000, (640, 480))
    folder = opened(tum)
    assert folder.frames.camera == Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    assert any("camera assumed" in note and "525" in note for note in folder.notes)
    assert not any("camera" in note for note in opened(tum, Camera(640, 480, 500, 500, 320, 240)).notes)


def test_a_later_image_of_another_size_is_refused_when_its_turn_comes(tum: Path) -> None:
    write_depth(tum / "depth" / "1305031230.0.png", 5000, (5, 3))
    with pytest.raises(InputError, match=r"1305031230.0.png: the image is 5x3"):
        list(opened(tum, SMALL).frames.read(False))


def test_a_tum_folder_without_ground_truth_serves_where_other_poses_are_brought(tum: Path) -> None:
    (tum / "groundtruth.txt").unlink()
    (tum / "depth.txt").write_text("1.0 depth/1305031229.60.png\n")
    assert opened(tum, SMALL, part="map").trajectory is None
    assert "groundtruth.txt" in refusal(tum, SMALL)


# 3DMatch / 7-Scenes


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "camera-intrinsics.txt").write_text("2 0 1.5\n0 2 1\n0 0 1\n")
    for number in range(3):
        stem = tmp_path / "seq-01" / f"frame-{number:06d}"
        write_depth(Path(f"{stem}.depth.png"), 1000 * (number + 1))
        write_color(Path(f"{stem}.color.png"), number)
        T = T_TURNED.copy()
        T[0, 3] = number
        Path(f"{stem}.pose.txt").write_text(matrix_text(T))
    return tmp_path


def test_3dmatch_frames_pair_with_poses_by_index(scene: Path) -> None:
    folder = opened(scene)
    frames = list(folder.frames.read(True))
    assert folder.frames.camera == SMALL
    assert folder.trajectory is not None and folder.trajectory.stamps_ns is None
    assert [(f.index, f.stamp_ns) for f in frames] == [(0, None), (1, None), (2, None)]
    assert [float(f.depth[0, 0]) for f in frames] == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(folder.trajectory.positions, [[0, 2, 3], [1, 2, 3], [2, 2, 3]])
    np.testing.assert_array_equal(folder.trajectory.T_world_camera[0, :3, :3], T_TURNED[:3, :3])


@pytest.mark.parametrize("lost", ["nan", "-inf", "-1.#IND00000e+000"])
def test_a_frame_whose_pose_is_lost_is_skipped_and_counted(scene: Path, lost: str) -> None:
    path = scene / "seq-01" / "frame-000001.pose.txt"
    path.write_text((f"{lost} " * 4 + "\n") * 3 + "0 0 0 1\n")
    folder = opened(scene)
    assert folder.trajectory is not None
    assert folder.trajectory.positions[:, 0].tolist() == [0.0, 2.0]
    assert [(f.index, float(f.depth[0, 0])) for f in folder.frames.read(False)] == [(0, 1.0), (1, 3.0)]
    assert "1 of 3 frames skipped because their pose is lost (NaN): frame-000001" in folder.notes


def test_a_lost_pose_costs_no_frame_where_other_poses_are_brought(scene: Path) -> None:
    (scene / "seq-01" / "frame-000001.pose.txt").write_text("nan nan nan nan\n" * 4)
    assert opened(scene, part="map").frames.count == 3


@pytest.mark.parametrize("fixture", ["tum", "scene"])
def test_folders_wanted_for_their_poses_alone_need_no_readable_image(
    fixture: str, request: pytest.FixtureRequest
) -> None:
    folder = request.getfixturevalue(fixture)
    for image in folder.rglob("*.png"):
        image.write_bytes(b"no image")
    assert "cannot be read" in refusal(folder)
    found = opened(folder, part="trajectory")
    assert found.frames is None and found.trajectory is not None and len(found.trajectory) > 1
    assert (found.camera is None) == (fixture == "scene")
    assert any(note.startswith("camera ") for note in found.notes)


def test_several_sequences_are_refused_and_one_of_them_is_accepted(scene: Path) -> None:
    (scene / "seq-01").rename(scene / "seq-07")
    write_depth(scene / "seq-02" / "frame-000000.depth.png", 1)
    assert "several sequences: seq-02, seq-07" in refusal(scene)
    assert opened(scene / "seq-07").frames.camera == SMALL


def test_a_sequence_without_intrinsics_asks_for_the_camera(scene: Path) -> None:
    (scene / "camera-intrinsics.txt").unlink()
    assert "--camera" in refusal(scene)
    assert opened(scene, SMALL).frames.count == 3


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (matrix_text(np.diag([1.0, 1.0, 1.1, 1.0])), "no rotation matrix"),
        (matrix_text(np.diag([1.0, 1.0, -1.0, 1.0])), "mirrored"),
        (matrix_text(np.diag([1.0, 1.0, 1.0, 2.0])), "last row"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "3 rows"),
        ("1 0 0\n0 1 0\n0 0 1\n0 0 0\n", "4x3"),
        ("1 0 0 0\n0 1 0 x\n0 0 1 0\n0 0 0 1\n", "line 2"),
    ],
)
def test_a_file_that_is_no_pose_is_refused_with_its_place(scene: Path, text: str, complaint: str) -> None:
    (scene / "seq-01" / "frame-000002.pose.txt").write_text(text)
    message = refusal(scene)
    assert "frame-000002.pose.txt" in message and complaint in message


def test_a_rounded_rotation_is_projected_onto_a_rotation(scene: Path) -> None:
    angle = 0.3
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    (scene / "seq-01" / "frame-000000.pose.txt").write_text(matrix_text(np.round(T, 4)))
    folder = opened(scene)
    assert folder.trajectory is not None
    R = folder.trajectory.T_world_camera[0, :3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), rtol=0, atol=1e-14)  # float64 rounding
    np.testing.assert_allclose(R, T[:3, :3], rtol=0, atol=1e-4)  # what was rounded away


def test_a_missing_pose_file_is_refused_with_its_name(scene: Path) -> None:
    (scene / "seq-01" / "frame-000001.pose.txt").unlink()
    assert "frame-000001.pose.txt: no such file" in refusal(scene)


# Open3D / Redwood


@pytest.fixture
def redwood(tmp_path: Path) -> Path:
    for number in (2, 10):
        write_depth(tmp_path / "depth" / f"{number}.png", 1000 * number)
        write_color(tmp_path / "color" / f"{number}.png", number)
    log = "".join(f"{i} {i} {i + 1}\n{matrix_text(T_TURNED + i * np.eye(4, k=3))}" for i in range(2))
    (tmp_path / "trajectory.log").write_text(log)
    matrix = [2.0, 0, 0, 0, 2.0, 0, 1.5, 1.0, 1]  # column by column
    (tmp_path / "camera.json").write_text(json.dumps({"width": 4, "height": 3, "intrinsic_matrix": matrix}))
    return tmp_path


def test_open3d_images_are_taken_in_the_order_of_their_numbers(redwood: Path) -> None:
    folder = opened(redwood)
    assert folder.frames.camera == SMALL
    frames = [(f.index, f.stamp_ns, float(f.depth[0, 0]), f.colors) for f in folder.frames.read(True)]
    assert [frame[:3] for frame in frames] == [(0, None, 2.0), (1, None, 10.0)]
    assert [int(frame[3][0, 0, 0]) for frame in frames if frame[3] is not None] == [2, 10]
    assert folder.trajectory is not None
    np.testing.assert_array_equal(folder.trajectory.positions, [[1, 2, 3], [2, 2, 3]])


def test_odometry_log_serves_where_there_is_no_trajectory_log(redwood: Path) -> None:
    (redwood / "trajectory.log").rename(redwood / "odometry.log")
    assert any("poses of odometry.log" in note for note in opened(redwood).notes)


def test_quaternion_lines_serve_as_poses_without_stamps(redwood: Path) -> None:
    (redwood / "trajectory.log").unlink()
    half = np.sqrt(0.5)
    (redwood / "pose.txt").write_text(f"1 2 3 0 {half} 0 {half}\n4 5 6 0 0 0 1\n")
    folder = opened(redwood)
    assert folder.trajectory is not None
    np.testing.assert_allclose(folder.trajectory.T_world_camera[0], T_TURNED, rtol=0, atol=1e-15)


def test_unequal_counts_of_poses_and_images_are_refused_with_both(redwood: Path) -> None:
    write_depth(redwood / "depth" / "11.png", 1)
    assert "2 poses, but 3 images" in refusal(redwood)


@pytest.mark.parametrize(
    ("damage", "complaint"),
    [
        (lambda text: text[: text.rindex("0 0 0 1")], "9 lines"),
        (lambda text: text.replace("1 1 2", "1 1"), "line 6: '1 1'"),
        (lambda text: text.replace("-1 0 0 3", "-1 0 0.5 3", 1), "line 2: no rotation matrix"),
    ],
)
def test_a_damaged_pose_log_is_refused_with_its_line(redwood: Path, damage, complaint: str) -> None:
    path = redwood / "trajectory.log"
    path.write_text(damage(path.read_text()))
    message = refusal(redwood)
    assert "trajectory.log" in message and complaint in message


def test_an_open3d_folder_without_its_camera_asks_for_it(redwood: Path) -> None:
    (redwood / "camera.json").write_text('{"other": 1}')
    assert "--camera" in refusal(redwood)
    assert opened(redwood, SMALL).frames.count == 2


@pytest.mark.parametrize("text", ["{", '{"intrinsic_matrix": [1, 2]}', '{"intrinsic_matrix": null, "width": 4}'])
def test_a_damaged_camera_json_is_refused_with_its_name(redwood: Path, text: str) -> None:
    (redwood / "camera.json").write_text(text)
    assert "camera.json" in refusal(redwood)


def test_a_folder_of_none_of_the_layouts_is_not_recognised(tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    assert recognise_rgbd_folder(tmp_path) is None
    with pytest.raises(InputError, match="is no 3dmatch folder"):
        read_rgbd_folder(tmp_path, layout="3dmatch")


@pytest.mark.parametrize(("side", "hint"), [("one", "choose with --format"), ("gt", "choose with --gt-format")])
def test_a_folder_of_two_layouts_names_the_option_of_its_command(tmp_path: Path, side: Side, hint: str) -> None:
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth.txt").touch()
    (tmp_path / "pose.txt").touch()
    with pytest.raises(InputError) as caught:
        open_source(tmp_path, SourceOptions(), side)
    assert caught.value.hint == hint
