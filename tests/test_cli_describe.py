"""`maomaps-warp describe`: Table II of samples with answers known by construction."""

from __future__ import annotations

import csv
import io
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scenes import camera_pose
from typer.testing import CliRunner, Result

from maomaps_warp.cli.app import app
from maomaps_warp.io.sample_writing import SamplePlace, SampleRun, write_sample
from maomaps_warp.mapping.cloud_map import voxelise
from maomaps_warp.mapping.merging import merge_maps
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap

#: Metres and seconds: sums of a few steps in float64.
SUM_TOLERANCE = 1e-9

#: By hand. Floors: 100 columns each, 50 in both, 150 in any. Obstacles, all above floor: 8 and 4 columns, 2 in both.
KNOWN_IOU, OBSTACLE_IOU, VOXEL_IOU = 50 / 150, 2 / 10, 52 / 160


def _cells(i: range, j: range, k: range) -> np.ndarray:
    return np.stack(np.meshgrid(i, j, k, indexing="ij"), axis=-1).reshape(-1, 3)


FLOORS = {"first": range(0, 10), "second": range(5, 15), "third": range(0, 5)}
OBSTACLES = {"first": ((2, range(3, 7)), (7, range(0, 4))), "second": ((7, range(2, 6)),), "third": ()}


def _map(run: str, shift: int = 0, voxel_size: float = 0.05) -> VoxelMap:
    parts = [_cells(FLOORS[run], range(0, 10), range(0, 1))]
    parts += [_cells(range(i, i + 1), j, range(10, 11)) for i, j in OBSTACLES[run]]
    points = (np.concatenate(parts) + [shift, 0, 0]) * voxel_size
    return voxelise(points, VoxelGrid.around(points, voxel_size), np.full(points.shape, 9, np.uint8))


def _trajectory(steps: int, step_ns: int) -> Trajectory:
    """Steps of 5 m: 3 along x and 4 along y."""
    T = np.stack([camera_pose((3.0 * i, 4.0 * i, 0.5), 0.2) for i in range(steps + 1)])
    return Trajectory(T, 10**18 + step_ns * np.arange(steps + 1, dtype=np.int64))


def _write(folder: Path, *runs: str, shift: int = 0, voxel_size: float = 0.05) -> Path:
    maps = {run: _map(run, shift * i, voxel_size) for i, run in enumerate(runs)}
    data = {run: SampleRun(maps[run], _trajectory(2 + i, 500_000_000)) for i, run in enumerate(runs)}
    write_sample(SamplePlace(folder, {}), data, merge_maps(list(maps.values())))
    return folder


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    for name in ("sample10", "sample2"):
        _write(tmp_path / "data" / name, "first", "second")
    return tmp_path / "data"


def describe(*arguments: object) -> Result:
    result = CliRunner().invoke(app, ["describe", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def _rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text, newline="")))


def test_the_figures_are_those_computed_by_hand(dataset: Path) -> None:
    result = describe(dataset, "--format", "csv", "--ground", "0")
    assert result.exit_code == 0, result.stderr
    rows = _rows(result.stdout)
    assert [row["sample"] for row in rows] == ["sample2", "sample10"]
    for row in rows:
        expected = {
            "path_length_first_m": 10.0,
            "path_length_second_m": 15.0,
            "duration_first_s": 1.0,
            "duration_second_s": 1.5,
            "iou_2d_known": KNOWN_IOU,
            "iou_2d_obstacle": OBSTACLE_IOU,
            "iou_3d_voxels": VOXEL_IOU,
        }
        assert {name: float(row[name]) for name in expected} == pytest.approx(expected, abs=SUM_TOLERANCE)
        assert (row["points_3d"], row["width_2d_cells"], row["height_2d_cells"]) == ("160", "15", "10")
        assert row["problems"] == ""


def test_the_text_shows_the_digits_of_the_paper_and_names_three_ious(dataset: Path) -> None:
    result = describe(dataset, "--ground", "0")
    lines = [line.split() for line in result.stdout.splitlines()]
    for name in ("sample2", "sample10"):
        assert [name, "10.0", "15.0", "1.0", "1.5", "0.333", "0.200", "0.325", "160", "15x10"] in lines
    for word in ("known", "obstacle", "voxels", "Points 3D", "Resolution"):
        assert word in result.stdout


def test_a_sample_directory_alone_is_a_dataset_of_one(dataset: Path, monkeypatch) -> None:
    alone = describe(dataset / "sample2", "--ground", "0", "--format", "csv").stdout
    assert [row["sample"] for row in _rows(alone)] == ["sample2"]
    monkeypatch.chdir(dataset / "sample2")
    assert describe(".", "--ground", "0", "--format", "csv").stdout == alone


