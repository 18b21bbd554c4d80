"""A score of two maps of the ground, as tables and as JSON."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from maomaps_warp.model.occupancy_results import OccupancyReport
from maomaps_warp.model.results import InputSummary, NoValue
from maomaps_warp.report.json_report import versions

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

#: Raised when a field changes its meaning or goes away.
SCHEMA = 1

_STATISTICS = ("mean", "rmse", "median", "std", "p90", "p95", "max")
_NOTHING_KNOWN = "neither map has such a cell"


def occupancy_document(report: OccupancyReport) -> dict[str, Any]:
    """The whole result as plain JSON values, metres; everything except `milliseconds` is the same for the same input.

    A metric without data has "value": null and its reason.
    """
    score = report.score
    if isinstance(score.ame, NoValue):
        ame: dict[str, Any] = {"value": None, "reason": score.ame.reason}
    else:
        ame = {"value": score.ame.mean, "headline": "mean", "unit": "m", **score.ame.as_dict()}
    return {
        "schema": SCHEMA,
        "metrics": {"ame_2d": ame, "known_iou": _iou(score.known_iou), "occupied_iou": _iou(score.occupied_iou)},
        "counts": score.counts,
        "ground": report.ground or None,
        "inputs": {"gt": _input(report.gt), "est": _input(report.est)},
        "versions": versions(),
        "milliseconds": {name: round(ms, 3) for name, ms in report.milliseconds.items()},
    }


def occupancy_tables(report: OccupancyReport) -> Iterable[RenderableType]:
    """What was compared, the 2D AME and the shares with their support, and what became of the cells."""
    for label, side in (("ground truth", report.gt), ("estimate", report.est)):
        size = f"{side.facts['columns']} x {side.facts['rows']} cells of {side.facts['resolution_m']:g} m"
        yield f"{label:<13} {side.name} ({side.kind}): {size}"
        for note in side.notes:
            yield f"note          {label}: {note}"
    if report.ground:
        yield f"ground        {report.ground}"
    yield _headlines(report)
    if not isinstance(report.score.ame, NoValue):
        yield _statistics(report)
    counts = report.score.counts
    yield _cells(counts)
    yield (
        f"Of the estimate's occupied cells {counts['est_occupied_on_gt_unknown']} lie where the ground truth is "
        f"unknown, {counts['est_occupied_outside_gt']} outside of it"
    )


def _iou(value: float | None) -> dict[str, Any]:
    return {"value": value} if value is not None else {"value": None, "reason": _NOTHING_KNOWN}


def _input(side: InputSummary) -> dict[str, Any]:
    return {"name": side.name, "kind": side.kind, "facts": side.facts, "notes": list(side.notes)}


def _table(*columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left", no_wrap=True)
    return table


def _headlines(report: OccupancyReport) -> Table:
    score, counts = report.score, report.score.counts
    table = _table("metric", "value", "unit", "support")
    table.columns[-1].justify = "left"
    table.columns[-1].no_wrap = False
    if isinstance(score.ame, NoValue):
        table.add_row("2D AME", "-", "m", score.ame.reason)
    else:
        table.add_row("2D AME mean", f"{score.ame.mean:.4f}", "m", f"{score.ame.count} estimated occupied cells")
    for name, value in (("known", score.known_iou), ("occupied", score.occupied_iou)):
        support = f"{counts[f'{name}_common']} of {counts[f'{name}_any']} cells of the ground truth's size"
        table.add_row(f"IoU of {name} cells", "-" if value is None else f"{value:.4f}", "", support)
    return table


def _statistics(report: OccupancyReport) -> Table:
    assert not isinstance(report.score.ame, NoValue)
    table = _table("metric", "unit", *_STATISTICS, "n")
    values = [f"{getattr(report.score.ame, name):.4f}" for name in _STATISTICS]
    table.add_row("2D AME, estimate to gt", "m", *values, str(report.score.ame.count))
    return table


def _cells(counts: dict[str, int]) -> Table:
    table = _table("cells", "occupied", "free", "unknown")
    for label, side in (("ground truth", "gt"), ("estimate", "est")):
        table.add_row(label, *(str(counts[f"{side}_{kind}"]) for kind in ("occupied", "free", "unknown")))
    return table
