"""What comparing two maps of the ground finds."""

from __future__ import annotations

from dataclasses import dataclass

from maomaps_warp.model.results import InputSummary, NoValue
from maomaps_warp.model.statistics import Statistics


@dataclass(frozen=True)
class OccupancyScore:
    """Errors of an estimated map of the ground.

    Attributes:
        ame: distances from every estimated occupied cell to the nearest ground-truth one, metres; the mean is the
            original program's 2D AME.
        known_iou: of the cells that are known, free or occupied; None if neither map knows one.
        occupied_iou: of the occupied cells; None if there are none.
        counts: `est_` and `gt_` `occupied`, `free` and `unknown`, each on the map's own cells;
            `est_occupied_on_gt_unknown` and `est_occupied_outside_gt`, by their centres; and on the ground truth's
            cells `known_common`, `known_any`, `occupied_common`, `occupied_any`.
    """

    ame: Statistics | NoValue
    known_iou: float | None
    occupied_iou: float | None
    counts: dict[str, int]


@dataclass(frozen=True)
class OccupancyReport:
    """A score of two maps of the ground with what it was made of.

    Attributes:
        score: the errors.
        gt, est: the inputs.
        ground: how maps were projected; empty where both came as maps of the ground.
        milliseconds: wall time of each stage.
    """

    score: OccupancyScore
    gt: InputSummary
    est: InputSummary
    ground: str
    milliseconds: dict[str, float]
