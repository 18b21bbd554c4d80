"""Searching sorted stamps: the arithmetic under pairing in time.

Stamps are (N,) int64 nanoseconds, ascending, never empty.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.protocol import MatchMethod


def neighbours(among: NDArray[np.int64], stamps: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices into `among` of the last stamp <= and the first stamp >= each of `stamps`, clamped at the ends.

    The two have one stamp where a stamp of `among` is hit exactly, and are one where a stamp lies outside.
    """
    before = np.maximum(np.searchsorted(among, stamps, side="right") - 1, 0)
    after = np.minimum(np.searchsorted(among, stamps, side="left"), len(among) - 1)
    return before, after


def nearest(among: NDArray[np.int64], stamps: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Index into `among` of the stamp nearest to each of `stamps` (of several the earliest), and its distance."""
    before, after = neighbours(among, stamps)
    index = np.where(np.abs(stamps - among[before]) <= np.abs(among[after] - stamps), before, after)
    index = np.searchsorted(among, among[index], side="left")  # of repeated stamps the first
    return index, np.asarray(np.abs(among[index] - stamps))


def inside(among: NDArray[np.int64], stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of `stamps` lie within the range of `among`, borders included."""
    return np.asarray((stamps >= among[0]) & (stamps <= among[-1]))


def count_matches(gt_stamps: NDArray[np.int64], stamps: NDArray[np.int64], method: MatchMethod, max_gap_ns: int) -> int:
    """How many pairs `match_stamps` makes of these stamps."""
    if method == "interpolate":
        before, after = neighbours(gt_stamps, stamps)
        return int((inside(gt_stamps, stamps) & (gt_stamps[after] - gt_stamps[before] <= max_gap_ns)).sum())
    few, many = (stamps, gt_stamps) if len(stamps) <= len(gt_stamps) else (gt_stamps, stamps)
    return int((nearest(many, few)[1] <= max_gap_ns).sum())
