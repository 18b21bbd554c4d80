"""Opening anything: what a path is recognised as, and what each side takes from it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import (
    BAG_KINDS,
    BagKind,
    Entry,
    bag_path,
    camera_info,
    cloud_message,
    depth_message,
    odometry,
    pose_stamped,
    write_bag,
)
from PIL import Image

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags import frames, open_bag, topics
from maomaps_warp.io.sources import (
    Side,
    Source,
    SourceOptions,
    open_source,
    source_from_parts,
)
from maomaps_warp.model.camera import Camera

AUTO = SourceOptions()
CAMERA = Camera(4, 3, 2.0, 2.0, 1.5, 1.0)
TUM_ROWS = "1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0 1\n"
#: Stamps of the bags, nanoseconds.
STAMPS = (1_000_000_000, 2_000_000_000, 3_000_000_000)


def parts_of(source: Source) -> tuple[str, ...]:
    return tuple(name for name in ("trajectory", "cloud", "frames") if getattr(source, name) is not None)


def one_point(kind: BagKind, stamp: int) -> Any:
    fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)]  # float32
    data = np.array([1.0, 2.0, 3.0], np.float32).tobytes()
    return cloud_message(kind, stamp, fields, data, width=1, point_step=12)


def write_run(folder: Path, kind: BagKind = "ros1", holds: str = "cloud depth info pose") -> Path:
    """A bag with one point, three depth images, their camera and poses, or some of these."""
    entries: list[Entry] = []
    for stamp in STAMPS:
        if "info" in holds:
            entries.append(("/camera/camera_info", stamp, camera_info(kind, stamp, CAMERA)))
        if "distorted" in holds:
            entries.append(("/lens/camera_info", stamp, camera_info(kind, stamp, CAMERA, (0.1, 0, 0, 0, 0))))
        if "cloud" in holds:
            entries.append(("/cloud", stamp, one_point(kind, stamp)))
        if "depth" in holds:
            depth = np.full((3, 4), 1.5, np.float32)
            entries.append(("/camera/image", stamp, depth_message(kind, stamp, depth)))
        if "pose" in holds:
            entries.append(("/pose", stamp, pose_stamped(kind, stamp, (stamp * 1e-9, 0, 0))))
        if "odom" in holds:
            entries.append(("/odom", stamp, odometry(kind, stamp, (7, 7, 7))))
    return write_bag(bag_path(folder, kind), kind, entries)


def write_scene(folder: Path, lost: int | None = None) -> Path:
    """A 3DMatch sequence of three frames, the pose of one of them lost or not."""
    folder.mkdir(exist_ok=True)
    (folder / "camera-intrinsics.txt").write_text("2 0 1.5\n0 2 1\n0 0 1\n")
    for number in range(3):
        Image.fromarray(np.full((3, 4), 1000, np.uint16)).save(folder / f"frame-{number:06d}.depth.png")
        row = "nan nan nan nan\n" if number == lost else f"1 0 0 {number}\n"
        (folder / f"frame-{number:06d}.pose.txt").write_text(row + "0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    return folder


def refusal(path: Path, options: SourceOptions = AUTO, side: Side = "gt") -> str:
    with pytest.raises(InputError) as caught:
        open_source(path, options, side)
    return str(caught.value)


# Files


@pytest.mark.parametrize(
    ("name", "content", "kind", "parts"),
    [
        ("a.txt", TUM_ROWS, "TUM trajectory", ("trajectory",)),
        ("a.dat", "1 0 0 0 0 1 0 0 0 0 1 0\n", "KITTI trajectory", ("trajectory",)),
        (
            "a.csv",
            "#ns,x\n1000000000,0,0,0,1,0,0,0\n2000000000,0,0,0,1,0,0,0\n",
            "EuRoC trajectory",
            ("trajectory",),
        ),
        ("a.txt", "1 2 3 0.1 0.2 0.3\n", "MAOMaps trajectory", ("trajectory",)),
        ("a.txt", "1 2 3\n4 5 6\n", "XYZ map", ("cloud",)),
        ("a.txt", "1 2 3 255 0 9\n", "XYZ map", ("cloud",)),
    ],
)
def test_a_file_is_recognised_by_its_content_not_by_its_name(
    tmp_path: Path, name: str, content: str, kind: str, parts: tuple[str, ...]
) -> None:
    (tmp_path / name).write_text(content)
    source = open_source(tmp_path / name, AUTO, "est")
    assert (source.kind, parts_of(source)) == (kind, parts)
    assert source.name == str(tmp_path / name) and source.camera is None


def test_a_named_format_overrides_what_is_recognised(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("1 2 3 0.5 0 0\n4 5 6 1 0 0\n")
    assert open_source(path, AUTO, "est").kind == "MAOMaps trajectory"
    assert open_source(path, SourceOptions(format="xyz"), "est").kind == "XYZ map"
    assert "allowed: auto, tum" in refusal(path, SourceOptions(format="tmu"))
    assert "3dmatch is a folder" in refusal(path, SourceOptions(format="3dmatch"))


def test_the_pose_frame_is_the_users_to_name(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(TUM_ROWS)
    source = open_source(tmp_path / "a.txt", SourceOptions(pose_frame="body"), "est")
    assert source.trajectory is not None
    R = source.trajectory.T_world_camera[0, :3, :3]
    np.testing.assert_array_equal(R, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def test_poses_of_one_stamp_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(TUM_ROWS + "2.0 5 0 0 0 0 0 1\n")
    assert "stands twice" in refusal(tmp_path / "a.txt")


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "an empty file"),
        (b"\x89PNG\r\n\x1a\n", "a PNG image"),
        (b"\0\1\2", "binary data"),
        (b"1 2\n3 4\n", "2 numbers a row"),
        (b"Dear reader,\nhello\n", "starts with 'Dear reader,'"),
        (b"\n hello\n", "starts with 'hello'"),
        (b" \n\n", "starts with ''"),
    ],
)
def test_what_cannot_be_recognised_is_described_with_the_way_out(
    tmp_path: Path, content: bytes, complaint: str
) -> None:
    path = tmp_path / "thing"
    path.write_bytes(content)
    for side in ("gt", "est"):
        message = refusal(path, AUTO, side)
        assert complaint in message and "PCD" in message and f"--{side}-format" in message


def test_a_missing_path_is_refused_with_its_name(tmp_path: Path) -> None:
    assert refusal(tmp_path / "gone") == f"{tmp_path / 'gone'}: no such file or folder"


def test_an_unknown_folder_is_described_by_what_lies_in_it(tmp_path: Path) -> None:
    assert "an empty folder" in refusal(tmp_path)
    (tmp_path / "sub").mkdir()
    (tmp_path / "notes.md").write_text("x")
    assert "a folder with notes.md, sub/" in refusal(tmp_path)


def test_topics_without_a_bag_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(TUM_ROWS)
    assert "not a bag" in refusal(tmp_path / "a.txt", SourceOptions(topics=("/pose",)))


# Bags


@pytest.mark.parametrize("kind", BAG_KINDS)
def test_of_clouds_and_depth_the_estimate_takes_clouds_and_the_ground_truth_depth(
    tmp_path: Path, kind: BagKind
) -> None:
    path = write_run(tmp_path, kind)
    gt, est = open_source(path, AUTO, "gt"), open_source(path, AUTO, "est")
    assert parts_of(gt) == ("trajectory", "frames") and parts_of(est) == ("trajectory", "cloud")
    assert gt.camera == est.camera == CAMERA
    for source, side in ((gt, "gt"), (est, "est")):
        assert any(f"--{side}-topic" in note for note in source.notes)
    assert gt.frames is not None
    assert [frame.stamp_ns for frame in gt.frames.read(False)] == list(STAMPS)


def test_a_named_topic_decides_between_clouds_and_depth(tmp_path: Path) -> None:
    path = write_run(tmp_path)
    gt = open_source(path, SourceOptions(topics=("/cloud",)), "gt")
    est = open_source(path, SourceOptions(topics=("/camera/image", "/pose")), "est")
    assert parts_of(gt) == ("trajectory", "cloud") and parts_of(est) == ("trajectory", "frames")
    assert not any("topic decides" in note for note in (*gt.notes, *est.notes))


def test_a_bag_is_opened_once_for_a_side_and_its_frames_when_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []

    def counting(path: Path) -> Any:
        opened.append(path)
        return open_bag(path)

    for module in (topics, frames):
        monkeypatch.setattr(module, "open_bag", counting)
    source = open_source(write_run(tmp_path, holds="depth info pose"))
    assert len(opened) == 1 and source.frames is not None
    assert len(list(source.frames.read(False))) == len(STAMPS) and len(opened) == 2


def test_kinds_of_bags_are_named(tmp_path: Path) -> None:
    kinds = [open_source(write_run(tmp_path, kind), AUTO, "est").kind for kind in BAG_KINDS]
    assert kinds == ["ROS 1 bag", "ROS 2 bag folder", "ROS 2 bag folder", "MCAP recording"]


def test_the_users_camera_wins_over_the_bags(tmp_path: Path) -> None:
    other = Camera(4, 3, 9.0, 9.0, 1.5, 1.0)
    source = open_source(write_run(tmp_path), SourceOptions(camera=other), "gt")
    assert source.camera == other and source.frames is not None and source.frames.camera == other


def test_a_distorted_camera_is_noted_beside_a_cloud_and_refused_for_depth(tmp_path: Path) -> None:
    path = write_run(tmp_path, holds="cloud depth distorted pose")
    est = open_source(path, AUTO, "est")
    assert est.camera is None and any("camera not used" in note for note in est.notes)
    assert "distortion" in refusal(path)


def test_depth_without_poses_asks_for_them_and_takes_them_from_elsewhere(tmp_path: Path) -> None:
    path = write_run(tmp_path, holds="depth info")
    assert "--gt-trajectory" in refusal(path)
    (tmp_path / "poses.txt").write_text(TUM_ROWS)
    source = open_source(path, AUTO, "gt", trajectory_path=tmp_path / "poses.txt")
    assert parts_of(source) == ("trajectory", "frames")


def test_a_bag_of_neither_map_nor_poses_lists_its_topics(tmp_path: Path) -> None:
    message = refusal(write_run(tmp_path, holds="info"))
    assert "neither a map nor poses" in message and "/camera/camera_info" in message


def test_ambiguous_poses_do_not_matter_where_only_the_map_is_wanted(tmp_path: Path) -> None:
    path = write_run(tmp_path, holds="cloud pose odom")
    assert "/odom" in refusal(path)
    assert parts_of(source_from_parts(path, None, AUTO, "est")) == ("cloud",)
    source = source_from_parts(None, path, SourceOptions(topics=("/odom",)), "est")
    assert parts_of(source) == ("trajectory",)


# Parts


def test_a_map_and_a_trajectory_make_a_side(tmp_path: Path) -> None:
    (tmp_path / "map.txt").write_text("1 2 3\n4 5 6\n")
    (tmp_path / "poses.txt").write_text(TUM_ROWS)
    source = source_from_parts(tmp_path / "map.txt", tmp_path / "poses.txt", AUTO, "est")
    assert source.kind == "XYZ map + TUM trajectory" and parts_of(source) == ("trajectory", "cloud")
    for format in ("tum", "xyz"):  # each is meant for the part that it fits
        again = source_from_parts(tmp_path / "map.txt", tmp_path / "poses.txt", SourceOptions(format=format), "est")
        assert again.kind == source.kind


def test_a_part_that_is_not_what_it_was_given_as_is_refused(tmp_path: Path) -> None:
    (tmp_path / "map.txt").write_text("1 2 3\n4 5 6\n")
    (tmp_path / "poses.txt").write_text(TUM_ROWS)
    with pytest.raises(InputError, match=r"poses.txt: holds no map \(it was read as: TUM trajectory\)"):
        source_from_parts(tmp_path / "poses.txt", None, AUTO, "est")
    with pytest.raises(InputError, match=r"map.txt: holds no poses \(it was read as: XYZ map\)"):
        source_from_parts(None, tmp_path / "map.txt", AUTO, "est")


def test_a_whole_and_both_parts_are_one_too_many(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="leave nothing to take from it"):
        open_source(tmp_path, AUTO, "gt", map_path=tmp_path, trajectory_path=tmp_path)


def test_frames_without_stamps_need_as_many_poses(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "scene")
    (tmp_path / "two.txt").write_text(TUM_ROWS)
    with pytest.raises(InputError, match="2 poses for the 3 depth images"):
        open_source(scene, AUTO, "est", trajectory_path=tmp_path / "two.txt")
    (tmp_path / "three.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    assert parts_of(open_source(scene, AUTO, "est", trajectory_path=tmp_path / "three.txt")) == (
        "trajectory",
        "frames",
    )


def test_poses_of_another_file_pair_with_every_frame_although_the_folder_lost_one(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "scene", lost=1)
    own = open_source(scene, AUTO, "gt")
    assert own.frames is not None and own.frames.count == 2
    assert any("1 of 3 frames skipped" in note for note in own.notes)
    (tmp_path / "three.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    source = open_source(scene, AUTO, "gt", trajectory_path=tmp_path / "three.txt")
    assert source.frames is not None and source.frames.count == 3


def test_a_sample_directory_wins_over_the_recordings_in_it(tmp_path: Path) -> None:
    (tmp_path / "gt_points_first.txt").write_text("1 2 3\n")
    (tmp_path / "gt_poses_first.txt").write_text("1 2 3 0 0 0\n")
    (tmp_path / "gt_poses_first_timestamps.txt").write_text("1.5\n")
    (tmp_path / "start_pose_first.txt").write_text("1 2 3\n0.25\n")
    (tmp_path / "first.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert "--run first or --run second" in refusal(tmp_path)
    source = open_source(tmp_path, SourceOptions(run="first"), "gt")
    assert source.kind == "MAOMaps sample directory, run first"
    assert source.start_pose == (1.0, 2.0, 3.0, 0.25)
    assert parts_of(source) == ("trajectory", "cloud")


def test_opening_does_not_load_warp_nor_a_bag_reader_for_text(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(TUM_ROWS)
    code = (
        "import sys; from pathlib import Path; from maomaps_warp.io.sources import *;"
        f"open_source(Path({str(tmp_path / 'a.txt')!r}), SourceOptions(), 'gt');"
        "print(*[m for m in ('warp', 'rosbags', 'mcap', 'PIL', 'trimesh') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == []
