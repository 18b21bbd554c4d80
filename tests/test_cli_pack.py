"""`maomaps-warp pack`, and back again by `extract`."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation
from shared_data import shared_data
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.io.clouds import write_cloud
from maomaps_warp.io.occupancy_maps import write_map_server
from maomaps_warp.io.trajectories import write_tum
from maomaps_warp.model.occupancy import OccupancyGrid
from maomaps_warp.model.trajectory import Trajectory

RNG = np.random.default_rng(13)
POINTS = RNG.normal(size=(250, 3)) * 15.0
COLORS = RNG.integers(0, 256, (250, 3), dtype=np.uint8)
STAMPS = 1_305_031_229_000_000_123 + np.arange(7, dtype=np.int64) * 33_333_333
POSES = np.tile(np.eye(4), (7, 1, 1))
POSES[:, :3, :3] = Rotation.random(7, rng=RNG).as_matrix()
POSES[:, :3, 3] = RNG.normal(size=(7, 3))
GRID = OccupancyGrid(RNG.integers(0, 3, (6, 9), dtype=np.uint8), 0.05, (-1.25, 3.5, 0.0))
NAMES = ["map.bag", "map.mcap", "map"]
every_kind = pytest.mark.parametrize("name", NAMES)
#: Dimensionless: a quaternion of float64 and back.
ROTATION_TOLERANCE = 1e-14


def run(command: str, *arguments: object) -> Any:
    result = CliRunner().invoke(app, [command, *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture
def inputs(tmp_path: Path) -> Path:
    folder = tmp_path / "inputs"
    folder.mkdir()
    write_cloud(folder / "cloud.ply", POINTS, COLORS)
    write_tum(folder / "poses.txt", Trajectory(POSES, STAMPS))
    write_map_server(folder / "ground.yaml", GRID)
    return folder


def packed(inputs: Path, output: Path, *more: object) -> Path:
    arguments = ("--trajectory", inputs / "poses.txt", "--grid", inputs / "ground.yaml", *more)
    result = run("pack", inputs / "cloud.ply", "-o", output, *arguments)
    assert result.exit_code == 0, result.stderr
    return output


@every_kind
def test_pack_and_extract_give_everything_back(tmp_path: Path, inputs: Path, name: str) -> None:
    bag = packed(inputs, tmp_path / name)
    result = run("extract", bag, "-o", tmp_path / "out")
    assert result.exit_code == 0, result.stderr
    names = sorted(file.name for file in (tmp_path / "out").iterdir())
    assert names == ["grid.pgm", "grid.yaml", "map.pcd", "path.txt"]
    header, _, body = (tmp_path / "out" / "map.pcd").read_bytes().partition(b"DATA binary\n")
    assert b"FIELDS x y z rgb\n" in header
    rows = np.frombuffer(body, [("xyz", "<f4", 3), ("bgra", "u1", 4)])
    np.testing.assert_array_equal(rows["xyz"], POINTS.astype(np.float32))
    np.testing.assert_array_equal(rows["bgra"][:, 2::-1], COLORS)
    lines = (tmp_path / "out" / "path.txt").read_text().splitlines()[1:]
    assert [line.split()[0] for line in lines] == [f"{s // 10**9}.{s % 10**9:09d}" for s in STAMPS]
    values = np.array([[float(word) for word in line.split()] for line in lines])
    np.testing.assert_array_equal(values[:, 1:4], POSES[:, :3, 3])
    R = Rotation.from_quat(values[:, 4:]).as_matrix()
    np.testing.assert_allclose(R, POSES[:, :3, :3], rtol=0, atol=ROTATION_TOLERANCE)
    for file in ("grid.pgm", "grid.yaml"):
        former = (inputs / file.replace("grid", "ground")).read_bytes()
        assert (tmp_path / "out" / file).read_bytes() == former.replace(b"ground", b"grid")


@every_kind
def test_messages_bear_the_last_stamp_and_the_frame(tmp_path: Path, inputs: Path, name: str) -> None:
    bag = packed(inputs, tmp_path / name, "--topic", "/slam/map", "--frame-id", "world")
    with AnyReader([bag]) as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == {
            "/slam/map": "sensor_msgs/msg/PointCloud2",
            "/path": "nav_msgs/msg/Path",
            "/grid": "nav_msgs/msg/OccupancyGrid",
        }
        for connection, time, data in reader.messages():
            header = reader.deserialize(data, connection.msgtype).header
            assert header.stamp.sec * 10**9 + header.stamp.nanosec == time == STAMPS[-1]
            assert header.frame_id == "world"


@every_kind
@pytest.mark.parametrize(
    ("arguments", "stamp_ns"), [((), 10**9), (("--stamp", "1305031229.000000123"), int(STAMPS[0]))]
)
def test_a_cloud_alone_has_a_fixed_or_a_given_stamp(
    tmp_path: Path, inputs: Path, name: str, arguments: tuple[str, ...], stamp_ns: int
) -> None:
    assert run("pack", inputs / "cloud.ply", "-o", tmp_path / name, *arguments).exit_code == 0
    with AnyReader([tmp_path / name]) as reader:
        assert [time for _, time, _ in reader.messages()] == [stamp_ns]


@every_kind
def test_the_same_input_gives_the_same_bytes(tmp_path: Path, inputs: Path, name: str) -> None:
    found = []
    for folder in (tmp_path / "one", tmp_path / "two"):
        folder.mkdir()
        bag = packed(inputs, folder / name)
        found.append([file.read_bytes() for file in ([bag] if bag.is_file() else sorted(bag.iterdir()))])
    assert found[0] == found[1]


def test_a_map_that_was_packed_scores_zero_against_itself(tmp_path: Path, inputs: Path) -> None:
    bag = packed(inputs, tmp_path / "map.mcap")
    result = run("score", "--gt", bag, "--est", bag, "--device", "cpu", "--json", tmp_path / "score.json")
    assert result.exit_code == 0, result.stderr
    metrics = json.loads((tmp_path / "score.json").read_text())["metrics"]
    assert [metrics[name]["value"] for name in ("ate", "ame_nn")] == [0.0, 0.0]


def refused(folder: Path, words: str, *arguments: object) -> None:
    """Exit code 2, one line with the words, and nothing new in the folder."""
    before = sorted(folder.iterdir())
    result = run("pack", *arguments)
    assert result.exit_code == 2 and result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("maomaps-warp: error: ") and words in line, line
    assert sorted(folder.iterdir()) == before


def test_bad_options_are_refused(tmp_path: Path, inputs: Path) -> None:
    cloud, out = inputs / "cloud.ply", tmp_path / "map.mcap"
    poses, grid = ("--trajectory", inputs / "poses.txt"), ("--grid", inputs / "ground.yaml")
    refused(tmp_path, "NAME.mcap", cloud, "-o", tmp_path / "map.db3")
    refused(tmp_path, "no folder", cloud, "-o", tmp_path / "nowhere" / "map.bag")
    for stamp in ("0", "-1", "soon", "nan", "4294967296"):
        refused(tmp_path, "--stamp", cloud, "-o", out, "--stamp", stamp)
    refused(tmp_path, "below 2147483648 s", cloud, "-o", out, "--stamp", "2147483648")
    refused(tmp_path, "--frame-id: is empty", cloud, "-o", out, "--frame-id", "")
    refused(tmp_path, "no name of a topic", cloud, "-o", out, "--topic", "a topic")
    refused(tmp_path, "is used twice", cloud, "-o", out, *poses, "--path-topic", "map")
    refused(tmp_path, "is used twice", cloud, "-o", out, *poses, *grid, "--grid-topic", "/path")


def test_existing_bags_stay_unless_told_otherwise(tmp_path: Path, inputs: Path) -> None:
    cloud = inputs / "cloud.ply"
    out = tmp_path / "map.bag"
    out.write_text("precious")
    refused(tmp_path, "exists already (--overwrite", cloud, "-o", out)
    assert out.read_text() == "precious"
    assert run("pack", cloud, "-o", out, "--overwrite").exit_code == 0
    assert out.read_bytes().startswith(b"#ROSBAG V2.0")
    refused(tmp_path, "is an input", out, "-o", out, "--overwrite")
    (inputs / "notes").mkdir()
    refused(tmp_path, "no bag", cloud, "-o", inputs / "notes", "--overwrite")


def test_an_input_inside_the_bag_that_is_replaced_survives(tmp_path: Path, inputs: Path) -> None:
    out = packed(inputs, tmp_path / "map")
    write_cloud(out / "cloud.ply", POINTS)
    refused(tmp_path, "an input", out / "cloud.ply", "-o", out, "--overwrite")
    assert (out / "cloud.ply").exists()


def test_inputs_that_hold_nothing_to_pack_are_refused(tmp_path: Path, inputs: Path) -> None:
    cloud, out = inputs / "cloud.ply", tmp_path / "map.mcap"
    refused(tmp_path, "no such file", tmp_path / "nothing.ply", "-o", out)
    refused(tmp_path, "no map", inputs / "poses.txt", "-o", out)
    refused(tmp_path, "no poses", cloud, "-o", out, "--trajectory", cloud)
    np.savetxt(inputs / "kitti.txt", POSES[:, :3].reshape(-1, 12))
    refused(tmp_path, "no stamps", cloud, "-o", out, "--trajectory", inputs / "kitti.txt")
    refused(tmp_path, "no stamps", cloud, "-o", out, "--trajectory", inputs / "kitti.txt", "--stamp", "5")
    refused(tmp_path, "no map of the ground", cloud, "-o", out, "--grid", inputs / "poses.txt")
    refused(tmp_path, "`extract`", shared_data("bags_pointcloud") / "embag_test.bag", "-o", out)
    write_cloud(inputs / "far.ply", POINTS + [0, 20_000.0, 0])
    refused(tmp_path, "move the cloud with `transform` first", inputs / "far.ply", "-o", out)


def test_the_point_step_of_the_file_is_what_pcl_expects(tmp_path: Path) -> None:
    write_cloud(tmp_path / "one.ply", np.array([[1.5, -2.0, 0.25]]), np.array([[1, 2, 3]], np.uint8))
    assert run("pack", tmp_path / "one.ply", "-o", tmp_path / "one.mcap").exit_code == 0
    # x, y, z, then blue, green, red, 0: PCL's packed colour in little-endian order.
    assert struct.pack("<3f4B", 1.5, -2.0, 0.25, 3, 2, 1, 0) in (tmp_path / "one.mcap").read_bytes()
