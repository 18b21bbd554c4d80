"""`maomaps-warp score` with options that cannot be used, outputs that cannot be written, and nothing to score."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import assert_refused, assert_without_value, score


def text(rows: np.ndarray) -> str:
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())


#: A path with a bend: t x y z qx qy qz qw.
ROWS = np.array([[100 + 0.1 * i, 0.1 * i, 0.01 * i * i, 0, 0, 0, 0, 1] for i in range(20)])


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A folder with a good run: gt.txt, est.txt, map.xyz."""
    (tmp_path / "gt.txt").write_text(text(ROWS))
    (tmp_path / "est.txt").write_text(text(ROWS + [0, 0.1, 0, 0, 0, 0, 0, 0]))
    (tmp_path / "map.xyz").write_text(text(np.random.default_rng(0).uniform(-2, 2, (200, 3)).round(3)))
    return tmp_path


def trajectories(run: Path) -> tuple[object, ...]:
    return ("--gt", run / "gt.txt", "--est", run / "est.txt")


# Options

OPTIONS = {
    "--voxel-size": ("0", "-1", "nan", "inf"),
    "--max-stamp-gap": ("-1", "nan", "inf"),
    "--t-offset": ("nan", "inf", "1e12"),
    "--camera": ("", "bla", "0x0@90", "320x240@180", "640x480:0,0,0,0", "640x480:525,525,319.5"),
    "--protocol": ("", "nonsense", "."),
}


@pytest.mark.parametrize(("option", "value"), [(name, value) for name, values in OPTIONS.items() for value in values])
def test_an_impossible_value_of_an_option_is_refused_by_name(option: str, value: str, run: Path) -> None:
    outcome = score(run, *trajectories(run), f"{option}={value}")
    assert_refused(outcome, run, option.removeprefix("--"))


def test_a_device_that_is_not_there_is_refused_with_those_that_are(run: Path) -> None:
    outcome = score(run, "--gt", run / "map.xyz", "--est", run / "map.xyz", "--device", "cuda:99")
    assert_refused(outcome, run, "--device cuda:99", "available: auto, cpu")


PROTOCOLS = {
    "an unknown field": ("voxel_sise = 0.1", ("voxel_sise", "voxel_size")),
    "a text for a number": ('voxel_size = "a"', ("number",)),
    "a switch for a number": ("voxel_size = true", ()),
    "a negative size": ("voxel_size = -1", ("voxel_size",)),
    "not a number": ("near = nan", ("near",)),
    "an unknown base": ('base = "foo"', ("foo", "slam_comparison")),
    "an unknown choice": ("align = 3", ("align", "sim3")),
    "a broken file": ("voxel_size = [", ("TOML",)),
    "no thresholds": ("thresholds = []", ("thresholds",)),
    "half a frame": ("rpe_frames = 1.5", ("whole number",)),
    "ranges that exclude each other": ("min_range = 20", ("min_range", "max_range")),
    "leaves of cells that are no tree's": ("prune_leaves = true", ("floored",)),
    "a section": ("[score]\nvoxel_size = 1", ("score",)),
    "bytes": (b"\xff\xfe\0", ("TOML",)),
}


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_mistake_in_a_protocol_file_is_refused_with_the_file(name: str, run: Path) -> None:
    content, words = PROTOCOLS[name]
    file = run / "mine.toml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    outcome = score(run, *trajectories(run), "--protocol", file)
    assert_refused(outcome, run, "mine.toml", *words)


# Outputs


@pytest.mark.parametrize("option", ["--json", "--correspondences"])
def test_an_output_that_cannot_be_written_is_refused_before_anything_is_read(option: str, run: Path) -> None:
    missing = score(run, "--gt", run / "none", "--est", run / "none", f"{option}={run / 'no' / 'file'}")
    assert_refused(missing, run, "cannot be written", "create the folder")
    folder = score(run, "--gt", run / "none", "--est", run / "none", option, run)
    assert_refused(folder, run, "a folder stands there")


def test_a_file_that_stood_there_is_kept_when_the_run_fails(run: Path) -> None:
    for name in ("old.json", "old.txt"):
        (run / name).write_text("old")
    outputs = ("--json", run / "old.json", "--correspondences", run / "old.txt")
    (run / "bad.txt").write_text("1 0 0 0 0 0 0 0\n")
    assert score(run, "--gt", run / "gt.txt", "--est", run / "bad.txt", *outputs).exit_code == 2
    assert [(run / name).read_text() for name in ("old.json", "old.txt")] == ["old", "old"]
    # Trajectories alone have no correspondences: that file stays, the score is written.
    outcome = score(run, *trajectories(run), *outputs)
    assert (outcome.exit_code, (run / "old.txt").read_text()) == (3, "old")
    assert "--correspondences" in outcome.stderr and "two maps and two paired trajectories" in outcome.stderr
    assert (run / "old.json").read_text() != "old"


def test_a_link_is_followed_and_stays_a_link(run: Path) -> None:
    (run / "link.json").symlink_to("target.json")
    assert score(run, *trajectories(run), "--json", run / "link.json").exit_code == 0
    assert (run / "link.json").is_symlink() and (run / "target.json").read_text().startswith("{")


# Nothing to score


def test_stamps_that_never_meet_give_no_value_the_ranges_and_the_option_that_helps(run: Path) -> None:
    (run / "late.txt").write_text(text(ROWS + [50, 0, 0, 0, 0, 0, 0, 0]))
    outcome = score(run, "--gt", run / "gt.txt", "--est", run / "late.txt")
    assert_without_value(outcome, "ate", "rpe")
    for word in ("100.000000000 to 101.9", "150.000000000 to 151.9", "> 10 s: 20", "--t-offset -50"):
        assert word in outcome.stderr
    assert outcome.document is not None
    assert outcome.document["metrics"]["ate"]["counts"] == {"poses": 20, "matched": 0, "unmatched": 20, "pairs": 0}
    assert "-" in outcome.stdout


def test_stamps_that_never_meet_leave_the_maps_their_nearest_neighbours(run: Path) -> None:
    (run / "late.txt").write_text(text(ROWS + [50, 0, 0, 0, 0, 0, 0, 0]))
    maps = ("--gt-map", run / "map.xyz", "--est-map", run / "map.xyz")
    poses = ("--gt-trajectory", run / "gt.txt", "--est-trajectory", run / "late.txt")
    outcome = score(run, *maps, *poses)
    assert_without_value(outcome, "ate", "rpe", "ame_ray")
    assert outcome.document is not None and outcome.document["metrics"]["ame_nn"]["value"] == 0


@pytest.mark.parametrize("side", ["gt", "est"])
def test_one_pose_is_no_trajectory(run: Path, side: str) -> None:
    (run / "one.txt").write_text(text(ROWS[3:4]))
    files = {"gt": run / "gt.txt", "est": run / "est.txt"} | {side: run / "one.txt"}
    outcome = score(run, "--gt", files["gt"], "--est", files["est"])
    assert_refused(outcome, run, "one.txt", "1 pose is no trajectory", "--est-map")


@pytest.mark.parametrize(("held", "name"), [("map.xyz", "fake.pcd"), ("gt.txt", "fake.bag"), ("map.xyz", "fake.npz")])
def test_a_file_that_is_not_what_its_name_says_is_refused(run: Path, held: str, name: str) -> None:
    (run / name).write_bytes((run / held).read_bytes())
    refused = score(run, "--gt", run / held, "--est", run / name)
    assert_refused(refused, run, name, f"is named {Path(name).suffix} but holds", "--est-format")


def test_maps_that_nowhere_meet_give_nearest_neighbours_and_no_association(run: Path) -> None:
    points = np.loadtxt(run / "map.xyz")
    (run / "far.xyz").write_text(text(points + [1000, 0, 0]))
    maps = ("--gt-map", run / "map.xyz", "--est-map", run / "far.xyz")
    poses = ("--gt-trajectory", run / "gt.txt", "--est-trajectory", run / "est.txt")
    outcome = score(run, *maps, *poses)
    assert_without_value(outcome, "ame_ray")
    assert outcome.document is not None
    metrics = outcome.document["metrics"]
    assert metrics["ame_nn"]["min"] > 990
    counts = metrics["ame_ray"]["counts"]
    assert counts["associated"] == 0
    assert counts["out_of_view"] + counts["occluded"] + counts["no_ground_truth"] == counts["total"]


def test_brackets_in_a_path_are_shown_as_they_are(run: Path) -> None:
    for name in ("a[red].txt", "x[/b].txt"):
        path = run / name
        path.parent.mkdir(exist_ok=True)
        path.write_text((run / "gt.txt").read_text())
        outcome = score(run, "--gt", path, "--est", run / "est.txt")
        assert outcome.exit_code == 0 and name in outcome.stdout


