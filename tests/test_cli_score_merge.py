"""`maomaps-warp score-merge`: a corridor whose runs are merged well, badly, or not at all."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from merge_samples import VOXEL, MergeCase, corridor, move, pose, write_case, write_matrices, write_points
from scipy.spatial import cKDTree
from typer.testing import CliRunner, Result

from maomaps_warp.cli.app import app

#: Rounding of the maps' text files (12 digits), metres.
TEXT_M = 1e-9
#: Rounding of start poses and maps that `sample` writes in single precision, metres.
REAL_M = 1e-6


def run(case: MergeCase, *options: object, sources: bool = True) -> tuple[Result, dict[str, Any] | None]:
    output = case.folder.parent / "merge.json"
    output.unlink(missing_ok=True)
    words = [*(case.source_options if sources else []), *map(str, options)]
    result = CliRunner().invoke(app, ["score-merge", str(case.folder), "--json", str(output), *words])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result, json.loads(output.read_text()) if output.exists() else None


def scored(case: MergeCase, *options: object, sources: bool = True) -> dict[str, Any]:
    result, document = run(case, *options, sources=sources)
    assert result.exit_code == 0, result.stderr
    assert document is not None
    return document


def refused(case: MergeCase, *options: object, sources: bool = True) -> str:
    result, document = run(case, *options, sources=sources)
    assert result.exit_code == 2, (result.exit_code, result.stderr)
    assert document is None and result.stdout == ""
    (line,) = result.stderr.splitlines()
    return line


def transforms(case: MergeCase, matrices: list[np.ndarray | None]) -> Path:
    return write_matrices(case.folder.parent / "transforms.txt", matrices)


def write_planar(case: MergeCase, matrices: list[np.ndarray]) -> Path:
    """Lines `x y yaw` of transforms that turn about z."""
    path = case.folder.parent / "planar.txt"
    path.write_text("".join(f"{T[0, 3]:.15g} {T[1, 3]:.15g} {math.atan2(T[1, 0], T[0, 0]):.15g}\n" for T in matrices))
    return path


@pytest.fixture
def two(tmp_path: Path) -> MergeCase:
    return write_case(tmp_path)


@pytest.fixture
def three(tmp_path: Path) -> MergeCase:
    return write_case(tmp_path, runs=3)


def test_an_exact_merge_is_a_success_without_errors(two: MergeCase):
    document = scored(two, "--transforms", transforms(two, two.T_first_source))
    assert (document["kind"], document["schema"]) == ("merge score", 1)
    assert (document["pair"], document["method"], document["success"]) == ("sample7", two.folder.parent.name, True)
    ame = document["metrics"]["ame"]
    assert ame["max"] < TEXT_M and ame["completeness"]["max"] < TEXT_M
    assert ame["count"] == sum(map(len, two.worlds)) == ame["counts"]["est_points"]
    first, second = document["sources"]
    assert first["reference"] and first["success"] and first["transform_error"]["value"] is None
    assert second["transform_error"]["translation_m"] < TEXT_M and second["transform_error"]["rotation_rad"] < TEXT_M
    for source in (first, second):
        assert source["ame_alone"]["max"] < TEXT_M and source["ame_merged"]["max"] < TEXT_M
    assert ame["doubled_walls"]["value"] == 0.0
    assert not [note for note in document["notes"] if "worse" in note]


def test_a_shifted_and_turned_source_has_exactly_these_errors(two: MergeCase):
    wrong = pose(0.3, 0.0, 0.0, math.radians(5.0))
    document = scored(two, "--transforms", transforms(two, [np.eye(4), two.T_first_source[1] @ wrong]))
    error = document["sources"][1]["transform_error"]
    assert error["translation_m"] == pytest.approx(0.3, abs=TEXT_M)
    assert math.degrees(error["rotation_rad"]) == pytest.approx(5.0, abs=1e-7)
    assert document["success"] is True
    # Independent: the points where they now lie, and a tree.
    second = np.loadtxt(two.sources[1])
    points = np.concatenate([two.worlds[0], move(two.T_world_source[1] @ wrong, second)])
    distance = cKDTree(two.merged).query(points)[0]
    ame = document["metrics"]["ame"]
    assert ame["value"] == pytest.approx(distance.mean(), abs=1e-8)
    assert ame["rmse"] == pytest.approx(math.sqrt((distance**2).mean()), abs=1e-8)
    in_own = cKDTree(two.worlds[1]).query(move(two.T_world_source[1] @ wrong, second))[0]
    assert document["sources"][1]["ame_merged"]["value"] == pytest.approx(in_own.mean(), abs=1e-8)
    assert document["sources"][1]["ame_alone"]["max"] < TEXT_M


@pytest.mark.parametrize(("limit", "success"), [(("--success-m", 0.29), False), (("--success-m", 0.31), True)])
def test_the_limits_of_a_success_can_be_stated(two: MergeCase, limit: tuple[str, float], success: bool):
    wrong = pose(0.3, 0.0, 0.0, 0.0)
    document = scored(two, "--transforms", transforms(two, [np.eye(4), two.T_first_source[1] @ wrong]), *limit)
    assert document["success"] is success and document["sources"][1]["success"] is success
    assert document["success_rule"]["max_m"] == limit[1]


def test_a_merge_that_shifts_a_source_doubles_its_walls(two: MergeCase):
    T = np.linalg.inv(two.T_world_source[0]) @ pose(0.0, 0.3, 0.0, 0.0) @ two.T_world_source[1]
    document = scored(two, "--transforms", transforms(two, [np.eye(4), T]))
    doubled = document["metrics"]["ame"]["doubled_walls"]
    assert doubled["value"] == doubled["doubled"] / doubled["decided"] > 0.2
    total = sum(doubled[name] for name in ("decided", "undecided", "gt_has_more", "gt_has_none"))
    assert total == doubled["in_overlap"]


def test_three_maps_of_which_one_was_not_merged(three: MergeCase):
    T = three.T_first_source
    result, document = run(three, "--transforms", transforms(three, [T[0], None, T[2]]))
    assert result.exit_code == 0 and document is not None
    assert document["success"] is False and "second was not merged" in document["verdict"]
    second, third = document["sources"][1:]
    assert second["merged"] is False and second["ame_merged"]["value"] is None and second["success"] is False
    assert second["ame_alone"]["max"] < TEXT_M
    assert third["success"] is True and third["transform_error"]["translation_m"] < TEXT_M
    assert document["merged_map"] == "union of 2 of 3 sources"
    assert document["metrics"]["ame"]["max"] < TEXT_M < document["metrics"]["ame"]["completeness"]["max"]


def test_three_maps_merged_well(three: MergeCase):
    document = scored(three, "--transforms", transforms(three, three.T_first_source))
    assert document["success"] is True and len(document["sources"]) == 3
    assert document["metrics"]["ame"]["completeness"]["max"] < TEXT_M


def test_the_reference_is_the_first_source_that_was_merged(three: MergeCase):
    T = np.linalg.inv(three.T_world_source[1])
    merged = [None, np.eye(4), T @ three.T_world_source[2]]
    document = scored(three, "--transforms", transforms(three, merged))
    assert [source["reference"] for source in document["sources"]] == [False, True, False]
    assert document["metrics"]["ame"]["max"] < TEXT_M


def test_a_merge_of_nothing_has_no_ame_and_is_printed_all_the_same(two: MergeCase):
    result, document = run(two, "--transforms", transforms(two, [np.eye(4), None]))
    assert result.exit_code == 3 and document is not None
    assert "not merged: second" in result.stderr
    assert "failed" in result.stdout
    assert document["success"] is False
    assert document["metrics"]["ame"]["value"] is None
    assert document["metrics"]["ame"]["reason"] == "not merged: second"
    assert document["sources"][0]["ame_alone"]["value"] is not None


def test_transforms_without_maps_give_errors_and_no_ame(two: MergeCase):
    result, document = run(two, "--transforms", transforms(two, two.T_first_source), sources=False)
    assert result.exit_code == 3 and "--source" in result.stderr
    assert document is not None and document["success"] is True


def test_transforms_of_the_plane_are_scored_in_the_plane(two: MergeCase):
    path = write_planar(two, [np.eye(4), pose(0.2, 0, 0, 0) @ two.T_first_source[1]])
    document = scored(two, "--transforms", path)
    error = document["sources"][1]["transform_error"]
    assert error["planar"] is True
    assert error["translation_m"] == pytest.approx(0.2, abs=TEXT_M)
    assert error["rotation_rad"] == pytest.approx(0.0, abs=TEXT_M)
    assert any("two-dimensional" in note for note in document["notes"])


def test_heights_of_planar_transforms_are_the_true_ones_under_every_alignment(two: MergeCase):
    start = two.folder / "start_pose_second.txt"
    x, y, _, yaw = start.read_text().split()
    # The second run begins half a metre higher: its own map then lies half a metre lower in its own frame.
    start.write_text(f"{x} {y} 0.9\n{yaw}\n")
    write_points(two.sources[1], np.loadtxt(two.sources[1]) - [0, 0, 0.5])
    for align, base in (("first", np.linalg.inv(two.T_world_source[0])), ("none", np.eye(4))):
        path = write_planar(two, [base @ T for T in two.T_world_source])
        document = scored(two, "--transforms", path, "--align", align)
        assert document["metrics"]["ame"]["max"] < TEXT_M, align


def test_a_merged_cloud_alone_is_taken_to_begin_at_the_first_start(two: MergeCase):
    cloud = move(np.linalg.inv(two.T_world_source[0]), two.merged)
    path = write_points(two.folder.parent / "map_merge_3d.xyz", cloud)
    document = scored(two, "--merged", path, sources=False)
    assert document["metrics"]["ame"]["max"] < TEXT_M
    assert document["success"] is None and "--success-ame" in document["verdict"]
    assert document["method"] == "map_merge_3d"
    assert [source["transform_error"]["value"] for source in document["sources"]] == [None, None]
    judged = scored(two, "--merged", path, "--success-ame", 0.1, sources=False)
    assert judged["success"] is True


def test_a_merged_cloud_in_the_world_is_scored_where_it_lies(two: MergeCase):
    path = write_points(two.folder.parent / "merged.xyz", two.merged + [0.1, 0, 0])
    document = scored(two, "--merged", path, "--align", "none", sources=False)
    wanted = cKDTree(two.merged).query(two.merged + [0.1, 0, 0])[0].mean()
    assert document["metrics"]["ame"]["value"] == pytest.approx(wanted, abs=TEXT_M)


def test_a_merged_cloud_is_scored_instead_of_the_union(two: MergeCase):
    path = write_points(two.folder.parent / "merged.xyz", move(np.linalg.inv(two.T_world_source[0]), two.merged[:500]))
    document = scored(two, "--merged", path, "--transforms", transforms(two, two.T_first_source))
    assert document["metrics"]["ame"]["count"] == 500 and document["merged_map"] == str(path)
    assert document["success"] is True


def test_the_best_alignment_prints_what_it_hides(two: MergeCase):
    pytest.importorskip("small_gicp")
    wrong = np.linalg.inv(two.T_world_source[0]) @ pose(0.2, 0.1, 0.05, 0.02)
    path = write_points(two.folder.parent / "merged.xyz", move(wrong, two.merged))
    result, document = run(two, "--merged", path, "--align", "best", sources=False)
    assert result.exit_code == 0 and document is not None
    fit = document["alignment"]["fit"]
    assert fit["ame_before"] > 0.05 > 0.001 > fit["ame_after"]
    assert fit["hidden"] == fit["ame_before"] - fit["ame_after"]
    assert f"the alignment hides {fit['hidden']:.4f} m" in result.stdout
    assert document["metrics"]["ame"]["value"] == pytest.approx(fit["ame_after"])


def test_a_merge_worse_than_none_is_told(two: MergeCase):
    T = two.T_first_source[1] @ pose(4.0, 2.0, 1.0, 2.0)
    document = scored(two, "--transforms", transforms(two, [np.eye(4), T]))
    apart = document["without_merge"]
    assert document["metrics"]["ame"]["value"] > apart["unmoved"] > apart["sources_mean"]
    unmoved = move(two.T_world_source[0], np.concatenate([np.loadtxt(path) for path in two.sources]))
    assert apart["unmoved"] == pytest.approx(cKDTree(two.merged).query(unmoved)[0].mean(), abs=1e-8)
    notes = " ".join(document["notes"])
    assert "worse than the sources apart" in notes and "worse than none" in notes


def test_maps_that_do_not_overlap_are_scored_outside_alone(tmp_path: Path):
    case = write_case(tmp_path, [corridor(0, 30), corridor(60, 100)])
    document = scored(case, "--transforms", transforms(case, case.T_first_source))
    ame = document["metrics"]["ame"]
    assert ame["inside_overlap"]["value"] is None and "do not overlap" in ame["inside_overlap"]["reason"]
    assert ame["doubled_walls"]["value"] is None and ame["outside_overlap"]["max"] < TEXT_M
    assert any("do not overlap" in note for note in document["notes"])


def test_a_yaw_correction_turns_the_truth(two: MergeCase):
    for name in ("first", "second"):
        path = two.folder / f"start_pose_{name}.txt"
        position, yaw = path.read_text().splitlines()
        path.write_text(f"{position}\n{float(yaw) + 0.45!r}\n")
    off = scored(two, "--transforms", transforms(two, two.T_first_source))
    mended = scored(two, "--transforms", transforms(two, two.T_first_source), "--yaw-correction", "sample1")
    assert off["metrics"]["ame"]["value"] > 0.1
    assert mended["metrics"]["ame"]["max"] < TEXT_M


def test_true_placements_may_come_from_a_file(two: MergeCase):
    (two.folder / "start_pose_second.txt").write_text("9 9 9\n0\n")
    truth = write_matrices(two.folder.parent / "truth.txt", two.T_world_source)
    document = scored(two, "--transforms", transforms(two, two.T_first_source), "--gt-transforms", truth)
    assert document["success"] is True and document["metrics"]["ame"]["max"] < TEXT_M


# Occupancy grids


def write_grid(case: MergeCase, T_grid_world: np.ndarray) -> Path:
    """The projection of the merged truth as a map_server pair, by plain means; its frame is T_grid_world's."""
    is_obstacle = (case.merged[:, 2] > 0.1) & (case.merged[:, 2] < 1.5)
    ij = np.round(case.merged[:, :2] / VOXEL).astype(int)
    low, size = ij.min(axis=0), np.ptp(ij, axis=0) + 1
    image = np.full((size[1], size[0]), 254, dtype=np.uint8)
    image[tuple((ij - low)[is_obstacle][:, ::-1].T)] = 0
    (case.folder.parent / "grid.pgm").write_bytes(b"P5\n%d %d\n255\n" % tuple(size) + image[::-1].tobytes())
    corner = T_grid_world[:2, :2] @ ((low - 0.5) * VOXEL) + T_grid_world[:2, 3]
    yaw = math.atan2(T_grid_world[1, 0], T_grid_world[0, 0])
    path = case.folder.parent / "grid.yaml"
    path.write_text(
        f"image: grid.pgm\nresolution: {VOXEL}\norigin: [{corner[0]:.12f}, {corner[1]:.12f}, {yaw:.12f}]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path


def test_a_merged_occupancy_grid_has_a_2d_ame(two: MergeCase):
    in_world = scored(two, "--merged", write_grid(two, np.eye(4)), "--align", "none", sources=False)
    in_first = scored(two, "--merged", write_grid(two, np.linalg.inv(two.T_world_source[0])), sources=False)
    for document in (in_world, in_first):
        assert document["metrics"]["ame"]["value"] is None
        assert document["metrics"]["ame_2d"]["max"] < 1e-6
    shifted = scored(two, "--merged", write_grid(two, pose(0, 0.4, 0, 0)), "--align", "none", sources=False)
    assert shifted["metrics"]["ame_2d"]["value"] > 0.05


def test_an_occupancy_grid_alone_is_not_fitted(two: MergeCase):
    assert "--align first" in refused(two, "--merged", write_grid(two, np.eye(4)), "--align", "best", sources=False)


# Real input


@pytest.mark.slow
def test_the_maps_of_two_real_runs_are_scored_as_they_were_placed(tmp_path: Path):
    from tum_sample import write_sample_bags

    bags = write_sample_bags(tmp_path)
    folder = tmp_path / "sample1"
    words = ["sample", *map(str, bags.values()), "-o", str(folder), "--bags", "none", "--pose-frame", "optical"]
    made = CliRunner().invoke(app, words)
    assert made.exit_code == 0, made.output
    worlds, T, sources = [], [], []
    for name in ("first", "second"):
        x, y, z, yaw = map(float, (folder / f"start_pose_{name}.txt").read_text().split())
        T.append(pose(x, y, z, yaw + math.pi))
        worlds.append(np.loadtxt(folder / f"gt_points_{name}.txt"))
        sources.append(write_points(tmp_path / f"map_{name}.xyz", move(np.linalg.inv(T[-1]), worlds[-1])))
    case = MergeCase(folder, tuple(worlds), np.loadtxt(folder / "gt_points_merged.txt"), tuple(sources), tuple(T))
    exact = scored(case, "--transforms", transforms(case, case.T_first_source))
    assert exact["success"] is True and exact["metrics"]["ame"]["max"] < REAL_M
    assert exact["metrics"]["ame"]["doubled_walls"]["doubled"] == 0
    wrong = pose(0.1, 0.0, 0.0, math.radians(2.0))
    off = scored(case, "--transforms", transforms(case, [np.eye(4), case.T_first_source[1] @ wrong]))
    error = off["sources"][1]["transform_error"]
    assert error["translation_m"] == pytest.approx(0.1, abs=REAL_M)
    assert math.degrees(error["rotation_rad"]) == pytest.approx(2.0, abs=1e-6)
    points = np.concatenate([worlds[0], move(T[1] @ wrong @ np.linalg.inv(T[1]), worlds[1])])
    assert off["metrics"]["ame"]["value"] == pytest.approx(cKDTree(case.merged).query(points)[0].mean(), abs=REAL_M)
    assert off["metrics"]["ame"]["doubled_walls"]["value"] > 0.05


# What is refused


def test_bad_input_is_refused_in_one_line(two: MergeCase, tmp_path: Path):
    good = transforms(two, two.T_first_source)
    one = write_matrices(tmp_path / "one.txt", [np.eye(4)])
    zero = write_matrices(tmp_path / "zero.txt", [np.eye(4), None])
    merged = ["--transforms", good]
    assert "no merge was given" in refused(two)
    assert "holds 1 transforms" in refused(two, "--transforms", one)
    assert "1 given for the 2 runs" in refused(two, *merged, "--source", two.sources[0], sources=False)
    assert "matrix of zeros" in refused(two, *merged, "--gt-transforms", zero)
    assert "no effect" in refused(two, *merged, "--gt-transforms", good, "--yaw-correction", "0.1")
    assert "--wall-distance 0.1" in refused(two, *merged, "--wall-distance", 0.1)
    assert "--success-deg" in refused(two, *merged, "--success-deg", -1)
    assert "--ground steep" in refused(two, *merged, "--ground", "steep")
    assert "is an input" in refused(two, *merged, "--json", good)
    assert "no such file" in refused(two, *merged, "--merged", tmp_path / "absent.pcd")
    assert "poses" in refused(two, *merged, "--merged", write_poses(tmp_path))
    assert "sideways" in refused(two, *merged, "--align", "sideways")


def write_poses(folder: Path) -> Path:
    path = folder / "poses.txt"
    path.write_text("".join(f"{i}.5 0 0 {i} 0 0 0 1\n" for i in range(5)))
    return path


@pytest.mark.parametrize("name", ["gt_points_merged.txt", "gt_points_second.txt", "start_pose_first.txt"])
def test_a_sample_with_a_file_missing_is_refused_with_its_name(two: MergeCase, name: str):
    (two.folder / name).unlink()
    if name == "gt_points_second.txt":  # the run is still there by its poses
        (two.folder / "gt_poses_second.txt").write_text("0 0 0 0 0 0\n")
    line = refused(two, "--transforms", transforms(two, two.T_first_source))
    assert name.removesuffix(".txt") in line


def test_one_run_is_no_merge(two: MergeCase):
    (two.folder / "gt_points_second.txt").unlink()
    assert "holds the run first alone" in refused(two, "--transforms", transforms(two, two.T_first_source))
    result = CliRunner().invoke(app, ["score-merge", str(two.folder.parent), "--merged", str(two.sources[0])])
    assert result.exit_code == 2 and "no MAOMaps sample directory" in result.stderr
