"""`maomaps-warp score` on input that it cannot use: one line with the place and the way out, and nothing written."""

from __future__ import annotations

from pathlib import Path

import bags
import numpy as np
import pytest
from bag_samples import CAMERA, some_frames, some_poses, whole_bag, xyz_cloud
from bags import BAG_KINDS, BagKind, storage_file
from command import assert_refused, assert_without_value, score

KIND: BagKind = "ros1"


def text(rows: list[list[float | str]]) -> str:
    return "".join(" ".join(map(str, row)) + "\n" for row in rows)


#: A path with a bend: t x y z qx qy qz qw.
ROWS: list[list[float | str]] = [[100 + 0.1 * i, 0.1 * i, 0.01 * i * i, 0, 0, 0, 0, 1] for i in range(20)]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A folder with a good run: gt.txt, est.txt, map.xyz."""
    (tmp_path / "gt.txt").write_text(text(ROWS))
    (tmp_path / "est.txt").write_text(text([[row[0], float(row[1]) + 0.1, *row[2:]] for row in ROWS]))
    points = np.random.default_rng(0).uniform(-2, 2, (200, 3)).round(3).tolist()
    (tmp_path / "map.xyz").write_text(text(points))
    return tmp_path


# Trajectories

NANOSECONDS = text([[1305031229000000000 + i * 10**8, *row[1:]] for i, row in enumerate(ROWS)])
MICROSECONDS = text([[1305031229000000 + i * 10**5, *row[1:]] for i, row in enumerate(ROWS)])
TRAJECTORIES = {
    "a NaN": (text([*ROWS[:3], [100.5, "nan", 0, 0, 0, 0, 0, 1]]), ("line 4", "NaN", "remove")),
    "an infinity": (text([*ROWS[:3], [100.5, "inf", 0, 0, 0, 0, 0, 1]]), ("line 4", "infinite")),
    "a zero quaternion": (text([*ROWS[:3], [100.5, 0, 0, 0, 0, 0, 0, 0]]), ("line 4", "norm 0")),
    "a quaternion of norm 1.1": (text([*ROWS[:3], [100.5, 0, 0, 0, 0, 0, 0, 1.1]]), ("line 4", "norm 1.1", "columns")),
    "a stamp that falls": (text([*ROWS[:3], *ROWS[1:]]), ("line 4", "comes after a later one", "sort")),
    "one stamp for all": (text([ROWS[0]] * 5), ("line 2", "stands twice", "keep one")),
    "nanoseconds": (NANOSECONDS, ("line 1", "looks like nanoseconds", "divide by 1e9")),
    "microseconds": (MICROSECONDS, ("line 1", "looks like microseconds", "divide by 1e6")),
    "a coordinate of 1e300": (text([[ROWS[0][0], 1e300, *ROWS[0][2:]], *ROWS[1:]]), ("pose 1", "1e+300", "metres")),
    "coordinates whose squares overflow": (text([[r[0], 1e160 * i, *r[2:]] for i, r in enumerate(ROWS)]), ("pose 2",)),
    "nothing": ("", ("an empty file", "accepted:", "--est-format")),
    "comments alone": ("# a\n# b\n", ("holds no rows",)),
    "a row cut off": ("1 0 0 0 0 0 0 1\n2 0 0\n", ("line 2", "3 values", "has 8")),
    "a word": ("1 0 0 0 0 0 0 1\n2 0 0 x 0 0 0 1\n", ("line 2", "'x' is not a number")),
    "five columns": ("1 2 3 4 5\n" * 4, ()),
    "prose": ("Dear user,\nthis is no trajectory.\n", ("starts with 'Dear user,'", "accepted:")),
    "a PNG": (b"\x89PNG\r\n\x1a\n\0\0", ("a PNG image",)),
    "binary zeros": (b"\0" * 1000, ("binary data",)),
    "a matrix that does not rotate": ("1 0 0 0 0 2 0 0 0 0 1 0\n" * 20, ("line 1", "no rotation matrix")),
}


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_a_trajectory_that_cannot_be_used_is_refused_with_its_place(name: str, run: Path) -> None:
    content, words = TRAJECTORIES[name]
    bad = run / "bad.txt"
    bad.write_bytes(content if isinstance(content, bytes) else content.encode())
    gt = run / "gt.txt"
    options = ("--est-format", "tum") if name == "five columns" else ()
    assert_refused(score(run, "--gt", gt, "--est", bad, *options), run, str(bad), *words)


def test_unequally_many_poses_without_stamps_are_refused(run: Path) -> None:
    row = "1 0 0 0 0 1 0 0 0 0 1 0\n"
    for name, count in (("a", 5), ("b", 4)):
        (run / f"{name}.txt").write_text(row * count)
    both = ("--gt", run / "a.txt", "--est", run / "b.txt")
    assert_refused(score(run, *both), run, "b.txt", "5 ground-truth", "4 estimated", "stamps")
    same = ("--gt", run / "a.txt", "--est", run / "a.txt")
    assert_refused(score(run, *same, "--t-offset", "5"), run, "--t-offset", "no stamps")


@pytest.mark.parametrize("align", ["se3", "sim3", "yaw"])
def test_a_path_that_does_not_determine_the_alignment_is_refused_with_one_that_it_does(align: str, run: Path) -> None:
    (run / "still.txt").write_text(text([[row[0], 0, 0, 0, 0, 0, 0, 1] for row in ROWS]))
    both = ("--gt", run / "gt.txt", "--est", run / "still.txt")
    assert_refused(score(run, *both, "--align", align), run, f"--align {align}", "use", "--align origin")
    assert score(run, *both, "--align", "origin").exit_code == 0


# Maps

PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {0}\nHEIGHT 1\nPOINTS {0}\nDATA {1}\n"
MAPS = {
    "an empty PCD": (PCD.format(0, "ascii"), ("no points",)),
    "a PCD of NaN": (PCD.format(2, "ascii") + "nan nan nan\nnan 1 1\n", ("all of its 2 points",)),
    "a PCD cut off": (PCD.format(5, "binary") + "0" * 30, ("2 of 5 points", "cut off")),
    "a PCD of more points than memory holds": (PCD.format(99999999999, "binary"), ("0 of 99999999999",)),
    "a false NPZ": (b"PK\x03\x04garbage", ("NPZ", "np.savez")),
    "a coordinate of 1e300": ("1e300 0 0\n0 0 0\n", ("point 1", "1e+300", "metres")),
    "a point a million kilometres away": ("1e9 0 0\n0 0 0\n", ("m away from the middle", "--voxel-size")),
}


@pytest.mark.parametrize("name", MAPS)
def test_a_map_that_cannot_be_used_is_refused_with_its_place(name: str, run: Path) -> None:
    content, words = MAPS[name]
    bad = run / "bad.map"
    bad.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert_refused(score(run, "--gt", run / "map.xyz", "--est", bad), run, str(bad), *words)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((5, 2)), np.array([{}], dtype=object)])
def test_an_npz_without_points_is_refused(points: np.ndarray, run: Path) -> None:
    np.savez(run / "bad.npz", points=points)
    assert_refused(score(run, "--gt", run / "map.xyz", "--est", run / "bad.npz"), run, "bad.npz", "point")


# Bags


@pytest.mark.parametrize("kind", BAG_KINDS)
@pytest.mark.parametrize("damage", ["half", "tail", "magic", "nothing", "zeros"])
def test_a_damaged_bag_is_refused_with_its_name_and_a_remedy(kind: BagKind, damage: str, tmp_path: Path) -> None:
    path = whole_bag(tmp_path, kind)
    file = storage_file(path)
    content = file.read_bytes()
    pieces = {"half": content[: len(content) // 2], "tail": content[:-30], "magic": content[:13], "nothing": b""}
    file.write_bytes(pieces.get(damage, bytes(len(content))))
    outcome = score(tmp_path, "--gt", path, "--est", path)
    assert_refused(outcome, tmp_path, str(path), "(")


def written_bag(folder: Path, *, poses: bool = True, info: bool = True, images: list[bags.Entry] | None = None) -> Path:
    """A bag of 6 poses, camera_info and images; by default depth images."""
    trajectory, frames = some_poses(6), some_frames(6)
    assert trajectory.stamps_ns is not None
    stamps = trajectory.stamps_ns.tolist()
    entries: list[bags.Entry] = []
    if poses:
        entries += bags.pose_messages(KIND, "/pose", stamps, trajectory.T_world_camera)
    if info:
        entries += [("/info", s, bags.camera_info(KIND, s, CAMERA)) for s in stamps]
    if images is None:
        images = [("/depth", s, bags.depth_message(KIND, s, f.depth)) for s, f in zip(stamps, frames, strict=True)]
    return bags.write_bag(folder / "run.bag", KIND, [*entries, *images])


def images_of(pixels: np.ndarray, encoding: str, topic: str = "/depth") -> list[bags.Entry]:
    stamps = some_poses(6).stamps_ns
    assert stamps is not None
    return [(topic, s, bags.image(KIND, s, pixels, encoding)) for s in stamps.tolist()]


def test_what_a_bag_lacks_is_named_with_what_it_holds(tmp_path: Path) -> None:
    bag = written_bag(tmp_path, poses=False)
    assert_refused(score(tmp_path, "--gt", bag, "--est", bag), tmp_path, "without poses", "--gt-trajectory")


def test_an_uncalibrated_bag_asks_for_a_camera_and_takes_one_of_the_right_size(tmp_path: Path) -> None:
    bag = written_bag(tmp_path, info=False)
    both = ("--gt", bag, "--est", bag)
    assert_refused(score(tmp_path, *both), tmp_path, "no camera_info", "--camera")
    assert_refused(score(tmp_path, *both, "--camera", "320x240@90"), tmp_path, "8x6", "320x240", "message 1")
    assert score(tmp_path, *both, "--camera", "8x6:5,5.5,3.4,2.6").exit_code == 0


def test_an_unknown_topic_is_refused_with_a_list_of_those_there_are(tmp_path: Path) -> None:
    bag = written_bag(tmp_path)
    outcome = score(tmp_path, "--gt", bag, "--est", bag, "--gt-topic", "/nope")
    assert_refused(outcome, tmp_path, "no topic /nope", "/depth (sensor_msgs/Image, 32FC1, 6 messages)", "/pose")


@pytest.mark.parametrize(("encoding", "dtype"), [("mono8", np.uint8), ("64FC1", np.float64)])
def test_an_image_that_was_named_and_holds_no_depth_is_refused(encoding: str, dtype: type, tmp_path: Path) -> None:
    bag = written_bag(tmp_path, images=images_of(np.zeros((6, 8), dtype), encoding))
    outcome = score(tmp_path, "--gt", bag, "--est", bag, "--gt-topic", "/depth")
    assert_refused(outcome, tmp_path, "topic /depth", encoding)


@pytest.mark.parametrize(("topic", "encoding"), [("/depth", "mono8"), ("/image", "64FC1"), ("/image", "bogus")])
def test_images_that_were_meant_as_depth_are_refused_with_their_encoding(
    topic: str, encoding: str, tmp_path: Path
) -> None:
    pixels = np.zeros((6, 8), np.float64 if encoding == "64FC1" else np.uint8)
    bag = written_bag(tmp_path, images=images_of(pixels, encoding, topic))
    assert_refused(
        score(tmp_path, "--gt", bag, "--est", bag), tmp_path, topic, repr(encoding), "allowed: depth", "32FC1"
    )
    for_poses = score(tmp_path, "--gt", bag, "--est", bag, "--gt-topic", "/pose", "--est-topic", "/pose")
    assert for_poses.metrics["ate"]["value"] == 0


def test_plain_colour_images_leave_the_poses_and_a_note(tmp_path: Path) -> None:
    bag = written_bag(tmp_path, images=images_of(np.zeros((6, 8, 3), np.uint8), "rgb8", "/camera/image"))
    outcome = score(tmp_path, "--gt", bag, "--est", bag)
    assert outcome.metrics["ate"]["value"] == 0
    assert "no map: /camera/image holds colours" in outcome.stdout


@pytest.mark.parametrize("depth", [0.0, np.nan, 1e30, -1.0])
def test_depth_without_one_usable_sample_gives_no_map_score_but_the_other_metrics(depth: float, tmp_path: Path) -> None:
    bag = written_bag(tmp_path, images=images_of(np.full((6, 8), depth, "<f4"), "32FC1"))
    outcome = score(tmp_path, "--gt", bag, "--est", bag)
    assert_without_value(outcome, "ame_nn", "ame_ray")
    assert outcome.document is not None and outcome.document["metrics"]["ate"]["value"] == 0


@pytest.mark.parametrize("points", [[], [[np.nan, np.nan, np.nan]]])
def test_a_cloud_without_points_in_a_bag_is_refused(points: list[list[float]], run: Path) -> None:
    bag = bags.write_bag(run / "cloud.bag", KIND, [("/map", 10**18, xyz_cloud(KIND, 10**18, points))])
    assert_refused(score(run, "--gt", run / "map.xyz", "--est", bag), run, "topic /map", "cloud")


# Sides and parts


def test_a_missing_side_a_missing_file_and_a_folder_of_nothing_are_named(run: Path) -> None:
    gt, est = run / "gt.txt", run / "est.txt"
    assert_refused(score(run), run, "--gt", "no ground truth")
    assert_refused(score(run, "--gt", gt), run, "--est", "no estimate")
    assert_refused(score(run, "--gt", gt, "--est", run / "none"), run, "none: no such file")
    assert_refused(score(run, run, "--gt", gt), run, "beside --gt")
    assert_refused(score(run, run), run, "gt_points.txt")
    assert_refused(score(run, gt), run, "gt.txt", "--gt X --est Y")
    (run / "folder").mkdir()
    assert_refused(score(run, "--gt", gt, "--est", run / "folder"), run, "an empty folder", "accepted:")
    for name in ("est-map", "est-trajectory"):
        assert_refused(score(run, "--gt", gt, f"--{name}", run / "folder"), run, "an empty folder")
    assert_refused(score(run, "--gt", gt, "--est", est, "--gt-topic", "/x"), run, "not a bag")


def test_a_map_given_as_a_trajectory_and_the_reverse_are_refused(run: Path) -> None:
    gt, est, points = run / "gt.txt", run / "est.txt", run / "map.xyz"
    swapped = score(run, "--gt-map", gt, "--gt-trajectory", points, "--est", est)
    assert_refused(swapped, run, "gt.txt: holds no map", "TUM trajectory")
    swapped = score(run, "--gt-trajectory", points, "--est-trajectory", est)
    assert_refused(swapped, run, "map.xyz: holds no poses", "XYZ map")


@pytest.mark.parametrize("format", ["kitti", "euroc", "pcd", "bag", "sample", "open3d", "nonsense"])
def test_a_format_that_the_file_does_not_have_is_refused(format: str, run: Path) -> None:
    outcome = score(run, "--gt", run / "gt.txt", "--est", run / "est.txt", "--gt-format", format)
    assert_refused(outcome, run, format if format in ("nonsense", "sample", "open3d") else "gt.txt", "(")
