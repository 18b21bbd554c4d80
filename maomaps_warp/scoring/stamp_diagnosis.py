"""Why stamps do not match, and what would help."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.protocol import MatchMethod
from maomaps_warp.scoring.stamp_search import count_matches, inside, nearest, neighbours

#: The bins of the gap histogram and their upper borders, nanoseconds; the last bin is open.
GAP_BIN_LABELS = ("<= 1 ms", "<= 10 ms", "<= 0.1 s", "<= 1 s", "<= 10 s", "> 10 s")
GAP_BIN_EDGES_NS = (10**6, 10**7, 10**8, 10**9, 10**10)

#: The search for a constant offset: at most so many differences of stamps vote, of at most so many estimated
#: stamps; width of the vote's bins, nanoseconds; how many of the fullest bins are tried.
OFFSET_VOTES = 1_000_000
OFFSET_VOTERS = 64
OFFSET_BIN_NS = 10**6
OFFSET_BINS_TRIED = 32

#: An offset is certain if half of the estimated stamps come to lie this near to a ground-truth stamp, as a
#: share of the median ground-truth interval: both then hold the stamps of the same measurements.
CERTAIN_RESIDUAL = 0.02


@dataclass(frozen=True)
class StampDiagnosis:
    """How two sets of stamps lie to each other.

    Attributes:
        gt_range_ns, est_range_ns: first and last stamp, nanoseconds; the estimate's after the offset given.
        gt_poses, est_poses: how many poses each has.
        matches: pairs made with the options given.
        best_offset_s: the `--t-offset` that makes most pairs. Among equals the one with the smallest median
            distance to a ground-truth stamp, then the one nearest to the offset given.
        matches_at_best_offset: pairs made then.
        best_offset_is_certain: the stamps coincide then. If they do not, as many pairs come about at other
            offsets, and the right one must be known from elsewhere.
        gap_histogram: (label, count): distance from each estimated stamp to the nearest ground-truth stamp.
        hints: options that would help, most promising first; empty if nothing is wrong or nothing would help.
    """

    gt_range_ns: tuple[int, int]
    est_range_ns: tuple[int, int]
    gt_poses: int
    est_poses: int
    matches: int
    best_offset_s: float
    matches_at_best_offset: int
    best_offset_is_certain: bool
    gap_histogram: tuple[tuple[str, int], ...]
    hints: tuple[str, ...]

    def __str__(self) -> str:
        gaps = ", ".join(f"{label}: {count}" for label, count in self.gap_histogram)
        offset = f"{_trim(self.best_offset_s)} s: {self.matches_at_best_offset} pairs"
        doubt = "" if self.best_offset_is_certain else ", others fit as well"
        text = (
            f"{self.matches} pairs of {self.est_poses} estimated and {self.gt_poses} ground-truth poses; "
            f"ground truth from {_seconds(self.gt_range_ns[0])} to {_seconds(self.gt_range_ns[1])} s; "
            f"estimate from {_seconds(self.est_range_ns[0])} to {_seconds(self.est_range_ns[1])} s; "
            f"best constant offset {offset}{doubt}; "
            f"distances to the nearest ground-truth stamp: {gaps}"
        )
        return text + (f" (try {', or '.join(self.hints)})" if self.hints else "")


def diagnose_shifted_stamps(
    gt_stamps: NDArray[np.int64],
    stamps: NDArray[np.int64],
    *,
    method: MatchMethod,
    max_gap_ns: int,
    offset_ns: int,
) -> StampDiagnosis:
    """The diagnosis of `gt_stamps`, (N,) int64 ns, and `stamps`, (M,) int64 ns, which include `offset_ns`."""
    counts = np.bincount(
        np.searchsorted(GAP_BIN_EDGES_NS, nearest(gt_stamps, stamps)[1]), minlength=len(GAP_BIN_LABELS)
    )
    matches = count_matches(gt_stamps, stamps, method, max_gap_ns)
    extra_ns = _best_extra_offset(gt_stamps, stamps, method, max_gap_ns)
    matches_then = count_matches(gt_stamps, stamps + extra_ns, method, max_gap_ns)
    best_offset_s = (offset_ns + extra_ns) * 1e-9
    hints = [f"--t-offset {_trim(best_offset_s)}"] if matches_then > matches else []
    if not matches:
        hints += _other_hints(gt_stamps, stamps, method, max_gap_ns)
    return StampDiagnosis(
        gt_range_ns=(int(gt_stamps[0]), int(gt_stamps[-1])),
        est_range_ns=(int(stamps[0]), int(stamps[-1])),
        gt_poses=len(gt_stamps),
        est_poses=len(stamps),
        matches=matches,
        best_offset_s=best_offset_s,
        matches_at_best_offset=matches_then,
        best_offset_is_certain=_coincide(gt_stamps, stamps + extra_ns),
        gap_histogram=tuple(zip(GAP_BIN_LABELS, counts.tolist(), strict=True)),
        hints=tuple(hints),
    )


def _best_extra_offset(
    gt_stamps: NDArray[np.int64], stamps: NDArray[np.int64], method: MatchMethod, max_gap_ns: int
) -> int:
    """The offset, ns on top of the one given, that makes most pairs."""

    def merit(extra_ns: int) -> tuple[int, float, int]:
        moved = stamps + extra_ns
        residual = float(np.median(nearest(gt_stamps, moved)[1]))
        return count_matches(gt_stamps, moved, method, max_gap_ns), -residual, -abs(extra_ns)

    most = len(stamps) if method == "interpolate" else min(len(stamps), len(gt_stamps))
    if merit(0)[0] == most:
        return 0  # everything matches as it is: another offset could look better by chance only
    candidates = {0, int(gt_stamps[0] - stamps[0]), int(gt_stamps[-1] - stamps[-1])}
    candidates |= set(_voted_offsets(gt_stamps, stamps))
    return max(sorted(candidates), key=merit)


def _coincide(gt_stamps: NDArray[np.int64], stamps: NDArray[np.int64]) -> bool:
    if len(gt_stamps) < 2:
        return False
    interval = float(np.median(np.diff(gt_stamps)))
    return float(np.median(nearest(gt_stamps, stamps)[1])) <= CERTAIN_RESIDUAL * interval


def _voted_offsets(gt_stamps: NDArray[np.int64], stamps: NDArray[np.int64]) -> list[int]:
    """Offsets on which many pairs of stamps agree: medians of the fullest bins of pairwise differences."""
    count = min(OFFSET_VOTERS, len(stamps), max(1, OFFSET_VOTES // len(gt_stamps)))
    voters = stamps[np.linspace(0, len(stamps) - 1, count).astype(np.int64)]
    differences = np.sort((gt_stamps[None, :] - voters[:, None]).ravel())
    _, start, votes = np.unique(differences // OFFSET_BIN_NS, return_index=True, return_counts=True)
    fullest = np.argsort(-votes, kind="stable")[:OFFSET_BINS_TRIED]
    return [int(differences[start[b] + votes[b] // 2]) for b in fullest]


def _other_hints(
    gt_stamps: NDArray[np.int64], stamps: NDArray[np.int64], method: MatchMethod, max_gap_ns: int
) -> list[str]:
    """Options other than the offset that would match something where those given match nothing."""
    hints = []
    within = stamps[inside(gt_stamps, stamps)]
    if len(within):
        before, after = neighbours(gt_stamps, within)
        bridged = gt_stamps[after] - gt_stamps[before]
        needed = bridged if method == "interpolate" else nearest(gt_stamps, within)[1]
        # Enough for half of them, rounded up to a millisecond so that the number printed does match.
        hints.append(f"--max-stamp-gap {_trim(math.ceil(np.median(needed) / 10**6) * 1e-3)}")
    other: MatchMethod = "nearest" if method == "interpolate" else "interpolate"
    if count_matches(gt_stamps, stamps, other, max_gap_ns):
        hints.append(f"--match {other}")
    return hints


def _seconds(stamp_ns: int) -> str:
    """Seconds with all nine digits: a float would lose the last ones of a Unix stamp."""
    sign = "-" if stamp_ns < 0 else ""
    return f"{sign}{abs(stamp_ns) // 10**9}.{abs(stamp_ns) % 10**9:09d}"


def _trim(seconds: float) -> str:
    return f"{seconds:.9f}".rstrip("0").rstrip(".")
