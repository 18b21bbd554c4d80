"""A score as tables for people."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from maomaps_warp.model.results import InputSummary, NearestScore, NoValue, Score
from maomaps_warp.model.statistics import Statistics
from maomaps_warp.protocol import changes_of

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

_STATISTICS = ("rmse", "mean", "median", "std", "p90", "p95", "max")
_PAIRED = {"interpolate": "gt interpolated", "nearest": "nearest stamp", "index": "by index"}
_UNIT_OF_STEP = {"frames": "frame(s)", "metres": "m", "seconds": "s"}


def score_tables(score: Score) -> Iterable[RenderableType]:
    """What was scored, the headline of each metric with its support, every statistic, and every count."""
    shown = {name: value for name, value in changes_of(score.protocol).items() if name != "align"}
    changes = "".join(f", {name} = {value}" for name, value in shown.items())
    yield f"protocol      {score.protocol.name}{changes}; align {_alignment(score)}; device {score.device}"
    yield _input("ground truth", score.gt)
    yield _input("estimate", score.est)
    if score.camera:
        yield f"camera        {score.camera}"
    for note, side in _notes(score).items():
        yield f"note          {side}{note}"
    yield _headlines(score)
    if any(not isinstance(m, NoValue) for m in (score.ate, score.rpe, score.ame_nn, score.ame_ray)):
        yield "All statistics"
        yield _all_statistics(score)
    if not isinstance(score.ame_nn, NoValue):
        overlap = score.ame_nn.overlap
        yield (
            f"Map overlap: voxel IoU {overlap.iou:.4f}, {overlap.common} voxels common to {overlap.est} estimated and "
            f"{overlap.gt} of the ground truth"
        )
        yield _shares(score.ame_nn)
    if "total" in score.ame_ray.counts:
        counts = score.ame_ray.counts
        yield (
            f"What became of the predicted map elements: {counts['correspondences']} correspondences from "
            f"{counts['poses']} poses"
        )
        yield _elements(counts)


def _notes(score: Score) -> dict[str, str]:
    """Each note once, with the side it is about."""
    notes = dict.fromkeys(score.gt.notes, "ground truth: ") | dict.fromkeys(score.est.notes, "estimate: ")
    both = set(score.gt.notes) & set(score.est.notes)
    return notes | dict.fromkeys([n for n in score.gt.notes if n in both], "") | dict.fromkeys(score.notes, "")


def _alignment(score: Score) -> str:
    if score.alignment is None:
        return f"{score.protocol.align} (not found)"
    found = f", scale {score.alignment.scale:.6g}" if score.alignment.method == "sim3" else ""
    return score.alignment.method + found


def _input(label: str, summary: InputSummary) -> str:
    facts = dict(summary.facts)
    shown = [f"{facts.pop('poses')} poses"] if "poses" in facts else []
    for name, unit in (("path_length_m", "m"), ("duration_s", "s")):
        if name in facts:
            shown.append(f"{facts.pop(name):.2f} {unit}")
    shown += [f"{value} {name.replace('_', ' ')}" for name, value in facts.items()]
    facts_shown = f": {', '.join(shown)}" if shown else ""
    return f"{label:<13} {summary.name} ({summary.kind}){facts_shown}"


def _table(*columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right", no_wrap=True)
    return table


def _headlines(score: Score) -> Table:
    table = _table("metric", "value", "unit", "support")
    table.columns[-1].justify = "left"
    table.columns[-1].no_wrap = False
    headline = score.protocol.headline
    ate, rpe, nearest, ray = score.ate, score.rpe, score.ame_nn, score.ame_ray
    dropped = int(score.est.facts.get("dropped_nonfinite", 0))
    if isinstance(ate, NoValue):
        table.add_row("ATE", "-", "m", _brief(ate.reason))
    else:
        paired = f", {_PAIRED[score.pairing[0]]}" if score.pairing else ""
        support = f"{ate.counts['matched']} of {ate.counts['poses']} poses{paired}"
        table.add_row("ATE rmse", f"{ate.errors['absolute'].translation.rmse:.4f}", "m", support)
    if isinstance(rpe, NoValue):
        table.add_row("RPE", "-", "m", _brief(rpe.reason))
    else:
        table.add_row(
            f"RPE rmse, over {score.protocol.rpe_frames} frame(s)",
            f"{rpe.errors['frames'].translation.rmse:.4f}",
            "m",
            f"{rpe.counts['pairs_frames']} pairs of poses",
        )
    if isinstance(nearest, NoValue):
        table.add_row("AME, nearest neighbour", "-", "m", _brief(nearest.reason))
    else:
        table.add_row(
            f"AME {headline}, nearest neighbour",
            f"{getattr(nearest.accuracy, headline):.4f}",
            "m",
            f"{nearest.counts['est_points']} of {nearest.counts['est_points'] + dropped} map points",
        )
    if isinstance(ray, NoValue):
        table.add_row("AME, camera rays", "-", "m", _brief(ray.reason))
    else:
        table.add_row(
            f"AME {headline}, camera rays",
            f"{getattr(ray.absolute, headline):.4f}",
            "m",
            f"{ray.counts['associated']} of {ray.counts['total']} map elements",
        )
    return table


def _brief(reason: str) -> str:
    """The beginning of a reason; the whole of it stands on stderr and in the JSON."""
    return reason if len(reason) <= 80 else reason[:80].rsplit(" ", 1)[0] + " ..."


def _all_statistics(score: Score) -> Table:
    table = _table("metric", "unit", *_STATISTICS, "n")

    def add(name: str, statistics: Statistics, unit: str = "m", factor: float = 1.0) -> None:
        values = [f"{factor * getattr(statistics, s):.4f}" for s in _STATISTICS]
        table.add_row(name, unit, *values, str(statistics.count))

    if not isinstance(score.ate, NoValue):
        add("ATE translation", score.ate.errors["absolute"].translation)
        add("ATE rotation", score.ate.errors["absolute"].rotation, "deg", math.degrees(1.0))
    if not isinstance(score.rpe, NoValue):
        for unit, shown in _UNIT_OF_STEP.items():
            step = f"RPE {getattr(score.protocol, f'rpe_{unit}'):g} {shown}"
            if unit in score.rpe.errors:
                add(f"{step} translation", score.rpe.errors[unit].translation)
                add(f"{step} rotation", score.rpe.errors[unit].rotation, "deg", math.degrees(1.0))
            elif f"pairs_{unit}" in score.rpe.counts:
                table.add_row(f"{step}: no such pair", "", *[""] * len(_STATISTICS), "0")
    if not isinstance(score.ame_nn, NoValue):
        add("AME nn, estimate to gt", score.ame_nn.accuracy)
        add("completeness, gt to estimate", score.ame_nn.completeness)
    if not isinstance(score.ame_ray, NoValue):
        add("AME rays, abs (world)", score.ame_ray.absolute)
        add("AME rays, rel (camera)", score.ame_ray.relative)
    return table


def _shares(nearest: NearestScore) -> Table:
    table = _table("within", "precision", "recall", "F-score")
    for t in nearest.thresholds:
        table.add_row(f"{t.threshold:g} m", f"{t.precision:.4f}", f"{t.recall:.4f}", f"{t.f_score:.4f}")
    return table


def _elements(counts: dict[str, int]) -> Table:
    table = _table("class", "elements", "share")
    total = max(1, counts["total"])
    for name in ("associated", "out_of_view", "occluded", "no_ground_truth", "total"):
        table.add_row(name.replace("_", " "), str(counts[name]), f"{100.0 * counts[name] / total:.1f} %")
    return table
