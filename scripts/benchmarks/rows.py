"""Rows of the table: what was measured, against what, and whether the results agree."""

from __future__ import annotations

import statistics
from dataclasses import asdict, dataclass
from typing import Any


class WrongResult(Exception):
    """Ours and a peer do not give the same; the text says what and how much."""


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        work: key of `goals.GOALS`.
        flat: scene that it was measured on.
        device: that ours ran on; peers run on the CPU.
        threads: of ours and of the peer.
        sizes: what was worked on, in words.
        ours: of each round: seconds, or megabytes for memory.
        peer: who else did it; empty if nobody.
        theirs: of each round, beside that of ours.
        agreement: how the results were compared, in words; a wrong one raises WrongResult instead.
    """

    work: str
    flat: str
    device: str
    threads: int
    sizes: str
    ours: tuple[float, ...]
    peer: str = ""
    theirs: tuple[float, ...] = ()
    agreement: str = ""

    @property
    def key(self) -> str:
        """Names the row in a baseline."""
        return "/".join(part for part in (self.device, self.flat, str(self.threads), self.work, self.peer) if part)

    @property
    def value(self) -> float:
        """Median of ours."""
        return statistics.median(self.ours)

    @property
    def ratio(self) -> float | None:
        """How many times faster than the peer: quotient of the medians; None without a peer."""
        return statistics.median(self.theirs) / self.value if self.theirs else None

    @property
    def spread(self) -> tuple[float, float] | None:
        """Least and greatest ratio of a round; None without a peer."""
        if not self.theirs:
            return None
        ratios = [theirs / ours for theirs, ours in zip(self.theirs, self.ours, strict=True)]
        return min(ratios), max(ratios)


def to_json(row: Row) -> dict[str, Any]:
    """A row as plain values."""
    return asdict(row)


def from_json(values: dict[str, Any]) -> Row:
    """A row from what `to_json` gave."""
    return Row(**values | {name: tuple(values[name]) for name in ("ours", "theirs")})


@dataclass(frozen=True)
class Skipped:
    """A row that could not be measured here, and why."""

    work: str
    reason: str


def share_text(wrong: int, total: int) -> str:
    """ "12 of 300000 differ"; "all 300000 the same"."""
    return f"all {total} the same" if wrong == 0 else f"{wrong} of {total} differ"


def check_share(what: str, wrong: int, total: int, limit: float) -> str:
    """The share in words; raises WrongResult if more than `limit` of the total differ, or there is none."""
    if not total:
        raise WrongResult(f"{what}: nothing was compared")
    text = f"{what}: {share_text(wrong, total)}"
    if wrong > limit * total:
        raise WrongResult(f"{text}, more than {limit:g} of them")
    return text
