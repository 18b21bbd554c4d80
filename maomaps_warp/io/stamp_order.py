"""The one rule about the order of a trajectory's stamps, for text files and bags alike."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError

#: Real recordings repeat a stamp now and then, with two poses a millimetre apart (once in 20957 poses of TUM's
#: fr2_desk, 4 times in 807 of an EuRoC run). More than this share of repeated stamps means wrong stamps.
MAX_REPEATED_SHARE = 0.01


def check_stamp_order(
    stamps_ns: NDArray[np.int64],
    T: NDArray[np.float64],
    where_of: Callable[[int], str],
    *,
    drop_copies: bool = False,
) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Which poses to keep, if their stamps ascend.

    A few repeated stamps are kept, as evo keeps them.

    Args:
        stamps_ns: (N,) int64, nanoseconds.
        T: (N, 4, 4) float64, the poses, in any frame.
        where_of: the place of stamp i, for messages.
        drop_copies: drop every pose that repeats the one before it, stamp and all. Nodes publish a pose again and
            again until they have a new one; a file with copies is faulty.

    Returns:
        Indices of the poses to keep, ascending; and notes on what was dropped and what repeats.

    Raises:
        InputError: a stamp comes after a later one, or more than MAX_REPEATED_SHARE of them repeat.
    """
    steps = np.diff(stamps_ns)
    if (steps < 0).any():
        hint = "sort the poses by their stamps; do two nodes publish here, or was a bag played in a loop?"
        raise _error(stamps_ns, steps < 0, "comes after a later one", hint, where_of)
    is_copy = drop_copies & (steps == 0) & (T[1:] == T[:-1]).all(axis=(1, 2))
    repeats = (steps == 0) & ~is_copy
    copies, repeated = int(is_copy.sum()), int(repeats.sum())
    if repeated > MAX_REPEATED_SHARE * (len(stamps_ns) - copies):
        raise _error(stamps_ns, repeats, "stands twice", "keep one pose a stamp", where_of)
    notes: tuple[str, ...] = ()
    if copies:
        notes += (f"{copies} of {len(stamps_ns)} poses repeat the one before, stamp and all, and were dropped",)
    if repeated:
        first = where_of(int(np.flatnonzero(repeats)[0]) + 1)
        found = f"{repeated} of {len(stamps_ns)} poses have the stamp of the pose before"
        notes += (f"{found}; all kept (first: {first})",)
    return np.flatnonzero(np.concatenate([[True], ~is_copy])), notes


def seconds_text(stamp_ns: int) -> str:
    """A stamp in seconds with 9 decimals, exactly."""
    seconds, rest = divmod(abs(stamp_ns), 10**9)
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{rest:09d}"


def _error(
    stamps_ns: NDArray[np.int64], is_bad: NDArray[np.bool_], found: str, hint: str, where_of: Callable[[int], str]
) -> InputError:
    """An error about the stamps i + 1 where is_bad[i]."""
    row = int(np.flatnonzero(is_bad)[0]) + 1
    more = f"; {int(is_bad.sum())} stamps are so" if is_bad.sum() > 1 else ""
    return InputError(where_of(row), f"stamp {seconds_text(int(stamps_ns[row]))} s {found}{more}", hint)