def test_stamps_that_never_meet_are_told_in_one_line_with_an_alignment_too(run: Path) -> None:
    (run / "late.txt").write_text(text(ROWS + [50, 0, 0, 0, 0, 0, 0, 0]))
    outcome = score(run, "--gt", run / "gt.txt", "--est", run / "late.txt", "--align", "se3")
    assert outcome.exit_code == 3 and len(outcome.stderr.splitlines()) == 1


# As a program


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "maomaps_warp", "score", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_the_program_exits_with_0_2_or_3_and_never_with_a_traceback(run: Path) -> None:
    good = command(*trajectories(run))
    assert (good.returncode, good.stderr) == (0, "")
    assert "ATE rmse" in good.stdout
    refused = command("--gt", run / "gt.txt", "--est", run / "none")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr == f"maomaps-warp: error: {run / 'none'}: no such file or folder\n"
    (run / "late.txt").write_text(text(ROWS + [50, 0, 0, 0, 0, 0, 0, 0]))
    unscored = command("--gt", run / "gt.txt", "--est", run / "late.txt")
    assert unscored.returncode == 3
    assert len(unscored.stderr.splitlines()) == 1 and "Traceback" not in unscored.stderr


def test_debug_shows_the_traceback_and_the_line(run: Path) -> None:
    found = command("--gt", run / "gt.txt", "--est", run / "none", "--debug")
    assert found.returncode == 2
    assert "Traceback" in found.stderr and found.stderr.splitlines()[-1].startswith("maomaps-warp: error: ")


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--t-offset", "1e300"),
        ("--max-stamp-gap", "1e300"),
        ("--yaw-correction", "nan"),
        ("--yaw-correction", "inf"),
    ],
)
def test_a_number_beyond_all_measure_is_refused(option: str, value: str, run: Path) -> None:
    assert_refused(score(run, *trajectories(run), option, value), run, option)


@pytest.mark.parametrize(
    "content",
    [
        "base = []",
        "rpe_frames = 99999999999999999999999",
        "rpe_seconds = 1e300",
        "camera = 3",
        'camera = "nonsense"',
        "name = 3",
        "near = inf",
        "yaw_correction = nan",
    ],
)
def test_a_value_of_another_kind_in_a_protocol_file_is_refused(content: str, run: Path) -> None:
    (run / "mine.toml").write_text(content)
    outcome = score(run, *trajectories(run), "--protocol", run / "mine.toml")
    assert_refused(outcome, run, "mine.toml", content.split()[0])


def test_a_map_and_a_trajectory_have_nothing_in_common_and_no_score(run: Path) -> None:
    outcome = score(run, "--gt", run / "map.xyz", "--est", run / "est.txt")
    assert outcome.exit_code in (2, 3)


def test_a_wrong_device_is_refused_even_where_none_is_needed(run: Path) -> None:
    assert_refused(score(run, *trajectories(run), "--device", "gpu"), run, "--device gpu")


@pytest.mark.parametrize("option", ["--json", "--correspondences"])
def test_an_output_that_would_replace_an_input_is_refused(option: str, run: Path) -> None:
    before = (run / "est.txt").read_text()
    maps = ("--gt-map", run / "map.xyz", "--est-map", run / "map.xyz")
    poses = ("--gt-trajectory", run / "gt.txt", "--est-trajectory", run / "est.txt")
    assert_refused(score(run, *maps, *poses, option, run / "est.txt"), run, "est.txt")
    assert (run / "est.txt").read_text() == before


def test_two_outputs_into_one_file_are_refused(run: Path) -> None:
    maps = ("--gt-map", run / "map.xyz", "--est-map", run / "map.xyz")
    poses = ("--gt-trajectory", run / "gt.txt", "--est-trajectory", run / "est.txt")
    outputs = ("--json", run / "out", "--correspondences", run / "out")
    assert_refused(score(run, *maps, *poses, *outputs), run, "out")


@pytest.mark.parametrize("wrong", [("--align", "foo"), ("--voxel-size", "abc"), ("--bogus", "1")])
def test_a_misspelt_option_is_one_line_too(wrong: tuple[str, str], run: Path) -> None:
    assert_refused(score(run, *trajectories(run), *wrong), run, wrong[0])
