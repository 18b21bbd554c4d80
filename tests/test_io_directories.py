"""Sample directories and the input directory of the original program, made here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from maomaps_warp.errors import InputError
from maomaps_warp.io.original_directory import is_original_directory, read_original_side
from maomaps_warp.io.sample_directories import (
    is_sample_directory,
    read_merged,
    read_sample,
    runs_of,
    sample_directories,
)
from maomaps_warp.io.source import Side

# MAOMaps sample directories


@pytest.fixture
def sample(tmp_path: Path) -> Path:
    (tmp_path / "gt_points_first.txt").write_text("0 0.05 0.1\n1 1.05 1.1\n")
    (tmp_path / "gt_colors_first.txt").write_text("1 2 3\n255 0 9\n")
    (tmp_path / "gt_poses_first.txt").write_text("1 2 3 0 0 0\n2 2 3 0 0 0\n")
    (tmp_path / "gt_poses_first_timestamps.txt").write_text("10.5\n10.600000001\n")
    (tmp_path / "start_pose_first.txt").write_text("1 2 3\n-0.5\n")
    return tmp_path


def test_a_run_of_a_sample_directory_gives_map_poses_and_start(sample: Path) -> None:
    assert is_sample_directory(sample)
    run = read_sample(sample, "first")
    assert run.cloud is not None and run.trajectory is not None
    np.testing.assert_array_equal(run.cloud.points, [[0, 0.05, 0.1], [1, 1.05, 1.1]])
    assert run.cloud.colors is not None and run.cloud.colors.tolist() == [[1, 2, 3], [255, 0, 9]]
    assert run.trajectory.stamps_ns is not None
    assert run.trajectory.stamps_ns.tolist() == [10_500_000_000, 10_600_000_001]
    assert run.start_pose == (1.0, 2.0, 3.0, -0.5)
    # A body that looks along x: the camera's z is the world's x, its x points right, to -y.
    R = run.trajectory.T_world_camera[0, :3, :3]
    np.testing.assert_allclose(R, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], rtol=0, atol=1e-15)


def test_a_sample_directory_asks_which_run_is_meant(sample: Path) -> None:
    for run in (None, "third"):
        with pytest.raises(InputError, match="--run first or --run second"):
            read_sample(sample, run)


def test_all_missing_files_of_a_sample_directory_are_listed(sample: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_sample(sample, "second")
    for name in (
        "gt_points_second",
        "gt_poses_second.txt",
        "gt_poses_second_timestamps.txt",
        "start_pose_second",
    ):
        assert name in str(caught.value)
    assert "gt_colors" not in str(caught.value)


def test_a_sample_map_without_colours_is_noted(sample: Path) -> None:
    (sample / "gt_colors_first.txt").unlink()
    run = read_sample(sample, "first", part="map")
    assert run.cloud is not None and run.cloud.colors is None and run.trajectory is None
    assert any("gt_colors_first.txt" in note for note in run.notes)


@pytest.mark.parametrize("text", ["1 2 3\n", "1 2 3\n256 0 0\n"])
def test_colours_that_do_not_belong_to_the_points_are_refused(sample: Path, text: str) -> None:
    (sample / "gt_colors_first.txt").write_text(text)
    with pytest.raises(InputError, match="gt_colors_first"):
        read_sample(sample, "first")


@pytest.mark.parametrize("text", ["", "1 2 3 4\n", "1 2 3\n", "1 2 3\nnan\n", "1 2 x\n0\n"])
def test_a_start_pose_of_another_form_is_refused(sample: Path, text: str) -> None:
    (sample / "start_pose_first.txt").write_text(text)
    with pytest.raises(InputError, match="start_pose_first"):
        read_sample(sample, "first")


def test_every_run_that_is_there_can_be_chosen_and_no_other(sample: Path) -> None:
    for name in ("gt_points", "gt_poses", "start_pose"):
        (sample / f"{name}_third.txt").write_text((sample / f"{name}_first.txt").read_text())
    (sample / "gt_poses_third_timestamps.txt").write_text("7\n8\n")
    assert runs_of(sample) == ("first", "third")
    third = read_sample(sample, "third").trajectory
    assert third is not None and third.stamps_ns is not None and third.stamps_ns[0] == 7_000_000_000
    for run in (None, "fourth", "merged"):
        with pytest.raises(InputError, match="--run first or --run second or --run third"):
            read_sample(sample, run)


def test_the_merged_map_is_read_with_its_colours_or_reported_missing(sample: Path) -> None:
    with pytest.raises(InputError, match="missing: gt_points_merged.txt or gt_points_merged.pcd"):
        read_merged(sample)
    for name in ("gt_points", "gt_colors"):
        (sample / f"{name}_merged.txt").write_text((sample / f"{name}_first.txt").read_text())
    merged = read_merged(sample)
    assert len(merged) == 2 and merged.colors is not None and merged.colors.tolist() == [[1, 2, 3], [255, 0, 9]]


def test_sample_directories_are_found_and_sorted_as_people_count(tmp_path: Path) -> None:
    for name in ("sample10", "sample2", "sample1"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "first.bag").write_bytes(b"")
    (tmp_path / "figures").mkdir()
    (tmp_path / ".git").mkdir()
    samples, others = sample_directories(tmp_path)
    assert [path.name for path in samples] == ["sample1", "sample2", "sample10"]
    assert [path.name for path in others] == ["figures"]
    assert sample_directories(tmp_path / "sample2") == ((tmp_path / "sample2",), ())
    with pytest.raises(InputError, match="no such folder"):
        sample_directories(tmp_path / "absent")


# The original program's directory


def test_digits_of_other_scripts_in_the_names_of_folders_do_no_harm(tmp_path: Path) -> None:
    for name in ("sample01", "sample1", "\u00b2", "\u0663"):
        (tmp_path / name).mkdir()
    assert [folder.name for folder in sample_directories(tmp_path)[1]] == ["sample01", "sample1", "\u00b2", "\u0663"]


@pytest.fixture
def original(tmp_path: Path) -> Path:
    for prefix, shift in (("gt", 0), ("slam", 1)):
        (tmp_path / f"{prefix}_points.txt").write_text(f"{shift} 0 0\n1 1 1\n")
        (tmp_path / f"{prefix}_poses.txt").write_text(f"{shift} 0 0 0 0 0\n2 2 2 0 0 1.5\n")
    return tmp_path


def test_both_sides_of_an_original_directory_pair_by_index(original: Path) -> None:
    assert is_original_directory(original)
    (original / "slam_poses_timestamps.txt").write_text("5\n6\n")  # not the original's; must not matter
    sides: tuple[tuple[Side, float], ...] = (("gt", 0.0), ("est", 1.0))
    for side, shift in sides:
        source = read_original_side(original, side)
        cloud, trajectory = source.cloud, source.trajectory
        assert cloud is not None and trajectory is not None
        assert cloud.points[0].tolist() == [shift, 0, 0]
        assert trajectory.positions[0].tolist() == [shift, 0, 0]
        assert trajectory.stamps_ns is None


def test_what_is_not_wanted_of_an_original_directory_may_be_damaged(original: Path) -> None:
    (original / "gt_points.txt").write_text("no cloud")
    poses = read_original_side(original, "gt", part="trajectory")
    assert poses.cloud is None and poses.trajectory is not None
    (original / "slam_poses.txt").write_text("no poses")
    cloud = read_original_side(original, "est", part="map")
    assert cloud.cloud is not None and cloud.trajectory is None


def test_stamps_beside_the_poses_of_an_original_directory_drop_none(original: Path) -> None:
    (original / "slam_poses_timestamps.txt").write_text("6\n5\n7\n")
    source = read_original_side(original, "est", pose_frame="optical")
    assert source.trajectory is not None and source.trajectory.pose_frame == "optical"
    assert source.trajectory.positions.tolist() == [[1, 0, 0], [2, 2, 2]]


def test_unequal_numbers_of_poses_are_refused_with_both(original: Path) -> None:
    (original / "slam_poses.txt").write_text("0 0 0 0 0 0\n")
    with pytest.raises(InputError, match=r"gt_poses.txt has 2 poses, slam_poses.txt has 1"):
        read_original_side(original, "gt")


def test_a_missing_file_of_an_original_directory_is_named(original: Path) -> None:
    (original / "gt_points.txt").unlink()
    with pytest.raises(InputError, match=r"missing: gt_points.txt"):
        read_original_side(original, "est")


def test_a_pcd_of_the_original_saver_inside_slam_points_txt_is_read(original: Path) -> None:
    header = "# .PCD v.5\nVERSION .5\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    data = "WIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n1.5 2 3\n4 5 6\n"
    (original / "slam_points.txt").write_text(header + data)
    cloud = read_original_side(original, "est", part="map").cloud
    assert cloud is not None and cloud.points.tolist() == [[1.5, 2, 3], [4, 5, 6]]
