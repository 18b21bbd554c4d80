"""A check of a recording as tables for people and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from maomaps_warp.model.check_results import Candidate, DepthUnit, RecordingCheck, UpAxis
from maomaps_warp.report.json_report import versions

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

#: Raised when a field changes its meaning or goes away.
SCHEMA = 1


def check_tables(found: RecordingCheck) -> Iterable[RenderableType]:
    """What was checked, the conventions with the verdict, depth, stamps, and what will trouble other commands."""
    yield f"recording     {found.name} ({found.kind})"
    yield f"depth         {found.frames_source}: {found.frames} frames; {found.camera}"
    yield f"poses         {found.poses_source}; read as {found.declared}, which {_said(found.declared_by)}"
    for note in found.notes:
        yield f"note          {note}"
    if found.proof.candidates:
        pairs = found.proof.candidates[0].pairs
        yield f"\nWhat the poses mean: depth carried between {pairs} pairs, of {found.proof.frames} frames with poses"
        yield _conventions(found.proof.candidates)
    yield f"verdict       {_verdict(found)}"
    yield f"why           {found.proof.reason}"
    yield f"rule          {found.rule}"
    yield f"depth unit    {_depth_unit(found.depth_unit)}"
    yield f"world's up    {_up(found.up)}"
    if found.stamps:
        yield "\nStamps"
        yield _stamps(found)
    if found.color_gaps:
        gaps = found.color_gaps
        yield (
            f"colours       {1e3 * gaps.median_s:.1f} ms from their depth images in the median, "
            f"{1e3 * gaps.largest_s:.1f} ms at most; {gaps.without} depth images without, at a limit of "
            f"{1e3 * gaps.limit_s:g} ms"
        )
    yield f"frames        {found.frames_without_pose} of {found.frames} without a pose"
    for finding in found.findings or ("none",):
        yield f"finding       {finding}"


def check_document(found: RecordingCheck) -> dict[str, Any]:
    """The whole check as plain JSON values, metres, radians, seconds; all but `milliseconds` is reproducible."""
    unit = asdict(found.depth_unit)
    unit["agreements"] = {f"{factor:g}": share for factor, share in found.depth_unit.agreements.items()}
    return {
        "schema": SCHEMA,
        "name": found.name,
        "kind": found.kind,
        "camera": found.camera,
        "frames_source": found.frames_source,
        "poses_source": found.poses_source,
        "declared": {"pose_frame": found.declared, "by": found.declared_by, "is_contradicted": found.is_contradicted},
        "convention": {
            "is_clear": found.proof.is_clear,
            "best": found.proof.best.name if found.proof.best else None,
            "reason": found.proof.reason,
            "rule": found.rule,
            "frames": found.proof.frames,
            "frames_without_pose": found.proof.frames_without_pose,
            "candidates": [_candidate(candidate) for candidate in found.proof.candidates],
        },
        "depth_unit": {name: _number(value) for name, value in unit.items()},
        "up": asdict(found.up) if found.up else None,
        "frames": found.frames,
        "frames_without_pose": found.frames_without_pose,
        "stamps": [asdict(facts) | {"rate_hz": facts.rate_hz} for facts in found.stamps],
        "color_gaps": asdict(found.color_gaps) if found.color_gaps else None,
        "jumps": [asdict(jump) for jump in found.jumps],
        "findings": list(found.findings),
        "notes": list(found.notes),
        "versions": versions(),
        "milliseconds": {name: round(ms, 3) for name, ms in found.milliseconds.items()},
    }


def _said(declared_by: str) -> str:
    return "is only what such sources usually mean" if declared_by == "nobody" else f"{declared_by} says"


def _verdict(found: RecordingCheck) -> str:
    best = found.proof.best
    if best is None:
        return "NOT CLEAR what the poses mean; --pose-frame NAME declares it to other commands"
    contradicted = f"; NOT {found.declared}" if found.is_contradicted else ""
    return f"clear: --pose-frame {best.name}{contradicted} ({best.meaning})"


def _conventions(candidates: tuple[Candidate, ...]) -> Table:
    searched = ["yaw rad"] if any(one.yaw_found_rad is not None for one in candidates) else []
    columns = ("agreement", "of landed", "landed", "residual m", "residual %", "behind in")
    table = _table("convention", *columns, *searched)
    for one in candidates:
        same = f" = {', '.join(one.equivalents)}" if one.equivalents else ""
        yaw = "" if one.yaw_found_rad is None else f"{one.yaw_found_rad:+.3f} +- {one.yaw_spread_rad:.3f}"
        cells = (
            one.convention.name + same,
            f"{100.0 * one.agreement:.1f} %",
            f"{100.0 * one.agreement_of_landed:.1f} %",
            f"{100.0 * one.landed:.1f} %",
            f"{one.residual_m:.3f}",
            f"{100.0 * one.residual_share:.1f}",
            f"{100.0 * one.ahead:.0f} %",
            yaw,
        )
        table.add_row(*cells[: len(table.columns)])
    return table


def _depth_unit(unit: DepthUnit) -> str:
    if math.isnan(unit.median_m):
        return "no depth at all"
    extent = f"{unit.nearest_m:.2f} to {unit.farthest_m:.2f} m, {unit.missing:.1%} missing"
    said = {
        True: "as declared",
        False: f"WRONG, depth is to be multiplied by {unit.factor:g}",
        None: "not proved",
    }[unit.fits]
    return f"{said}: median {unit.median_m:.2f} m, {extent}; {unit.reason}"


def _up(up: UpAxis | None) -> str:
    if up is None:
        return "unknown"
    agreement = f"{math.degrees(up.away_rad):.0f} degrees from the cameras' mean up, which agree to {up.agreement:.2f}"
    return f"{up.axis} ({agreement})" if up.is_clear else f"not clear, {up.axis} is nearest ({agreement})"


def _stamps(found: RecordingCheck) -> Table:
    table = _table("stream", "count", "rate Hz", "duration s", "median gap s", "largest gap s", "at s", "missing")
    for facts in found.stamps:
        table.add_row(
            facts.what,
            str(facts.count),
            f"{facts.rate_hz:.2f}",
            f"{1e-9 * (facts.last_ns - facts.first_ns):.3f}",
            f"{facts.median_gap_s:.4f}",
            f"{facts.largest_gap_s:.4f}",
            f"{facts.largest_at_s:.3f}",
            f"{facts.missing} in {facts.gaps} gaps" if facts.gaps else "0",
        )
    return table


def _table(*columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right", no_wrap=i > 0)
    return table


def _candidate(one: Candidate) -> dict[str, Any]:
    numbers = {name: _number(value) for name, value in vars(one).items() if isinstance(value, float | int)}
    return {"name": one.convention.name, "equivalents": list(one.equivalents), **numbers}


def _number(value: Any) -> Any:
    """JSON has no NaN."""
    return None if isinstance(value, float) and math.isnan(value) else value
