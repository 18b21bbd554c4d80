"""Stages of a job: how long each took, and a place to report progress to."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: progress(stage, done, total): total is None where it is not known.
Progress = Callable[[str, int, int | None], None]


def _silent(stage: str, done: int, total: int | None) -> None:
    pass


class Stopwatch:
    """Times the stages of one job.

    Attributes:
        milliseconds: wall time of each stage that has ended, in order.
        progress: where the stages report to.
        say: prints a line meanwhile.
    """

    def __init__(self, progress: Progress = _silent, say: Callable[[str], None] = lambda text: None) -> None:
        self.milliseconds: dict[str, float] = {}
        self.progress = progress
        self.say = say

    @contextmanager
    def stage(self, name: str) -> Iterator[Callable[[int, int | None], None]]:
        """Time a stage; yields its own progress function (done, total)."""
        start = time.perf_counter()
        self.progress(name, 0, None)
        yield lambda done, total: self.progress(name, done, total)
        self.milliseconds[name] = self.milliseconds.get(name, 0.0) + 1e3 * (time.perf_counter() - start)