def test_more_than_two_runs_have_further_columns(tmp_path: Path) -> None:
    _write(tmp_path / "a", "first", "second", "third")
    _write(tmp_path / "b", "first", "second")
    rows = _rows(describe(tmp_path, "--format", "csv", "--ground", "0").stdout)
    assert [float(rows[0][f"path_length_{run}_m"]) for run in ("first", "second", "third")] == pytest.approx(
        [10, 15, 20]
    )
    assert (rows[1]["path_length_third_m"], rows[1]["duration_third_s"]) == ("", "")
    # Seen by two or more over seen by any: the third floor covers the other half of the first.
    assert float(rows[0]["iou_2d_known"]) == pytest.approx(100 / 150, abs=SUM_TOLERANCE)
    assert float(rows[1]["iou_2d_known"]) == pytest.approx(KNOWN_IOU, abs=SUM_TOLERANCE)
    assert "3rd path" in describe(tmp_path, "--format", "latex", "--ground", "0").stdout


def test_csv_quotes_and_ends_lines_as_the_rfc_says(tmp_path: Path) -> None:
    _write(tmp_path / 'sample "a", b', "first", "second")
    output = tmp_path / "table.csv"
    describe(tmp_path, "--format", "csv", "--output", output)
    lines = output.read_bytes().split(b"\r\n")
    assert len(lines) == 3 and lines[-1] == b""
    assert lines[1].startswith(b'"sample ""a"", b",')
    assert b"\n" not in b"".join(lines)


def test_json_has_everything_with_units_and_versions(dataset: Path) -> None:
    document = json.loads(describe(dataset, "--format", "json", "--ground", "0").stdout)
    assert document["units"]["path_length"] == "m" and document["units"]["duration"] == "s"
    assert document["versions"]["maomaps-warp"] and document["voxel_size"] == 0.05 and document["ground"] == "0"
    sample = document["samples"][0]
    assert sample["iou"] == pytest.approx({"known_2d": KNOWN_IOU, "obstacle_2d": OBSTACLE_IOU, "voxels_3d": VOXEL_IOU})
    assert sample["overlap_counts"] == {
        "known_common": 50,
        "known_any": 150,
        "obstacle_common": 2,
        "obstacle_any": 10,
        "voxel_common": 52,
        "voxel_any": 160,
    }
    assert [run["poses"] for run in sample["runs"]] == [3, 4]
    assert [run["elements"] for run in sample["runs"]] == [108, 104]
    assert sample["size_2d"] == [15, 10] and sample["ground_z"] == 0.0


def test_latex_escapes_names_and_has_as_many_cells_in_each_row(tmp_path: Path) -> None:
    _write(tmp_path / "sample_1&2 50%", "first", "second")
    text = describe(tmp_path, "--format", "latex", "--ground", "0").stdout
    lines = text.splitlines()
    assert lines[0] == r"\begin{tabular}{l|r|r|r|r|r|r|r|r|r}" and lines[-1] == r"\end{tabular}"
    rows = [line for line in lines if line.endswith(r"\\")]
    assert [line.replace(r"\&", "").count("&") for line in rows] == [9, 9]
    assert rows[1].startswith(r"sample\_1\&2 50\% & 10.0 & 15.0 & ")


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="there is no pdflatex here")
def test_latex_compiles(dataset: Path, tmp_path: Path) -> None:
    table = describe(dataset, "--format", "latex", "--ground", "0").stdout
    document = rf"\documentclass{{article}}\begin{{document}}{table}\end{{document}}"
    (tmp_path / "table.tex").write_text(document)
    subprocess.run(["pdflatex", "-halt-on-error", "table.tex"], cwd=tmp_path, check=True, capture_output=True)


# Bad input


def test_a_missing_file_is_told_in_its_row_and_the_others_are_printed(dataset: Path) -> None:
    for name in ("gt_points_second.txt", "gt_points_second.pcd", "gt_poses_first_timestamps.txt"):
        (dataset / "sample2" / name).unlink()
    result = describe(dataset, "--format", "csv", "--ground", "0")
    assert result.exit_code == 3
    broken, whole = _rows(result.stdout)
    assert "missing: gt_points_second.txt or gt_points_second.pcd" in broken["problems"]
    assert "missing: gt_poses_first_timestamps.txt" in broken["problems"]
    assert broken["path_length_first_m"] == broken["iou_2d_known"] == ""
    assert float(broken["path_length_second_m"]) == pytest.approx(15.0, abs=SUM_TOLERANCE)
    assert broken["points_3d"] == "160"
    assert whole["problems"] == "" and float(whole["iou_2d_known"]) == pytest.approx(KNOWN_IOU, abs=SUM_TOLERANCE)
    (line,) = result.stderr.splitlines()
    assert "sample2" in line and "gt_points_second.txt" in line


@pytest.mark.parametrize("format", ["text", "latex", "json"])
def test_every_format_says_what_is_missing(dataset: Path, format: str) -> None:
    for suffix in ("txt", "pcd"):
        (dataset / "sample10" / f"gt_points_merged.{suffix}").unlink()
    result = describe(dataset, "--format", format, "--ground", "0")
    assert result.exit_code == 3
    assert "missing: gt_points_merged.txt or gt_points_merged.pcd" in result.stdout.replace("\n", " ")
    assert "sample2" in result.stdout


