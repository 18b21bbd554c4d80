"""`maomaps-warp merge`: files, refusals, and what score-merge makes of them."""

from __future__ import annotations

import builtins
import json
import math
import shutil

import numpy as np
import pytest
from merging_scenes import VOXEL, difference, flat, on_lattice, pose, seen_from
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.io.clouds import read_cloud
from maomaps_warp.io.pcd import write_pcd
from maomaps_warp.io.transforms import read_transforms

#: Metres; float32 in the PCD of a map of 10 m.
FLOAT32_ROUNDING = 2e-6
DEGREES, METRES = 1.0, 1.5 * VOXEL
#: x, y, z and heading of the three runs; the files hold heading - pi.
STARTS = ((0.5, 1.0, 0.4, 0.3), (4.0, 1.0, 0.2, 2.0), (6.0, -1.0, 0.3, -1.1))
RUNS = ("first", "second", "third")


def run(*words):
    result = CliRunner().invoke(app, ["merge", *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def refused(result, *words):
    assert result.exit_code == 2, result.stderr
    (line,) = result.stderr.splitlines()
    for word in words:
        assert word in line
    assert result.stdout == ""


def options(paths):
    return [word for path in paths for word in ("--source", path)]


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Three overlapping parts of a flat from west to east, each in the frame of its start, and the start poses."""
    folder = tmp_path_factory.mktemp("merge")
    _, points = flat(0)
    low, high = points[:, 0].min(), points[:, 0].max()
    third = (high - low) / 3
    sample, paths, poses = folder / "sample", [], []
    sample.mkdir()
    for number, (name, (x, y, z, heading)) in enumerate(zip(RUNS, STARTS, strict=True)):
        west, east = low + number * third - 1.0, low + (number + 1) * third + 1.0
        part = points[(points[:, 0] > west) & (points[:, 0] < east)]
        T = pose((math.degrees(heading), 0.0, 0.0), (x, y, z))
        path = folder / f"{name}.pcd"
        own = seen_from(T, part)
        write_pcd(path, own, np.full((len(own), 3), 60 * number + 10, np.uint8))
        (sample / f"start_pose_{name}.txt").write_text(f"{x} {y} {z}\n{heading - math.pi!r}\n")
        paths.append(path)
        poses.append(T)
    return sample, paths, [np.linalg.inv(poses[0]) @ T for T in poses]


def test_start_poses_give_exact_transforms_and_the_union_with_colours(case, tmp_path):
    sample, paths, expected = case
    out, document = tmp_path / "out", tmp_path / "merge.json"
    result = run("--method", "start-poses", "--sample", sample, *options(paths), "-o", out, "--json", document)
    assert result.exit_code == 0, result.stderr
    written = read_transforms(out / "transforms.txt").T_merged_source
    clouds = [read_cloud(path) for path in paths]
    for T, wanted in zip(written, expected, strict=True):
        np.testing.assert_allclose(T, wanted, rtol=0, atol=1e-12)
    merged = read_cloud(out / "merged.pcd")
    points = np.concatenate([c.points @ T[:3, :3].T + T[:3, 3] for c, T in zip(clouds, expected, strict=True)])
    np.testing.assert_allclose(merged.points, points, rtol=0, atol=FLOAT32_ROUNDING)
    np.testing.assert_array_equal(merged.colors, np.concatenate([cloud.colors for cloud in clouds]))
    content = json.loads(document.read_text())
    assert content["method"] == "start-poses" and [s["confidence"] for s in content["sources"]] == [None] * 3
    np.testing.assert_allclose(content["sources"][2]["T_merged_source"], expected[2], rtol=0, atol=1e-12)
    assert sorted(path.name for path in out.iterdir()) == ["merged.pcd", "transforms.txt"]


def test_a_yaw_correction_turns_the_second_source_about_the_first(case, tmp_path):
    sample, paths, _ = case
    words = ("--method", "start-poses", "--sample", sample, *options(paths[:2]), "--yaw-correction", "sample1")
    assert run(*words, "-o", tmp_path / "out").exit_code == 0
    first, second = (pose((math.degrees(h - 0.45), 0, 0), (x, y, z)) for x, y, z, h in STARTS[:2])
    T = read_transforms(tmp_path / "out" / "transforms.txt").T_merged_source[1]
    np.testing.assert_allclose(T, np.linalg.inv(first) @ second, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_map_that_meets_only_a_later_one_is_joined_through_it(case, tmp_path):
    # West and east share nothing: east waits until the middle lies beside west.
    _, (west, middle, east), (_, T_middle, T_east) = case
    result = run("--method", "correlation-2d", *options([west, east, middle]), "-o", tmp_path)
    assert result.exit_code == 0, result.stderr
    written = read_transforms(tmp_path / "transforms.txt").T_merged_source
    for T, expected in zip(written, (np.eye(4), T_east, T_middle), strict=True):
        degrees, metres = difference(T, expected)
        assert degrees < DEGREES and metres < METRES
    rows = [line for line in result.stdout.splitlines() if ".pcd" in line]
    assert len(rows) >= 3


@pytest.mark.slow
def test_registration_merges_three_maps(case, tmp_path):
    pytest.importorskip("small_gicp")
    _, paths, expected = case
    result = run("--method", "registration-3d", *options(paths), "-o", tmp_path / "out")
    assert result.exit_code == 0, result.stderr
    written = read_transforms(tmp_path / "out" / "transforms.txt").T_merged_source
    for T, wanted in zip(written, expected, strict=True):
        degrees, metres = difference(T, wanted)
        assert degrees < 0.5 and metres < VOXEL


@pytest.mark.slow
def test_score_merge_calls_a_merge_by_correlation_a_success(case, tmp_path):
    starts, paths, _ = case
    sample = tmp_path / "sample"
    sample.mkdir()
    worlds = []
    for name, path, (x, y, z, heading) in zip(RUNS, paths, STARTS, strict=True):
        T = pose((math.degrees(heading), 0.0, 0.0), (x, y, z))
        worlds.append(on_lattice(read_cloud(path).points @ T[:3, :3].T + T[:3, 3]))
        np.savetxt(sample / f"gt_points_{name}.txt", worlds[-1], fmt="%.6g")
        shutil.copy(starts / f"start_pose_{name}.txt", sample)
    np.savetxt(sample / "gt_points_merged.txt", on_lattice(np.concatenate(worlds)), fmt="%.6g")
    assert run("--method", "correlation-2d", *options(paths), "-o", tmp_path / "out").exit_code == 0
    words = [
        "score-merge",
        str(sample),
        *map(str, options(paths)),
        "--transforms",
        str(tmp_path / "out/transforms.txt"),
    ]
    document = tmp_path / "score.json"
    merged = ["--merged", str(tmp_path / "out/merged.pcd"), "--device", "cpu", "--json", str(document)]
    result = CliRunner().invoke(app, [*words, *merged])
    assert result.exit_code == 0, result.stderr
    score = json.loads(document.read_text())
    assert score["success"] is True


def test_where_nothing_is_merged_the_exit_code_is_3_and_zeros_say_so(case, tmp_path):
    _, (west, _, east), _ = case
    (tmp_path / "merged.pcd").write_text("of an older merge")
    words = ("--method", "correlation-2d", *options([west, east]), "-o", tmp_path)
    refused(run(*words), "merged.pcd", "--overwrite")
    result = run(*words, "--overwrite")
    assert result.exit_code == 3
    (line,) = result.stderr.splitlines()
    assert "nothing could be merged" in line and str(east) in line
    first, second = read_transforms(tmp_path / "transforms.txt").T_merged_source
    np.testing.assert_array_equal(first, np.eye(4))
    assert second is None
    assert [path.name for path in tmp_path.iterdir()] == ["transforms.txt"]


def test_a_source_without_colours_leaves_the_merged_map_without_and_says_so(case, tmp_path):
    sample, paths, _ = case
    plain = tmp_path / "plain.pcd"
    write_pcd(plain, read_cloud(paths[1]).points)
    result = run("--method", "start-poses", "--sample", sample, *options([paths[0], plain]), "-o", tmp_path / "out")
    assert result.exit_code == 0 and "no colours" in result.stdout
    assert read_cloud(tmp_path / "out" / "merged.pcd").colors is None


def test_bad_options_are_refused_before_anything_is_written(case, tmp_path):
    sample, paths, _ = case
    two, out = options(paths[:2]), tmp_path / "out"
    correlation, starts = ("--method", "correlation-2d"), ("--method", "start-poses")
    refused(run(*correlation, "--source", paths[0], "-o", out), "--source", "2 to 10")
    refused(run(*starts, *two, "-o", out), "--sample")
    refused(run(*correlation, *two, "--sample", sample, "-o", out), "--sample", "no effect")
    refused(run(*correlation, *two, "--yaw-correction", "0.1", "-o", out), "--yaw-correction", "no effect")
    refused(run(*starts, *two, "--sample", tmp_path, "-o", out), "start_pose_first.txt")
    refused(run(*correlation, *two, "--voxel-size", "0", "-o", out), "--voxel-size")
    refused(run(*correlation, *options([paths[0], tmp_path / "absent.pcd"]), "-o", out), "absent.pcd")
    refused(run(*correlation, *two, "-o", out, "--json", paths[0]), "--json", "is an input")
    refused(run(*correlation, *two, "-o", out, "--json", out / "merged.pcd"), "--json")
    assert not out.exists()


def test_registration_without_its_library_is_refused_with_the_way_to_install_it(case, tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *arguments, **kinds):
        if name == "small_gicp":
            raise ImportError(name)
        return real(name, *arguments, **kinds)

    monkeypatch.setattr(builtins, "__import__", without)
    words = ("--method", "registration-3d", *options(case[1][:2]), "-o", tmp_path / "out")
    refused(run(*words), "small_gicp", "pip install 'maomaps-warp[merge]'")
