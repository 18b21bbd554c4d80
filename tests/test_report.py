"""Tables and JSON: every number with its support, every absence with its reason."""

from __future__ import annotations

import io
import json
from importlib import metadata

import numpy as np
import pytest
from rich.console import Console
from scenes import camera_pose, cluttered_room

from maomaps_warp.io.sources import Source
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.statistics import Statistics
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.pipeline import score
from maomaps_warp.protocol import PRESETS
from maomaps_warp.protocol_files import with_overrides
from maomaps_warp.report.json_report import score_document, versions
from maomaps_warp.report.text import score_tables

CAMERA = Camera(64, 48, 32.0, 32.0, 31.5, 23.5)


def _source(name="[side]", *, stamps=True, points=True, notes=()):
    poses = np.stack([camera_pose((0.8 + 0.1 * i, 1.0, 0.7), 0.5 * i) for i in range(6)])
    trajectory = Trajectory(poses, np.arange(6, dtype=np.int64) * 10**8 if stamps else None, name)
    cloud = PointCloud(cluttered_room(0), dropped_nonfinite=7) if points else None
    return Source(name, "made up", trajectory, cloud, notes=notes)


def _text(result):
    out = Console(file=io.StringIO(), width=120, markup=False, highlight=False)
    for part in score_tables(result):
        out.print(part)
    return out.file.getvalue()


def test_the_tables_show_each_headline_with_its_support_and_every_class():
    result = score(_source("a"), _source("b"), camera=CAMERA, device="cpu").score
    text = _text(result)
    points = len(cluttered_room(0))
    assert "6 of 6 poses" in text
    assert f"{points} of {points + 7} map points" in text
    counts = result.ame_ray.counts
    assert f"{counts['associated']} of {counts['total']} map elements" in text
    for name in ("associated", "out of view", "occluded", "no ground truth", "total"):
        assert name in text
    for statistic in ("rmse", "mean", "median", "std", "p90", "p95", "max"):
        assert statistic in text
    assert "RPE 1 m: no such pair" in text


def test_changes_of_the_protocol_and_whose_note_it_is_are_said():
    rules = with_overrides(PRESETS["maomaps"], {"occlusion_tolerance": 0.3}, "test")
    gt, est = _source("a", notes=("left", "both")), _source("b", notes=("right", "both"))
    text = _text(score(gt, est, rules, camera=CAMERA, device="cpu").score)
    assert "maomaps, occlusion_tolerance = 0.3" in text
    assert "ground truth: left" in text and "estimate: right" in text
    assert text.count("both") == 1


def test_brackets_in_a_name_stay_as_they_are():
    text = _text(score(_source("[/red]x", points=False), _source(points=False)).score)
    assert "[/red]x" in text


def test_absent_metrics_show_a_dash_and_why():
    text = _text(score(_source(points=False), _source(points=False)).score)
    assert "AME, camera rays" in text and "the ground truth has no map" in text


def test_the_document_says_how_poses_were_paired():
    for stamps, method in ((True, "interpolate"), (False, "index")):
        one = _source(stamps=stamps, points=False)
        document = score_document(score(one, one).score)
        assert document["pairing"] == {"method": method, "largest_gap_s": 0.0}
    assert document["metrics"]["rpe"]["steps"]["seconds"]["value"] is None


def test_the_document_is_plain_json_with_protocol_versions_inputs_and_times():
    document = score_document(score(_source(), _source(), camera=CAMERA, device="cpu").score)
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["protocol"]["name"] == "maomaps"
    assert {"python", "maomaps-warp", "warp-lang", "numpy", "scipy"} <= document["versions"].keys()
    assert document["inputs"]["gt"]["facts"]["dropped_nonfinite"] == 7
    assert all(ms >= 0 for ms in document["milliseconds"].values())
    ray = document["metrics"]["ame_ray"]
    assert ray["value"] == ray["rmse"] == 0.0
    classes = ("associated", "out_of_view", "occluded", "no_ground_truth")
    assert sum(ray["counts"][name] for name in classes) == ray["counts"]["total"]


def test_the_headline_is_the_protocols():
    mean = with_overrides(PRESETS["paper"], {"headline": "mean"}, "test")
    metric = score_document(score(_source(), _source(), mean, camera=CAMERA, device="cpu").score)["metrics"]
    assert metric["ame_ray"]["value"] == metric["ame_ray"]["mean"] != metric["ame_ray"]["rmse"]


@pytest.mark.parametrize("count", [1, 2, 3, 20, 21, 1001, 1002])
def test_statistics_agree_with_numpy_and_none_have_no_value(count):
    errors = np.random.default_rng(count).exponential(size=count)
    s = Statistics.of(errors)
    assert s.rmse == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert (s.median, s.p90, s.p95) == tuple(np.percentile(errors, [50, 90, 95]))
    assert (s.mean, s.std, s.max) == pytest.approx((errors.mean(), errors.std(), errors.max()))
    assert Statistics.of(np.empty(0)) is None


def test_the_versions_are_those_of_the_installed_packages():
    found = versions()
    assert all(found[package] == metadata.version(package) for package in ("warp-lang", "numpy", "scipy"))
    assert set(found) == {"python", "maomaps-warp", "warp-lang", "numpy", "scipy"}