def test_a_damaged_file_is_told_with_its_line(dataset: Path) -> None:
    path = dataset / "sample2" / "gt_points_first.txt"
    lines = path.read_text().splitlines()
    lines[4] = "0.1 0.x 0"
    path.write_text("\n".join(lines))
    result = describe(dataset, "--format", "csv", "--ground", "0")
    assert result.exit_code == 3
    broken, whole = _rows(result.stdout)
    assert broken["problems"] == "gt_points_first.txt, line 5: '0.x' is not a number"
    assert float(broken["path_length_first_m"]) == pytest.approx(10.0, abs=SUM_TOLERANCE)
    assert broken["iou_2d_known"] == "" and whole["iou_2d_known"]


def test_an_outlier_that_makes_the_projection_too_large_is_a_problem_of_its_row(dataset: Path) -> None:
    for place, words in (
        ("3e4 3e4 0", "too many"),
        ("1e9 0 0", "map merged: point 162 at 1e+09 0 0 m is 1e+09 m away"),
    ):
        with (dataset / "sample2" / "gt_points_merged.txt").open("a") as file:
            file.write(f"{place}\n")
        (dataset / "sample2" / "gt_colors_merged.txt").unlink(missing_ok=True)
        result = describe(dataset, "--format", "csv", "--ground", "0")
        assert result.exit_code == 3
        broken, whole = _rows(result.stdout)
        assert words in broken["problems"]
        assert float(broken["path_length_first_m"]) == pytest.approx(10.0, abs=SUM_TOLERANCE)
        assert whole["problems"] == ""


def test_maps_of_another_voxel_size_are_noted(tmp_path: Path) -> None:
    _write(tmp_path / "coarse", "first", "second", voxel_size=0.1)
    _write(tmp_path / "fine", "first", "second", voxel_size=0.03)
    text = describe(tmp_path, "--ground", "0").stdout
    assert "coarse: map first: its points lie 0.1 m apart" in text
    assert "fine: map first: " in text and "are no multiples of 0.05 m" in text
    right = describe(tmp_path / "coarse", "--ground", "0", "--voxel-size", "0.1")
    assert "note" not in right.stdout and "15x10" in right.stdout


def test_maps_that_do_not_overlap_have_an_iou_of_zero_and_a_note(tmp_path: Path) -> None:
    _write(tmp_path / "apart", "first", "second", shift=100)
    result = describe(tmp_path, "--ground", "0")
    assert result.exit_code == 0
    assert result.stdout.split().count("0.000") == 3
    assert "do not overlap" in result.stdout


def test_a_merged_map_that_is_not_the_union_is_noted(dataset: Path) -> None:
    for suffix in ("txt", "pcd"):
        shutil.copy(dataset / f"sample2/gt_points_first.{suffix}", dataset / f"sample2/gt_points_merged.{suffix}")
    shutil.copy(dataset / "sample2/gt_colors_first.txt", dataset / "sample2/gt_colors_merged.txt")
    result = describe(dataset, "--ground", "0")
    assert "sample2: the merged map holds 108 elements, the maps of the runs together 160 voxels" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("absent",), "no such folder"),
        (("empty",), "holds no sample directory"),
        (("empty/file",), "is a file"),
        (("data", "--ground", "floor"), "--ground floor"),
        (("data", "--voxel-size", "0"), "--voxel-size 0"),
        (("data", "--voxel-size", "nan"), "--voxel-size nan"),
        (("data", "--format", "xml"), "--format"),
        (("data", "--output", "absent/table.csv"), "no folder"),
        (("data", "--output", "empty/file"), "--overwrite"),
        (("data", "--output", "data/sample2/gt_points_first.txt", "--overwrite"), "is an input"),
        (("data/sample2", "--output", "data/sample2/start_pose_first.txt", "--overwrite"), "is an input"),
    ],
)
def test_what_cannot_be_described_is_refused_in_one_line(dataset: Path, arguments, words, monkeypatch) -> None:
    monkeypatch.chdir(dataset.parent)
    Path("empty").mkdir()
    Path("empty/file").write_text("mine")
    result = describe(*arguments)
    assert result.exit_code == 2 and result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert words in line
    assert Path("empty/file").read_text() == "mine" and len(list(Path("empty").iterdir())) == 1


def test_an_output_file_holds_what_would_be_printed(dataset: Path, tmp_path: Path) -> None:
    for format in ("csv", "latex", "json"):
        output = tmp_path / f"table.{format}"
        assert describe(dataset, "--format", format, "--output", output).stdout == ""
        assert output.read_bytes() == describe(dataset, "--format", format).stdout_bytes
        assert describe(dataset, "--format", format, "--output", output, "--overwrite").exit_code == 0
    assert describe(dataset, "--output", tmp_path / "table.txt").exit_code == 0
    assert "sample10" in (tmp_path / "table.txt").read_text()


def test_folders_that_are_no_samples_are_named(dataset: Path) -> None:
    (dataset / "figures").mkdir()
    assert "no sample directories: figures" in describe(dataset).stdout
