"""`maomaps-warp sample` on the real TUM recording, split into two overlapping runs as bags."""

from __future__ import annotations

import csv
import io
import json
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import bags
import numpy as np
import pytest
import tum_sample
from typer.testing import CliRunner, Result

from maomaps_warp.cli.app import app
from maomaps_warp.io.sample_directories import runs_of

#: Metres and seconds: poses pass through text with all digits; sums of some hundred steps.
SUM_TOLERANCE = 1e-9
#: Radians: an angle near zero is the arc cosine or sine of float64 rounding.
ANGLE_TOLERANCE = 1e-7
#: Of the real recording: the convention is declared, for proving it is another test's matter.
DECLARED = ("--pose-frame", "optical", "--device", "cpu")
VOXEL = 0.05
#: Metres: where the floor of the real map is, for projections that NumPy can repeat.
GROUND = 0.05


@pytest.fixture(scope="module")
def frames() -> tum_sample.TumFrames:
    return tum_sample.read_tum()


@pytest.fixture(scope="module")
def recordings(frames: tum_sample.TumFrames, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    return {run: tum_sample.write_run(folder / f"{run}_run.bag", "ros1", frames, run) for run in tum_sample.RUNS}


@pytest.fixture(scope="module")
def made(recordings: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    folder = tmp_path_factory.mktemp("dataset") / "sample1"
    result = run("sample", *recordings.values(), "-o", folder, *DECLARED, "--ground", GROUND)
    assert result.exit_code == 0, result.stderr
    return folder, result


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def _cells(folder: Path, name: str) -> dict[tuple[int, ...], tuple[int, ...]]:
    """World cells of a map with their colours, as the original's readers take them."""
    cells = np.rint(np.loadtxt(folder / f"gt_points_{name}.txt") / VOXEL).astype(int)
    colors = np.loadtxt(folder / f"gt_colors_{name}.txt", dtype=int)
    return dict(zip(map(tuple, cells.tolist()), map(tuple, colors.tolist()), strict=True))


def _columns(cells: dict, low: float, high: float) -> set[tuple[int, int]]:
    """Columns with a voxel more than `low` and at most `high` above the ground."""
    return {(i, j) for i, j, k in cells if low < round(k * VOXEL - GROUND, 6) <= high}


def test_the_sample_directory_holds_every_file_of_the_layout(made, recordings) -> None:
    folder, result = made
    names = {f"gt_points_{run}.{kind}" for run in ("first", "second", "merged") for kind in ("pcd", "txt")}
    names |= {f"gt_colors_{run}.txt" for run in ("first", "second", "merged")}
    for run_name in ("first", "second"):
        names |= {f"gt_poses_{run_name}.txt", f"gt_poses_{run_name}_timestamps.txt", f"{run_name}.bag"}
        names |= {f"start_pose_{run_name}.txt", f"goal_pose_{run_name}.txt"}
        assert (folder / f"{run_name}.bag").read_bytes() == recordings[run_name].read_bytes()
    assert {path.name for path in folder.iterdir()} == names
    assert f"wrote {len(names)} files to {folder}" in result.stdout


def test_the_merged_map_is_the_union_voxel_for_voxel(made) -> None:
    folder, _ = made
    first, second, merged = (_cells(folder, name) for name in ("first", "second", "merged"))
    assert set(merged) == set(first) | set(second)
    assert len(set(first) & set(second)) > 10_000
    for cell, color in merged.items():
        sources = [cells[cell] for cells in (first, second) if cell in cells]
        assert all(min(c) <= mean <= max(c) for *c, mean in zip(*sources, color, strict=True))


def test_the_ious_are_those_that_plain_sets_give(made) -> None:
    folder, result = made
    maps = [_cells(folder, name) for name in ("first", "second")]
    known = [_columns(cells, -0.1000001, 1.4999) for cells in maps]
    obstacles = [_columns(cells, 0.1, 1.4999) for cells in maps]
    for title, sets in (("2D known", known), ("2D obstacle", obstacles), ("3D voxels", [set(c) for c in maps])):
        common, either = len(sets[0] & sets[1]), len(sets[0] | sets[1])
        (line,) = [line for line in result.stdout.splitlines() if line.startswith(f"IoU {title}")]
        assert f" {common / either:.3f} " in line and f"{common} of {either} " in line


def test_describe_prints_the_row_that_sample_printed(made) -> None:
    folder, result = made
    described = run("describe", folder.parent, "--ground", GROUND)
    assert described.exit_code == 0 and not described.stderr
    (row,) = [line for line in described.stdout.splitlines() if line.lstrip().startswith("sample1 ")]
    assert row in result.stdout.splitlines()
    (figures,) = csv.DictReader(io.StringIO(run("describe", folder, "--format", "csv").stdout, newline=""))
    for name in ("first", "second"):
        positions = np.loadtxt(folder / f"gt_poses_{name}.txt")[:, :3]
        length = sum(np.linalg.norm(b - a) for a, b in pairwise(positions))
        stamps = [int(line.replace(".", "")) for line in (folder / f"gt_poses_{name}_timestamps.txt").open()]
        assert float(figures[f"path_length_{name}_m"]) == pytest.approx(length, abs=SUM_TOLERANCE)
        assert float(figures[f"duration_{name}_s"]) == pytest.approx((stamps[-1] - stamps[0]) / 1e9, abs=SUM_TOLERANCE)


def test_each_run_is_what_map_makes_of_its_bag(made, recordings, tmp_path: Path) -> None:
    folder, _ = made
    assert run("map", recordings["second"], "-o", tmp_path / "one", "--run", "second", *DECLARED).exit_code == 0
    alone = {path.name: path.read_bytes() for path in (tmp_path / "one").iterdir()}
    assert len(alone) == 7
    assert all((folder / name).read_bytes() == content for name, content in alone.items())


def test_a_score_finds_the_poses_of_the_bag_in_its_run_of_the_sample(made, tmp_path: Path) -> None:
    folder, _ = made
    gt, est = ("--gt-trajectory", folder, "--run", "second"), ("--est-trajectory", folder / "second.bag")
    result = run("score", *gt, *est, "--est-pose-frame", "optical", "--json", tmp_path / "score.json")
    assert result.exit_code == 0, result.stderr
    ate = json.loads((tmp_path / "score.json").read_text())["metrics"]["ate"]
    assert ate["max"] == pytest.approx(0.0, abs=SUM_TOLERANCE)
    assert ate["rotation_rad"]["max"] == pytest.approx(0.0, abs=ANGLE_TOLERANCE)
    assert ate["counts"]["unmatched"] == 0


def test_three_runs_make_a_sample_and_the_bags_may_be_links_or_stay_away(recordings, tmp_path: Path) -> None:
    three = [recordings["first"], recordings["second"], recordings["first"]]
    coarse = ("--voxel-size", "0.2", "--stride", "4", *DECLARED)
    for mode in ("link", "none"):
        folder = tmp_path / mode
        result = run("sample", *three, "-o", folder, "--bags", mode, *coarse)
        assert result.exit_code == 0, result.stderr
        assert runs_of(folder) == ("first", "second", "third")
        assert (folder / "third.bag").is_symlink() == (mode == "link")
        assert (folder / "gt_points_third.txt").read_bytes() == (folder / "gt_points_first.txt").read_bytes()
        assert "3rd path" in " ".join(result.stdout.split())
    described = run("describe", tmp_path / "link", "--voxel-size", "0.2", "--format", "csv")
    (row,) = csv.DictReader(io.StringIO(described.stdout, newline=""))
    assert row["path_length_third_m"] == row["path_length_first_m"]
    # The third run is the first once more: what only the second saw is all that one run alone saw.
    first, merged = (
        len((tmp_path / "link" / f"gt_points_{n}.txt").read_text().splitlines()) for n in ("first", "merged")
    )
    assert float(row["iou_3d_voxels"]) == pytest.approx(first / merged, abs=SUM_TOLERANCE)


def test_a_ros2_folder_lies_in_the_sample_as_a_folder_that_opens(frames, tmp_path: Path, monkeypatch) -> None:
    short = replace(frames, stamps_ns=frames.stamps_ns[::5], depth=frames.depth[::5], colors=frames.colors[::5])
    few = {"first": (0, 12), "second": (8, 20)}
    monkeypatch.setattr(tum_sample, "RUNS", few)
    recordings = {run: tum_sample.write_run(tmp_path / f"the {run}", "ros2-sqlite3", short, run) for run in few}
    coarse = ("--voxel-size", "0.2", "--stride", "4", *DECLARED)
    result = run("sample", *recordings.values(), "-o", tmp_path / "sample", *coarse)
    assert result.exit_code == 0, result.stderr
    assert (tmp_path / "sample" / "first" / "metadata.yaml").is_file()
    again = run("map", tmp_path / "sample" / "first", "-o", tmp_path / "again", *coarse)
    assert again.exit_code == 0, again.stderr
    points = "gt_points_first.txt"
    assert (tmp_path / "again" / points).read_bytes() == (tmp_path / "sample" / points).read_bytes()


def test_bags_in_their_own_sample_directory_get_their_maps_beside_them(recordings, tmp_path: Path) -> None:
    for name, path in recordings.items():
        shutil.copy(path, tmp_path / f"{name}.bag")
    paths = [tmp_path / "first.bag", tmp_path / "second.bag"]
    coarse = ("--voxel-size", "0.2", "--stride", "4", *DECLARED)
    for again in ((), ("--overwrite",)):
        assert run("sample", *paths, "-o", tmp_path, *coarse, *again).exit_code == 0
        assert paths[0].read_bytes() == recordings["first"].read_bytes()
    refused = run("sample", *paths, "-o", tmp_path, *coarse)
    assert refused.exit_code == 2 and "--overwrite" in refused.stderr


def test_maps_that_do_not_overlap_are_written_with_an_iou_of_zero_and_a_note(
    frames, recordings, tmp_path: Path
) -> None:
    moved = frames.T_world_camera.copy()
    moved[:, 0, 3] += 50.0
    far = tum_sample.write_run(tmp_path / "far.bag", "ros1", replace(frames, T_world_camera=moved), "second")
    coarse = ("--voxel-size", "0.2", "--stride", "4", *DECLARED)
    result = run("sample", recordings["first"], far, "-o", tmp_path / "sample", *coarse)
    assert result.exit_code == 0, result.stderr
    assert "do not overlap" in result.stdout
    assert "IoU 3D voxels    0.000  0 of " in result.stdout
    assert (tmp_path / "sample" / "gt_points_merged.txt").is_file()


# Bad input: nothing is written, and one line says why


@pytest.fixture
def damaged(recordings, tmp_path: Path) -> Path:
    path = tmp_path / "cut.bag"
    path.write_bytes(recordings["second"].read_bytes()[:200_000])
    return path


def _assert_refused(result: Result, folder: Path, before: set[str], words: str) -> None:
    assert result.exit_code == 2 and result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert words in line
    assert {path.name for path in folder.iterdir()} == before


def test_a_bag_without_depth_or_a_damaged_one_leaves_nothing_behind(
    frames, recordings, damaged, tmp_path: Path
) -> None:
    stamps = frames.pose_stamps_ns.tolist()
    poses = bags.pose_messages("ros1", "/pose", stamps, frames.T_world_camera)
    bags.write_bag(tmp_path / "poses.bag", "ros1", poses)
    before = {path.name for path in tmp_path.iterdir()}
    for second, words in (
        (tmp_path / "poses.bag", "no depth images"),
        (damaged, "cut.bag"),
        (tmp_path / "x", "no such"),
    ):
        result = run("sample", recordings["first"], second, "-o", tmp_path / "sample", *DECLARED)
        _assert_refused(result, tmp_path, before, words)


def test_a_run_that_cannot_be_mapped_leaves_no_sample_of_the_others(recordings, tmp_path: Path) -> None:
    result = run("sample", *recordings.values(), "-o", tmp_path / "s", *DECLARED, "--min-range", 50, "--max-range", 60)
    _assert_refused(result, tmp_path, set(), "not one of")


def test_the_number_of_recordings_and_the_options_are_checked_first(recordings, tmp_path: Path) -> None:
    bag = recordings["first"]
    cases = (
        ((bag,), (), "only one given"),
        ((bag,) * 11, (), "2 to 10 runs"),
        ((bag, bag), ("--ground", "floor"), "--ground floor"),
        ((bag, bag), ("--bags", "move"), "--bags"),
        ((bag, bag), ("--voxel-size", "-1"), "--voxel-size"),
        ((bag, bag), ("--device", "tpu"), "--device tpu"),
    )
    for given, options, words in cases:
        _assert_refused(run("sample", *given, "-o", tmp_path / "sample", *options), tmp_path, set(), words)


def test_an_output_that_is_a_file_or_holds_a_sample_is_refused_before_the_work(damaged: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "gt_points_third.txt").write_text("0 0 0\n")
    before = {path.name for path in tmp_path.iterdir()}
    bags.write_bag(tmp_path / "ros2", "ros2-sqlite3", bags.pose_messages("ros2-sqlite3", "/pose", [1], np.eye(4)[None]))
    before.add("ros2")
    cases = {"file": "is a file", "old": "gt_points_third.txt", "file/sample": "is a file", "ros2/sample": "is inside"}
    for output, words in cases.items():
        result = run("sample", tmp_path / "ros2", damaged, "-o", tmp_path / output, *DECLARED)
        _assert_refused(result, tmp_path, before, words)
    assert (tmp_path / "file").read_text() == "mine"
    assert len(list((tmp_path / "old").iterdir())) == 1
