"""Medians of interleaved repeats: ours, peer, ours, peer; so that a machine that slows down slows both."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Repeats:
    """How often each contestant runs.

    Attributes:
        most: timed rounds, after one that is not timed: it compiles, and gives the results that are compared.
        least: rounds that are run even if they take longer than `budget_s`.
        budget_s: seconds after which no further round begins.
    """

    most: int = 9
    least: int = 3
    budget_s: float = 30.0


@dataclass(frozen=True)
class Timed:
    """What a contestant returned when it was not timed, and the seconds of each timed round."""

    result: Any
    seconds: tuple[float, ...]


def interleaved(contestants: Mapping[str, Callable[[], Any]], repeats: Repeats) -> dict[str, Timed]:
    """Run the contestants in turn, round after round."""
    results = {name: run() for name, run in contestants.items()}
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    began = time.perf_counter()
    gc.collect()
    gc.disable()
    try:
        for done in range(repeats.most):
            if done >= repeats.least and time.perf_counter() - began > repeats.budget_s:
                break
            for name, run in contestants.items():
                seconds[name].append(_seconds(run))
    finally:
        gc.enable()
    return {name: Timed(results[name], tuple(seconds[name])) for name in contestants}


def _seconds(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    kept = run()
    taken = time.perf_counter() - start
    del kept  # freed outside of the clock
    return taken
