"""The score of a merge as tables for people."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from maomaps_warp.model.merge_results import (
    DoubledWalls,
    MergedMapScore,
    MergePlacement,
    MergeScore,
    SourceScore,
)
from maomaps_warp.model.occupancy_results import OccupancyScore
from maomaps_warp.model.results import NoValue
from maomaps_warp.model.statistics import Statistics

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

_STATISTICS = ("mean", "rmse", "median", "std", "p90", "p95", "max")


def merge_tables(score: MergeScore) -> Iterable[RenderableType]:
    """What was merged, whether it succeeded and why, each source, and the merged map."""
    word = {True: "success", False: "failed", None: "success unknown"}[score.is_success]
    yield f"merge         {score.pair} by {score.method}: {word}: {score.verdict}"
    yield f"merged map    {score.merged_map}; device {score.device}"
    if score.placement is not None:
        yield f"align         {_placement(score.placement)}"
    for note in score.notes:
        yield f"note          {note}"
    yield _sources(score.sources)
    if not isinstance(score.ame, NoValue):
        yield "Merged map, metres"
        yield _map(score.ame)
        yield _doubled(score.ame.doubled)
    if not isinstance(score.ame_2d, NoValue):
        yield "Merged occupancy grid, metres in the plane"
        yield _plane(score.ame_2d)
        known, occupied = _share(score.ame_2d.known_iou), _share(score.ame_2d.occupied_iou)
        yield f"IoU of known cells {known}, of occupied cells {occupied}"
    if not isinstance(score.apart, NoValue):
        yield (
            f"Without the merge: mean AME of the sources apart {score.apart.sources_mean:.4f} m; of the sources laid "
            f"on one another unmoved {score.apart.unmoved:.4f} m"
        )


def _placement(placement: MergePlacement) -> str:
    words = {
        "none": "none: the merged map is taken to lie in the ground truth's world",
        "first": "first: the first merged source lies where its run began",
        "best": "best: the best rigid transform",
    }
    text = words[placement.method]
    fit = placement.fit
    if fit is None:
        return text
    if fit.hidden == 0.0:
        return f"{text}; none is better than the first source's start (AME {fit.ame_before:.4f} m)"
    size = f"{fit.translation:.4f} m and {math.degrees(fit.rotation):.3f} deg"
    return (
        f"{text}, {size} from the first source's start: AME {fit.ame_before:.4f} m before, {fit.ame_after:.4f} m "
        f"after; the alignment hides {fit.hidden:.4f} m"
    )


def _table(*columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right", no_wrap=i > 0, overflow="fold")
    return table


def _sources(sources: tuple[SourceScore, ...]) -> Table:
    table = _table("source", "run", "merged", "error m", "error deg", "well placed", "AME alone", "AME merged")
    for source in sources:
        error = source.error
        shown = ("-", "-")
        if source.is_reference:
            shown = ("reference", "reference")
        elif not isinstance(error, NoValue):
            shown = (f"{error.translation:.4f}", f"{math.degrees(error.rotation):.3f}")
        means = [_mean(statistics) for statistics in (source.ame_alone, source.ame_merged)]
        table.add_row(source.name, source.run, _yes(source.is_merged), *shown, _yes(source.is_success), *means)
    return table


def _map(ame: MergedMapScore) -> Table:
    table = _table("distance", *_STATISTICS, "n")
    _add(table, "AME, merged map to gt", ame.accuracy)
    _add(table, "inside the overlap", ame.inside)
    _add(table, "outside the overlap", ame.outside)
    _add(table, "completeness, gt to merged map", ame.completeness)
    return table


def _plane(score: OccupancyScore) -> Table:
    table = _table("distance", *_STATISTICS, "n")
    _add(table, "AME, occupied cells to gt", score.ame)
    return table


def _share(share: float | None) -> str:
    return "-" if share is None else f"{share:.4f}"


def _add(table: Table, name: str, statistics: Statistics | NoValue) -> None:
    if isinstance(statistics, NoValue):
        table.add_row(f"{name}: {statistics.reason}", *["-"] * len(_STATISTICS), "0")
    else:
        values = [f"{getattr(statistics, s):.4f}" for s in _STATISTICS]
        table.add_row(name, *values, str(statistics.count))


def _doubled(doubled: DoubledWalls | NoValue) -> str:
    if isinstance(doubled, NoValue):
        return f"Doubled walls: -, {doubled.reason}"
    rest = (
        f"of {doubled.in_overlap} in the overlap {doubled.undecided} have no plane, for {doubled.gt_has_more} the "
        f"ground truth has more surfaces, for {doubled.gt_has_none} none"
    )
    if doubled.share is None:
        return f"Doubled walls: -, no voxel could be decided; {rest}"
    return (
        f"Doubled walls: {100.0 * doubled.share:.2f} %, {doubled.doubled} of {doubled.decided} decided voxels have a "
        f"second surface within {doubled.distance:g} m; {rest}"
    )


def _mean(statistics: Statistics | NoValue) -> str:
    return "-" if isinstance(statistics, NoValue) else f"{statistics.mean:.4f}"


def _yes(value: bool | None) -> str:
    return {True: "yes", False: "no", None: "-"}[value]
