"""`maomaps-warp project` end to end."""

from __future__ import annotations

import bags
import numpy as np
import pytest
import tum_sample
from PIL import Image
from shared_data import shared_data
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.io.occupancy_maps import read_occupancy

V = 0.05


def run(*arguments):
    """Exit code, stdout, stderr; an exception that the command did not catch fails the test."""
    result = CliRunner().invoke(app, [*map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def assert_refused(outcome, folder, *words):
    code, stdout, stderr = outcome
    assert code == 2, stderr
    assert stdout == "" and len(stderr.splitlines()) == 1
    for word in words:
        assert word in stderr
    assert not [path for path in folder.iterdir() if path.name.startswith((".", "out"))]


def room():
    """A floor of 2.0 x 1.5 m with one wall along its lowest x and a table, voxel indices."""
    floor = [(i, j, 0) for i in range(40) for j in range(30)]
    wall = [(0, j, k) for j in range(30) for k in range(50)]
    table = [(i, j, 15) for i in range(20, 30) for j in range(10, 20)]
    return np.unique(np.array(floor + wall + table), axis=0)


def write_cloud(path, ijk):
    path.write_text("".join(f"{x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in ijk * V))
    return path


def write_sample(folder):
    """A sample directory: first has the lower half of the room, second all of it but the wall, merged everything."""
    ijk = room()
    parts = {"first": ijk[ijk[:, 1] < 15], "second": ijk[ijk[:, 0] > 0], "merged": ijk}
    for name, part in parts.items():
        write_cloud(folder / f"gt_points_{name}.txt", part)
        if name != "merged":
            (folder / f"gt_poses_{name}.txt").write_text("0.5 0.5 1.2 0 0 0\n0.6 0.5 1.2 0 0 0.1\n")
            (folder / f"gt_poses_{name}_timestamps.txt").write_text("1.0\n1.1\n")
            (folder / f"start_pose_{name}.txt").write_text("0.5 0.5 1.2\n0.0\n")
    return folder


def test_a_cloud_becomes_an_image_and_a_map_server_pair(tmp_path):
    cloud = write_cloud(tmp_path / "room.xyz", room())
    code, stdout, stderr = run("project", cloud, "-o", tmp_path / "out")
    assert code == 0, stderr
    expected = np.full((30, 40), 255)
    expected[:, 0] = 0
    expected[10:20, 20:30] = 0
    with Image.open(tmp_path / "out.png") as image:
        np.testing.assert_array_equal(np.asarray(image)[::-1], expected)
    grid = read_occupancy(tmp_path / "out.yaml")
    assert grid.origin == pytest.approx((-0.025, -0.025, 0.0), abs=1e-9)
    assert grid.counts == {"total": 1200, "unknown": 0, "free": 1200 - 130, "occupied": 130}
    for word in ("40 x 30 cells", "0.000 m (robust)", "1070 free, 130 occupied, 0 unknown", "out.png", "out.pgm"):
        assert word in stdout


@pytest.mark.parametrize("name, shape", [("first", (15, 40)), ("second", (30, 39)), ("merged", (30, 40))])
def test_a_run_of_a_sample_directory_is_projected(tmp_path, name, shape):
    folder = write_sample(tmp_path)
    code, stdout, stderr = run("project", folder, "-o", tmp_path / "out", "--run", name)
    assert code == 0, stderr
    assert read_occupancy(tmp_path / "out.yaml").cells.shape == shape
    assert name in stdout


def test_the_cameras_of_a_merged_map_are_those_of_all_runs_that_have_some(tmp_path):
    folder = write_sample(tmp_path)
    above = room() + [0, 0, 60]
    write_cloud(folder / "gt_points_merged.txt", np.concatenate([room(), above]))
    for name in ("first", "second"):
        (folder / f"gt_poses_{name}.txt").write_text("0.5 0.5 4.2 0 0 0\n0.6 0.5 4.2 0 0 0.1\n")
    (folder / "gt_poses_second.txt").unlink()
    code, stdout, stderr = run("project", folder, "-o", tmp_path / "out", "--run", "merged")
    assert code == 0, stderr
    assert "3.000 m (robust)" in stdout
    assert "cameras of the run second not used" in stdout


def test_the_ground_may_be_named(tmp_path):
    cloud = write_cloud(tmp_path / "room.xyz", room())
    for rule, shown in (("original", "0.000 m (original)"), ("0.75", "0.750 m (given)"), ("-3", "-3.000 m (given)")):
        code, stdout, stderr = run("project", cloud, "-o", tmp_path / "out", "--ground", rule, "--overwrite")
        assert code == 0, stderr
        assert shown in stdout
    assert read_occupancy(tmp_path / "out.yaml").counts["unknown"] == 1200


def test_a_map_without_a_floor_says_so(tmp_path):
    ijk = room()
    cloud = write_cloud(tmp_path / "wall.xyz", ijk[(ijk[:, 0] == 0) & (ijk[:, 2] > 10)])
    code, stdout, _ = run("project", cloud, "-o", tmp_path / "out")
    assert code == 0
    assert "0.550 m (robust, not found)" in stdout and "no ground found" in stdout


def test_a_recording_is_mapped_first_and_its_map_is_that_of_map(tmp_path):
    """A bag of the real recording: `project BAG` gives what `map BAG` and `project` of its sample directory give."""
    bag = tum_sample.write_run(bags.bag_path(tmp_path, "ros1"), "ros1", tum_sample.read_tum(), "first")
    code, stdout, stderr = run("project", bag, "-o", tmp_path / "direct", "--pose-frame", "optical", "--device", "cpu")
    assert code == 0, stderr
    assert "not found" not in stdout
    sample = tmp_path / "sample"
    assert run("map", bag, "-o", sample, "--pose-frame", "optical", "--no-colors", "--device", "cpu")[0] == 0
    code, _, stderr = run("project", sample, "-o", tmp_path / "two", "--run", "first")
    assert code == 0, stderr
    for suffix in (".png", ".pgm"):
        assert (tmp_path / f"direct{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()
    counts = read_occupancy(tmp_path / "direct.yaml").counts
    assert counts["free"] > 300 and counts["occupied"] > 1000


def test_nothing_is_overwritten_unasked(tmp_path):
    cloud = write_cloud(tmp_path / "room.xyz", room())
    (tmp_path / "out.pgm").write_text("mine")
    code, stdout, stderr = run("project", cloud, "-o", tmp_path / "out")
    assert (code, stdout) == (2, "") and "holds out.pgm already" in stderr
    assert (tmp_path / "out.pgm").read_text() == "mine" and not (tmp_path / "out.png").exists()
    assert run("project", cloud, "-o", tmp_path / "out", "--overwrite")[0] == 0


@pytest.mark.parametrize(
    "options, words",
    [
        (["--ground", "floor"], ["--ground floor", "robust, original"]),
        (["--ground", "nan"], ["--ground nan"]),
        (["--voxel-size", "0"], ["--voxel-size 0"]),
        (["--voxel-size", "nan"], ["--voxel-size nan"]),
        (["--run", "first"], ["--run first", "no MAOMaps sample directory"]),
        (["--run", "merged"], ["--run merged", "no MAOMaps sample directory"]),
        (["--topic", "/map"], ["--topic /map", "not a bag"]),
        (["--device", "gpu"], ["--device gpu"]),
        (["--format", "octomap"], ["--format octomap"]),
        (["--trajectory", "gone.txt"], ["gone.txt"]),
        (["--voxel-size", "1e-9"], ["more than"]),
    ],
)
def test_impossible_options_are_refused_and_nothing_is_written(tmp_path, options, words):
    cloud = write_cloud(tmp_path / "room.xyz", room())
    assert_refused(run("project", cloud, "-o", tmp_path / "out", *options), tmp_path, *words)


def test_impossible_maps_are_refused_and_nothing_is_written(tmp_path):
    (tmp_path / "poses.txt").write_text("".join(f"{i}.0 {i} 0 0 0 0 0 1\n" for i in range(5)))
    (tmp_path / "empty.pcd").write_bytes(b"")
    (tmp_path / "far.xyz").write_text("0 0 0\n1e9 0 0\n0 1 0\n")
    (tmp_path / "wide.xyz").write_text("0 0 0\n20000 20000 0\n0 1 0\n")
    folder = tmp_path / "sample"
    folder.mkdir()
    write_sample(folder)
    (folder / "gt_points_merged.txt").unlink()
    cases = [
        ("poses.txt", [], ["poses.txt", "holds no map"]),
        ("empty.pcd", [], ["empty.pcd"]),
        ("far.xyz", [], ["far.xyz", "more than"]),
        ("wide.xyz", [], ["wide.xyz", "too many", "--voxel-size"]),
        ("gone.pcd", [], ["gone.pcd", "no such file"]),
        ("sample", [], ["--run first"]),
        ("sample", ["--run", "third"], ["no run 'third'"]),
        ("sample", ["--run", "merged"], ["missing: gt_points_merged"]),
    ]
    for name, options, words in cases:
        assert_refused(run("project", tmp_path / name, "-o", tmp_path / "out", *options), tmp_path, *words)


def test_an_output_that_is_an_input_or_cannot_be_is_refused(tmp_path):
    cloud = write_cloud(tmp_path / "room.pgm", room())
    code, _, stderr = run("project", cloud, "-o", tmp_path / "room", "--overwrite")
    assert code == 2 and "is an input" in stderr
    (tmp_path / "file").write_text("")
    code, _, stderr = run("project", cloud, "-o", tmp_path / "file" / "out")
    assert code == 2 and "file" in stderr
    code, _, stderr = run("project", cloud, "-o", ".")
    assert code == 2 and "names no files" in stderr
    code, _, stderr = run("project", cloud, "-o", tmp_path / "out.png")
    assert code == 2 and "endings" in stderr


@pytest.mark.slow
def test_the_real_recording_has_a_floor_between_its_desks(tmp_path):
    code, stdout, stderr = run("project", shared_data("rgbd_tum_fr1_rpy_a"), "-o", tmp_path / "out", "--device", "cpu")
    assert code == 0, stderr
    grid = read_occupancy(tmp_path / "out.yaml")
    # About 3 square metres of floor and 15 of desks, walls and people in front of the camera.
    assert grid.counts["free"] > 1000 and grid.counts["occupied"] > 4000
    assert "(robust)" in stdout
