"""A score as JSON."""

from __future__ import annotations

import platform
from importlib import metadata
from typing import Any

from maomaps_warp.model.alignment import Alignment
from maomaps_warp.model.results import (
    InputSummary,
    NearestScore,
    NoValue,
    RayScore,
    Score,
    TrajectoryScore,
)
from maomaps_warp.protocol import changes_of

#: Raised when a field changes its meaning or goes away.
SCHEMA = 1

#: Packages whose version can move a score.
_VERSIONED = ("maomaps-warp", "warp-lang", "numpy", "scipy")


def score_document(score: Score) -> dict[str, Any]:
    """The whole result as plain JSON values: metrics, effective protocol, versions, device, inputs, times.

    Metres and radians throughout. A metric without data has "value": null and its reason; everything except
    `milliseconds` is the same for the same input.
    """
    headline = score.protocol.headline
    return {
        "schema": SCHEMA,
        "metrics": {
            "ate": _ate(score.ate),
            "rpe": _rpe(score.rpe),
            "ame_nn": _nearest(score.ame_nn, headline),
            "ame_ray": _ray(score.ame_ray, headline),
        },
        "pairing": _pairing(score.pairing),
        "alignment": _alignment(score.alignment),
        "protocol": score.protocol.effective(),
        "protocol_changes": sorted(changes_of(score.protocol)),
        "camera": score.camera or None,
        "inputs": {"gt": _input(score.gt), "est": _input(score.est)},
        "notes": list(score.notes),
        "device": score.device,
        "versions": versions(),
        "milliseconds": {name: round(ms, 3) for name, ms in score.milliseconds.items()},
    }


def versions() -> dict[str, str]:
    """Versions of what can move a score; a package run from its source tree counts as "source"."""
    found = {"python": platform.python_version()}
    for package in _VERSIONED:
        try:
            found[package] = _version_of(package)
        except metadata.PackageNotFoundError:
            found[package] = "source"
    return found


def _version_of(package: str) -> str:
    """`metadata.version`, which for one line parses the whole of a long text."""
    lines = (metadata.distribution(package).read_text("METADATA") or "").splitlines()
    stated = (line.removeprefix("Version:").strip() for line in lines if line.startswith("Version:"))
    return next(stated, None) or metadata.version(package)


def _pairing(pairing: tuple[str, float] | None) -> dict[str, Any] | None:
    return None if pairing is None else {"method": pairing[0], "largest_gap_s": pairing[1]}


def _alignment(alignment: Alignment | None) -> dict[str, Any] | None:
    if alignment is None:
        return None
    return {
        "method": alignment.method,
        "scale": alignment.scale,
        "T_gt_est": alignment.T_gt_est.tolist(),
        "pairs": alignment.pairs,
    }


def _no_value(metric: NoValue) -> dict[str, Any]:
    document: dict[str, Any] = {"value": None, "reason": metric.reason}
    if metric.counts:
        document["counts"] = metric.counts
    return document


def _ate(metric: TrajectoryScore | NoValue) -> dict[str, Any]:
    if isinstance(metric, NoValue):
        return _no_value(metric)
    errors = metric.errors["absolute"]
    return {
        "value": errors.translation.rmse,
        "headline": "rmse",
        "unit": "m",
        **errors.translation.as_dict(),
        "rotation_rad": errors.rotation.as_dict(),
        "counts": metric.counts,
    }


def _rpe(metric: TrajectoryScore | NoValue) -> dict[str, Any]:
    if isinstance(metric, NoValue):
        return _no_value(metric)
    steps: dict[str, Any] = {
        unit: {"translation_m": e.translation.as_dict(), "rotation_rad": e.rotation.as_dict()}
        for unit, e in metric.errors.items()
    }
    for unit in ("frames", "metres", "seconds"):
        if unit not in steps:
            steps[unit] = {"value": None, "reason": "no pair of poses is so far apart, or there are no stamps"}
    frames = metric.errors["frames"]
    return {
        "value": frames.translation.rmse,
        "headline": "rmse",
        "unit": "m",
        **frames.translation.as_dict(),
        "rotation_rad": frames.rotation.as_dict(),
        "steps": steps,
        "counts": metric.counts,
    }


def _nearest(metric: NearestScore | NoValue, headline: str) -> dict[str, Any]:
    if isinstance(metric, NoValue):
        return _no_value(metric)
    by_threshold = {f"{t.threshold:g}": t for t in metric.thresholds}
    return {
        "value": getattr(metric.accuracy, headline),
        "headline": headline,
        "unit": "m",
        **metric.accuracy.as_dict(),
        "completeness": metric.completeness.as_dict(),
        "precision": {name: t.precision for name, t in by_threshold.items()},
        "recall": {name: t.recall for name, t in by_threshold.items()},
        "f_score": {name: t.f_score for name, t in by_threshold.items()},
        "voxel_iou": metric.overlap.iou,
        "counts": metric.counts
        | {
            "est_voxels": metric.overlap.est,
            "gt_voxels": metric.overlap.gt,
            "common_voxels": metric.overlap.common,
        },
    }


def _ray(metric: RayScore | NoValue, headline: str) -> dict[str, Any]:
    if isinstance(metric, NoValue):
        return _no_value(metric)
    return {
        "value": getattr(metric.absolute, headline),
        "headline": headline,
        "unit": "m",
        **metric.absolute.as_dict(),
        "relative": metric.relative.as_dict(),
        "counts": metric.counts,
    }


def _input(summary: InputSummary) -> dict[str, Any]:
    return {
        "name": summary.name,
        "kind": summary.kind,
        "facts": summary.facts,
        "notes": list(summary.notes),
    }
