"""What is to be reached. `docs/performance.md` says what each work is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Goal:
    """One work of the table.

    Attributes:
        title: in words.
        ratio: least quotient of the peer's time and ours that will do; None if there is no peer.
        ratio_aim: what is hoped for.
        limit: seconds (megabytes for memory) that will do on a machine like the one of the baseline.
        limit_aim: what is hoped for.
        unit: of the limit.
    """

    title: str
    ratio: float | None = None
    ratio_aim: float | None = None
    limit: float | None = None
    limit_aim: float | None = None
    unit: str = "s"


GOALS: dict[str, Goal] = {
    "map": Goal("voxel map from frames in memory, against a loop over points and a dict", 500, 900),
    "map-1": Goal("the same against open addressing in numba", 3, 5),
    "rays": Goal("first hit of rays in the scorer's order", 3, 6),
    "ray-build": Goal("building what rays are cast into", 20, 60),
    "nearest-lattice": Goal("nearest neighbours of voxels, build included", 4, 10),
    "nearest-free": Goal("nearest neighbours of free clouds, build included", 3, 8),
    "nearest-apart": Goal("the same, clouds half a metre apart", 1, 4),
    "associate": Goal("association with the nearest pose, maps and poses in memory", 30, 100, 0.25, 0.08),
    "associate-all": Goal("the same with all poses", None, None, 2.5, 0.7),
    "threads": Goal("association with the nearest pose, two threads against one", 1.6, 1.9),
    "threads-all": Goal("association with all poses, two threads against one", 1.6, 1.9),
    "score": Goal("whole `score` command on text, warm kernel cache, beyond `import warp`", None, None, 0.5, 0.2),
    "score-cold": Goal("the same with an empty kernel cache, beyond `import warp`", None, None, 3.0, 0.5),
    "memory": Goal("peak memory of `map` over the longest of the recordings", None, None, None, 600, unit="MB"),
}
