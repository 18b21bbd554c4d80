"""What is to be reached. `docs/performance.md` says what each work is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Goal:
    """One work of the table.

    Attributes:
        ratio: least quotient of the peer's time and ours that will do; None if there is no peer.
        ratio_aim: what is hoped for.
        limit: seconds (megabytes for memory) that will do on a machine like the one of the baseline.
        limit_aim: what is hoped for.
        unit: of the limit.
    """

    ratio: float | None = None
    ratio_aim: float | None = None
    limit: float | None = None
    limit_aim: float | None = None
    unit: str = "s"


GOALS: dict[str, Goal] = {
    "map": Goal(500, 900),
    "map-1": Goal(3, 5),
    "rays": Goal(3, 6),
    "ray-build": Goal(20, 60),
    "nearest-lattice": Goal(4, 10),
    "nearest-free": Goal(3, 8),
    "nearest-apart": Goal(1, 4),
    "associate": Goal(30, 100, 0.25, 0.08),
    "associate-all": Goal(None, None, 2.5, 0.7),
    "threads": Goal(1.6, 1.9),
    "threads-all": Goal(1.6, 1.9),
    "render": Goal(1),
    "score": Goal(None, None, 0.5, 0.2),
    "score-cold": Goal(None, None, 3.0, 0.5),
    "memory": Goal(None, None, None, 600, unit="MB"),
}
