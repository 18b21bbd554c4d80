"""The score of a merge as JSON, and what a table of merges takes from such documents."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from maomaps_warp.errors import InputError
from maomaps_warp.model.merge_results import (
    DoubledWalls,
    MergedMapScore,
    MergePlacement,
    MergeScore,
    SourceScore,
    TransformError,
)
from maomaps_warp.model.occupancy_results import OccupancyScore
from maomaps_warp.model.results import NoValue
from maomaps_warp.model.statistics import Statistics
from maomaps_warp.report.json_report import versions

#: What tells such a document from others.
KIND = "merge score"
#: Raised when a field changes its meaning or goes away.
SCHEMA = 1


@dataclass(frozen=True)
class MergeEntry:
    """One merge in a table.

    Attributes:
        pair, method: its row and its columns.
        is_success: None if it is not known.
        ame: mean AME, metres; None if there is none.
        is_2d: the AME is one of occupancy grids.
    """

    pair: str
    method: str
    is_success: bool | None
    ame: float | None
    is_2d: bool


def merge_document(score: MergeScore) -> dict[str, Any]:
    """The whole result as plain JSON values, metres and radians.

    What has no number has "value": null and its reason; everything except `milliseconds` is the same for the same
    input.
    """
    rule = score.rule
    apart = {"value": None, "reason": score.apart.reason} if isinstance(score.apart, NoValue) else asdict(score.apart)
    return {
        "kind": KIND,
        "schema": SCHEMA,
        "sample": score.sample,
        "pair": score.pair,
        "method": score.method,
        "success": score.is_success,
        "verdict": score.verdict,
        "success_rule": {"max_m": rule.max_m, "max_rad": rule.max_rad, "max_ame": rule.max_ame},
        "merged_map": score.merged_map,
        "voxel_size": score.voxel_size,
        "alignment": None if score.placement is None else _placement(score.placement),
        "sources": [_source(source) for source in score.sources],
        "metrics": {"ame": _map(score.ame), "ame_2d": _plane(score.ame_2d)},
        "without_merge": apart,
        "notes": list(score.notes),
        "device": score.device,
        "versions": versions(),
        "milliseconds": {name: round(ms, 3) for name, ms in score.milliseconds.items()},
    }


def merge_entry(where: str, document: object) -> MergeEntry:
    """What a table shows of a document that `merge_document` made.

    Args:
        where: its file, for messages.
        document: parsed JSON.

    Raises:
        InputError: it is something else, or of another schema.
    """
    hint = "give files that `maomaps-warp score-merge --json` wrote"
    if not isinstance(document, dict) or document.get("kind") != KIND:
        raise InputError(where, "is not the score of a merge", hint)
    if document.get("schema") != SCHEMA:
        raise InputError(where, f"schema {document.get('schema')!r}, this version reads {SCHEMA}", "score it again")
    try:
        found = {name: document["metrics"][name]["value"] for name in ("ame", "ame_2d")}
        pair, method, success = document["pair"], document["method"], document["success"]
    except (KeyError, TypeError) as error:
        raise InputError(where, f"is damaged: {error}", hint) from None
    is_known = isinstance(pair, str) and isinstance(method, str) and isinstance(success, bool | None)
    if not is_known or not all(value is None or _is_distance(value) for value in found.values()):
        raise InputError(where, "is damaged: a value is of another type", hint)
    is_2d = found["ame"] is None and found["ame_2d"] is not None
    return MergeEntry(pair, method, success, found["ame_2d" if is_2d else "ame"], is_2d)


def _is_distance(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and value >= 0


def _placement(placement: MergePlacement) -> dict[str, Any]:
    fit = None if placement.fit is None else asdict(placement.fit) | {"hidden": placement.fit.hidden}
    return {"method": placement.method, "T_gt_merged": placement.T_gt_merged.tolist(), "fit": fit}


def _source(source: SourceScore) -> dict[str, Any]:
    return {
        "name": source.name,
        "run": source.run,
        "merged": source.is_merged,
        "reference": source.is_reference,
        "success": source.is_success,
        "transform_error": _error(source.error),
        "ame_alone": _distances(source.ame_alone),
        "ame_merged": _distances(source.ame_merged),
    }


def _no_value(value: NoValue) -> dict[str, Any]:
    return {"value": None, "reason": value.reason}


def _error(error: TransformError | NoValue) -> dict[str, Any]:
    if isinstance(error, NoValue):
        return _no_value(error)
    return {"translation_m": error.translation, "rotation_rad": error.rotation, "planar": error.is_planar}


def _distances(statistics: Statistics | NoValue) -> dict[str, Any]:
    if isinstance(statistics, NoValue):
        return _no_value(statistics)
    return {"value": statistics.mean, "headline": "mean", "unit": "m", **statistics.as_dict()}


def _map(ame: MergedMapScore | NoValue) -> dict[str, Any]:
    if isinstance(ame, NoValue):
        return _no_value(ame)
    return {
        **_distances(ame.accuracy),
        "completeness": ame.completeness.as_dict(),
        "inside_overlap": _distances(ame.inside),
        "outside_overlap": _distances(ame.outside),
        "doubled_walls": _doubled(ame.doubled),
        "counts": ame.counts,
    }


def _doubled(doubled: DoubledWalls | NoValue) -> dict[str, Any]:
    if isinstance(doubled, NoValue):
        return _no_value(doubled)
    document: dict[str, Any] = {"value": doubled.share, **asdict(doubled)}
    if doubled.share is None:
        document["reason"] = "no voxel could be decided"
    return document


def _plane(score: OccupancyScore | NoValue) -> dict[str, Any]:
    if isinstance(score, NoValue):
        return _no_value(score)
    return {
        **_distances(score.ame),
        "known_iou": score.known_iou,
        "occupied_iou": score.occupied_iou,
        "counts": score.counts,
    }
