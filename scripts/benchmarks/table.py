"""The measured rows as a table in Markdown, for the terminal and for `docs/performance.md`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.goals import GOALS
from benchmarks.rows import Row, Skipped

_HEAD = ("work", "peer", "threads", "ours", "peer's", "ratio", "least..greatest", "at least", "aim")


def table(rows: Sequence[Row], skipped: Sequence[Skipped] = ()) -> str:
    """All rows, then sizes and agreement of each, then what was left out and why."""
    lines = [_line(_HEAD), _line(["---"] * len(_HEAD)), *(_line(_cells(row)) for row in rows)]
    lines += ["", *(f"- {_name(row)}: {row.sizes}; {row.agreement}" for row in rows)]
    lines += [f"- {entry.work}: left out: {entry.reason}" for entry in skipped]
    return "\n".join(lines)


def _cells(row: Row) -> tuple[str, ...]:
    goal, spread = GOALS[row.work], row.spread
    # Memory is measured once for each length of a recording: the worst counts.
    value = max(row.ours) if goal.unit == "MB" else row.value
    theirs = "" if row.ratio is None else _quantity(row.value * row.ratio, goal.unit)
    if spread is None:
        between = f"{_quantity(min(row.ours), goal.unit)}..{_quantity(max(row.ours), goal.unit)}"
    else:
        between = f"{_ratio(spread[0])}..{_ratio(spread[1])}"
    return (
        row.work,
        row.peer,
        str(row.threads),
        _quantity(value, goal.unit),
        theirs,
        "" if row.ratio is None else _ratio(row.ratio),
        between,
        _target(goal.ratio, goal.limit, goal.unit),
        _target(goal.ratio_aim, goal.limit_aim, goal.unit),
    )


def _name(row: Row) -> str:
    return f"{row.work} ({row.peer})" if row.peer else row.work


def _target(ratio: float | None, limit: float | None, unit: str) -> str:
    parts = [] if ratio is None else [_ratio(ratio)]
    return "; ".join(parts if limit is None else [*parts, _quantity(limit, unit)])


def _ratio(value: float) -> str:
    return f"{value:.0f}x" if value >= 20 else f"{value:.1f}x" if value >= 1 else f"{value:.2f}x"


def _quantity(value: float, unit: str) -> str:
    if unit == "MB":
        return f"{value:.0f} MB"
    if value >= 1:
        return f"{value:.2f} s"
    return f"{1e3 * value:.0f} ms" if value >= 0.02 else f"{1e3 * value:.1f} ms"


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
