"""How a work is to be measured."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from benchmarks.flats import Flat, load_flat
from benchmarks.rows import Row
from benchmarks.timing import Repeats, Timed

THREADS_VARIABLE = "MAOMAPS_THREADS"


@dataclass(frozen=True)
class Setting:
    """What the options of the script come to for one work.

    Attributes:
        flat_name: key of `flats.SIZES`.
        scenes: folder that keeps flats.
        device: Warp device of ours.
        threads: of ours and of the peers; the process was started with so many.
        repeats: how often.
        long: also what takes minutes.
    """

    flat_name: str
    scenes: Path
    device: str = "cpu"
    threads: int = 1
    repeats: Repeats = field(default_factory=Repeats)
    long: bool = True

    @cached_property
    def flat(self) -> Flat:
        """The scene, made if need be."""
        return load_flat(self.flat_name, self.scenes)

    def row(self, work: str, sizes: str, ours: Timed, peer: str = "", theirs: Timed | None = None) -> Row:
        """A row without its agreement."""
        seconds = () if theirs is None else theirs.seconds
        return Row(work, self.flat_name, self.device, self.threads, sizes, ours.seconds, peer, seconds)


@contextmanager
def with_threads(threads: int) -> Iterator[None]:
    """Ours uses so many threads inside."""
    before = os.environ.get(THREADS_VARIABLE)
    os.environ[THREADS_VARIABLE] = str(threads)
    try:
        yield
    finally:
        if before is None:
            del os.environ[THREADS_VARIABLE]
        else:
            os.environ[THREADS_VARIABLE] = before
