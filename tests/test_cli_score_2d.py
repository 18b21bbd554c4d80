"""`maomaps-warp score-2d` end to end."""

from __future__ import annotations

import json
from pathlib import Path

import bags
import numpy as np
import pytest
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.io.occupancy_maps import write_map_server
from maomaps_warp.model.occupancy import Cell, OccupancyGrid

V = 0.05
#: Rounding of coordinates written with three decimals, metres.
ROUNDING_M = 1e-6


def run(folder, *arguments):
    """Exit code, the --json document or None, stdout, stderr; an uncaught exception fails the test."""
    document = folder / "score.json"
    document.unlink(missing_ok=True)
    result = CliRunner().invoke(app, ["score-2d", *map(str, arguments), "--json", str(document)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    found = json.loads(document.read_text()) if document.exists() else None
    return result.exit_code, found, result.stdout, result.stderr


def assert_refused(outcome, *words):
    code, document, stdout, stderr = outcome
    assert code == 2, stderr
    assert document is None and stdout == "" and len(stderr.splitlines()) == 1
    for word in words:
        assert word in stderr


def wall_grid(column, shape=(20, 40), resolution=V, origin=(-0.025, -0.025, 0.0)):
    """A free floor with one wall across, at a column of cells."""
    cells = np.full(shape, int(Cell.FREE), dtype=np.uint8)
    cells[:, column] = Cell.OCCUPIED
    return OccupancyGrid(cells, resolution, origin)


def wall_cloud(path, column):
    """The same as a cloud: 2.0 x 1.0 m of floor with a wall 1 m high, and a ceiling."""
    points = [(i, j, 0) for i in range(40) for j in range(20)]
    points += [(column, j, k) for j in range(20) for k in range(20)]
    points += [(i, j, 50) for i in range(40) for j in range(20)]
    path.write_text("".join(f"{i * V:.3f} {j * V:.3f} {k * V:.3f}\n" for i, j, k in sorted(set(points))))
    return path


def grid_bag(folder, *grids, topics=("/map", "/other")):
    kind = "ros1"
    values = np.array([-1, 0, 100], dtype=np.int8)
    entries = []
    for topic, grid in zip(topics, grids, strict=False):
        height, width = grid.cells.shape
        time = bags.message(kind, "builtin_interfaces/Time", 0, 0)
        origin = bags.pose(kind, (grid.origin[0], grid.origin[1], 0.0), (0, 0, 0, 1))
        info = bags.message(kind, "nav_msgs/MapMetaData", time, grid.resolution, width, height, origin)
        message = bags.message(
            kind, "nav_msgs/OccupancyGrid", bags.header(kind, 10**9), info, values[grid.cells].reshape(-1)
        )
        entries.append((topic, 10**9, message))
    return bags.write_bag(folder / "grids.bag", kind, entries)


def inputs(folder, column, name):
    """The same wall as each kind of input."""
    pair, _ = write_map_server(folder / f"{name}.yaml", wall_grid(column))
    (folder / name).mkdir()
    return {
        "pair": pair,
        "bag": grid_bag(folder / name, wall_grid(column)),
        "cloud": wall_cloud(folder / f"{name}.xyz", column),
    }


@pytest.mark.parametrize("gt_kind", ["pair", "bag", "cloud"])
@pytest.mark.parametrize("est_kind", ["pair", "bag", "cloud"])
def test_a_wall_moved_by_four_cells_scores_the_same_whatever_it_comes_as(tmp_path, gt_kind, est_kind):
    gt, est = inputs(tmp_path, 10, "gt")[gt_kind], inputs(tmp_path, 14, "est")[est_kind]
    code, document, stdout, stderr = run(tmp_path, "--gt", gt, "--est", est)
    assert code == 0, stderr
    metrics = document["metrics"]
    assert metrics["ame_2d"]["value"] == pytest.approx(0.2, abs=ROUNDING_M)
    assert metrics["ame_2d"]["headline"] == "mean" and metrics["ame_2d"]["count"] == 20
    assert metrics["known_iou"]["value"] == 1.0
    assert metrics["occupied_iou"]["value"] == 0.0
    assert document["counts"]["gt_free"] == 780
    is_projected = "cloud" in (gt_kind, est_kind)
    assert (document["ground"] is not None) == is_projected
    assert "0.2000" in stdout and "800 of 800 cells" in stdout


def test_both_maps_are_projected_on_the_ground_of_the_ground_truth(tmp_path):
    """The estimate's floor is missing: by itself it would stand on its ceiling."""
    gt = wall_cloud(tmp_path / "gt.xyz", 10)
    lines = wall_cloud(tmp_path / "all.xyz", 10).read_text().splitlines()
    est = tmp_path / "est.xyz"
    est.write_text("\n".join(line for line in lines if not line.endswith(" 0.000")))
    code, document, _, stderr = run(tmp_path, "--gt", gt, "--est", est)
    assert code == 0, stderr
    assert document["ground"] == "0.000 m (robust), of the ground truth"
    assert document["metrics"]["ame_2d"]["value"] == 0.0
    assert document["metrics"]["occupied_iou"]["value"] == 1.0
    assert document["metrics"]["known_iou"]["value"] == pytest.approx(20 / 800)


def test_topics_choose_among_grids(tmp_path):
    bag = grid_bag(tmp_path, wall_grid(10), wall_grid(14))
    assert_refused(run(tmp_path, "--gt", bag, "--est", bag, "--est-topic", "/map"), "2 topics", "--gt-topic NAME")
    code, document, _, stderr = run(tmp_path, "--gt", bag, "--est", bag, "--gt-topic", "/map", "--est-topic", "other")
    assert code == 0, stderr
    assert document["metrics"]["ame_2d"]["value"] == pytest.approx(0.2, abs=ROUNDING_M)


def test_runs_of_a_sample_directory_are_scored(tmp_path):
    for name, column in (("first", 10), ("second", 12), ("merged", 10)):
        wall_cloud(tmp_path / f"gt_points_{name}.txt", column)
        (tmp_path / f"start_pose_{name}.txt").write_text("0 0 1\n0\n")
        (tmp_path / f"gt_poses_{name}.txt").write_text("0.5 0.5 1.2 0 0 0\n0.6 0.5 1.2 0 0 0.1\n")
        (tmp_path / f"gt_poses_{name}_timestamps.txt").write_text("1.0\n1.1\n")
    pair, _ = write_map_server(tmp_path / "est.yaml", wall_grid(11))
    for name in ("first", "second", "merged"):
        code, document, _, stderr = run(tmp_path, "--gt", tmp_path, "--est", pair, "--run", name)
        assert code == 0, stderr
        assert document["metrics"]["ame_2d"]["value"] == pytest.approx(0.05, abs=ROUNDING_M)


@pytest.mark.parametrize("empty", ["gt", "est"])
def test_a_map_without_obstacles_has_no_value_and_exit_code_3(tmp_path, empty):
    full, _ = write_map_server(tmp_path / "full.yaml", wall_grid(10))
    free = OccupancyGrid(np.full((20, 40), int(Cell.FREE), dtype=np.uint8), V, (-0.025, -0.025, 0.0))
    bare, _ = write_map_server(tmp_path / "bare.yaml", free)
    sides = ("--gt", bare, "--est", full) if empty == "gt" else ("--gt", full, "--est", bare)
    code, document, stdout, stderr = run(tmp_path, *sides)
    assert code == 3
    (line,) = stderr.splitlines()
    assert "bare.yaml" in line and "has no occupied cell" in line
    assert document["metrics"]["ame_2d"]["value"] is None and "bare.yaml" in document["metrics"]["ame_2d"]["reason"]
    assert document["metrics"]["known_iou"]["value"] == 1.0
    assert "IoU of known cells" in stdout


def test_maps_that_know_nothing_have_no_shares(tmp_path):
    nothing = OccupancyGrid(np.zeros((4, 4), dtype=np.uint8), V, (0.0, 0.0, 0.0))
    pair, _ = write_map_server(tmp_path / "a.yaml", nothing)
    code, document, _, _ = run(tmp_path, "--gt", pair, "--est", pair)
    assert code == 3
    for name in ("ame_2d", "known_iou", "occupied_iou"):
        assert document["metrics"][name]["value"] is None and document["metrics"][name]["reason"]


def test_bad_input_is_refused_in_one_line(tmp_path):
    pair, image = write_map_server(tmp_path / "gt.yaml", wall_grid(10))
    (tmp_path / "poses.txt").write_text("".join(f"{i}.0 {i} 0 0 0 0 0 1\n" for i in range(5)))
    (tmp_path / "broken.yaml").write_text("image: gone.pgm\nresolution: 0.05\n")
    (tmp_path / "cut.bag").write_bytes(grid_bag(tmp_path, wall_grid(1)).read_bytes()[:-200])
    cases = [
        ([tmp_path / "gone.yaml"], ["gone.yaml", "no such file"]),
        ([image], ["gt.pgm", "gt.yaml"]),
        ([tmp_path / "poses.txt"], ["poses.txt", "holds no map"]),
        ([tmp_path / "broken.yaml"], ["broken.yaml", "no origin"]),
        ([tmp_path / "cut.bag"], ["cut.bag"]),
        ([pair, "--est-topic", "/map"], ["--est-topic /map", "not a bag"]),
        ([pair, "--run", "first"], ["--run first"]),
        ([pair, "--ground", "flat"], ["--ground flat"]),
        ([pair, "--voxel-size", "-1"], ["--voxel-size -1"]),
        ([pair, "--est-trajectory", tmp_path / "poses.txt"], ["--est-trajectory", "needs no poses"]),
    ]
    for arguments, words in cases:
        assert_refused(run(tmp_path, "--gt", pair, "--est", *arguments), *words)


def test_an_output_that_would_replace_an_input_is_refused(tmp_path):
    pair, _ = write_map_server(tmp_path / "gt.yaml", wall_grid(10))
    before = pair.read_bytes()
    result = CliRunner().invoke(app, ["score-2d", "--gt", str(pair), "--est", str(pair), "--json", str(pair)])
    assert result.exit_code == 2 and "is an input" in result.stderr
    assert pair.read_bytes() == before


def test_a_missing_side_is_a_usage_error(tmp_path):
    result = CliRunner().invoke(app, ["score-2d", "--gt", str(Path("a.yaml"))])
    assert result.exit_code == 2 and "--est" in result.stderr
