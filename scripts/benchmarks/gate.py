"""Whether what was measured is good enough: against a baseline measured before, or the goals where there is none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from benchmarks.goals import GOALS
from benchmarks.rows import Row

#: A ratio may fall to this share of the baseline's. Ratios of one machine mostly move by a fifth between runs, and by a
#: third between processors (vector width, caches); what falls further has been broken.
BASELINE_SHARE = 0.6
#: Limits in seconds are for a machine like the baseline's; others get this factor: half the clock, half the vectors.
SLOWER_MACHINE = 4.0
#: Memory is no matter of speed: it may not exceed its limit, nor grow by more than this factor while recordings grow
#: tenfold: a bag's index of its messages does, frames do not.
MEMORY_LIMIT_MB, MEMORY_GROWTH = 600.0, 1.25


def failures(rows: Sequence[Row], baseline: Mapping[str, float]) -> list[str]:
    """Why the gate is shut, one sentence each; none if it is open.

    Args:
        rows: what was measured.
        baseline: ratios by `Row.key`; rows that it lacks are held against the goals. What the baseline itself misses
            keeps no gate shut: the table shows it.
    """
    found = []
    if not any(
        row.ratio is not None or GOALS[row.work].limit is not None or GOALS[row.work].unit == "MB" for row in rows
    ):
        found.append("nothing was measured that could be judged: are the peers installed?")
    for row in rows:
        goal, ratio = GOALS[row.work], row.ratio
        before = baseline.get(row.key)
        if ratio is not None and goal.ratio is not None and before is None and ratio < goal.ratio:
            found.append(f"{row.key}: {ratio:.2f}x is below the goal of {goal.ratio:g}x")
        if ratio is not None and before is not None and ratio < BASELINE_SHARE * before:
            found.append(f"{row.key}: {ratio:.2f}x is below {BASELINE_SHARE:g} of the baseline's {before:.2f}x")
        if goal.limit is not None and row.value > SLOWER_MACHINE * goal.limit:
            found.append(f"{row.key}: {row.value:.2f} s exceeds {SLOWER_MACHINE:g} times the goal of {goal.limit:g} s")
        if goal.unit == "MB":
            found += _memory(row)
    return found


def _memory(row: Row) -> list[str]:
    """`ours` holds the peak of each recording, shortest first."""
    found = []
    if max(row.ours) > MEMORY_LIMIT_MB:
        found.append(f"{row.key}: {max(row.ours):.0f} MB exceed {MEMORY_LIMIT_MB:g} MB")
    if row.ours[-1] > MEMORY_GROWTH * row.ours[0]:
        found.append(f"{row.key}: memory grows with the recording, from {row.ours[0]:.0f} to {row.ours[-1]:.0f} MB")
    return found


def ratios(rows: Sequence[Row]) -> dict[str, float]:
    """What a baseline keeps."""
    return {row.key: round(row.ratio, 3) for row in rows if row.ratio is not None}
