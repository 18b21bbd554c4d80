"""`disturb`: estimates whose errors are known, and what `score` says of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from maomaps_warp.cli.app import app
from maomaps_warp.io.clouds import read_cloud
from maomaps_warp.io.trajectories import read_trajectory

#: Metres and degrees: estimates go through text with all their digits.
EXACT = 1e-9
#: Metres: maps go through float32.
PCD = 1e-6


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("run") / "run.bag"
    done = run("record", "flat:2", "-o", bag, "--duration", 16, "--camera", "80x60@90", "--rate", 5, "--device", "cpu")
    assert done.exit_code == 0, done.output
    return bag


def disturb(recording: Path, output: Path, *options: object) -> dict[str, Any]:
    done = run("disturb", recording, "-o", output, "--pose-frame", "body", "--device", "cpu", *options)
    assert done.exit_code == 0, done.output
    return json.loads((output / "disturbance.json").read_text())


def score(recording: Path, estimate: Path) -> dict[str, Any]:
    files = ("--est-map", estimate / "est_map.pcd", "--est-trajectory", estimate / "est_trajectory.txt")
    report = estimate / "score.json"
    done = run("score", "--gt", recording, "--gt-pose-frame", "body", *files, "--json", report, "--device", "cpu")
    assert done.exit_code == 0, done.output
    return json.loads(report.read_text())["metrics"]


def test_an_estimate_without_errors_scores_zero(recording: Path, tmp_path: Path) -> None:
    facts = disturb(recording, tmp_path / "est", "--preset", "none")
    assert facts["position_error_m"]["rmse"] == pytest.approx(0.0, abs=EXACT)
    metrics = score(recording, tmp_path / "est")
    assert metrics["ate"]["rmse"] == pytest.approx(0.0, abs=EXACT)
    assert metrics["ame_nn"]["rmse"] == pytest.approx(0.0, abs=PCD)
    # Quaternions went through text: a ray in a thousand grazes an edge on its other side.
    assert metrics["ame_ray"]["p95"] == 0.0 and metrics["ame_ray"]["rmse"] < 0.02


def test_the_ate_is_the_error_that_was_made(recording: Path, tmp_path: Path) -> None:
    facts = disturb(recording, tmp_path / "est", "--seed", 5, "--closures", 1, "--losses", 1, "--loss-length", 0.5)
    assert facts["frames"]["kept"] < facts["frames"]["of_the_recording"] and len(facts["closures_at_ns"]) == 1
    assert 0.005 < facts["position_error_m"]["rmse"] < 0.5
    metrics = score(recording, tmp_path / "est")
    assert metrics["ate"]["rmse"] == pytest.approx(facts["position_error_m"]["rmse"], abs=EXACT)
    assert len(read_trajectory(tmp_path / "est" / "est_trajectory.txt")) == facts["frames"]["kept"]
    assert read_cloud(tmp_path / "est" / "est_map.pcd").colors is not None


def test_a_pure_scale_error_of_depth_leaves_the_trajectory_and_moves_the_map(recording: Path, tmp_path: Path) -> None:
    disturb(recording, tmp_path / "est", "--preset", "none", "--depth-scale-error", 0.2)
    metrics = score(recording, tmp_path / "est")
    assert metrics["ate"]["rmse"] == pytest.approx(0.0, abs=EXACT)
    # Every surface lies a fifth of its depth behind the true one: along its ray by that, to the nearest by no more.
    assert metrics["ame_ray"]["median"] >= metrics["ame_nn"]["median"] > 0.1


def test_the_same_seed_gives_the_same_bytes(recording: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        disturb(recording, tmp_path / name, "--seed", seed, "--preset", "cnn")
    for file in ("est_map.pcd", "est_trajectory.txt", "disturbance.json"):
        a, b, c = ((tmp_path / name / file).read_bytes() for name in "abc")
        assert a == b != c


def test_the_meaning_of_the_poses_is_proved_where_it_is_not_said(recording: Path, tmp_path: Path) -> None:
    done = run("disturb", recording, "-o", tmp_path / "est", "--preset", "none", "--device", "cpu")
    assert done.exit_code == 0, done.output
    assert "pose convention proved by the depth images: body" in " ".join(done.stdout.split())
    disturb(recording, tmp_path / "said", "--preset", "none")
    said, proved = (read_trajectory(tmp_path / name / "est_trajectory.txt") for name in ("said", "est"))
    np.testing.assert_allclose(proved.T_world_camera, said.T_world_camera, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--preset", "slam"), "allowed: none, rgbd, cnn"),
        (("--closures", -1), "closures and losses must not be negative"),
        (("--depth-scale-error", -1), "scale errors must be above -1"),
        (("--keyframe-every", 0), "keyframe_every must be at least 1"),
    ],
)
def test_what_cannot_be_is_one_line(recording: Path, tmp_path: Path, options: tuple[object, ...], words: str) -> None:
    done = run("disturb", recording, "-o", tmp_path / "est", *options)
    assert done.exit_code == 2 and words in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_what_is_no_recording_is_one_line_and_an_estimate_is_not_replaced(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "est").mkdir()
    (tmp_path / "est" / "est_map.pcd").write_text("precious")
    done = run("disturb", recording, "-o", tmp_path / "est")
    assert done.exit_code == 2 and "--overwrite" in done.stderr
    assert (tmp_path / "est" / "est_map.pcd").read_text() == "precious"
    (tmp_path / "way.txt").write_text("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")
    done = run("disturb", tmp_path / "way.txt", "-o", tmp_path / "new")
    assert done.exit_code == 2 and "no depth images" in done.stderr and not (tmp_path / "new").exists()
