"""Every work by name, and on how many threads it is measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from benchmarks import association_works, command_works, map_works, memory_works, nearest_works, ray_works, render_works
from benchmarks.rows import Row, Skipped
from benchmarks.setting import Setting


@dataclass(frozen=True)
class Work:
    """One work.

    Attributes:
        run: measures it.
        threads: of ours and of the peer; None: as many as were asked for.
        needs: module of its only peer, without which it is left out.
        cpu_only: nothing of it runs on a GPU.
    """

    run: Callable[[Setting], Iterator[Row | Skipped]]
    threads: int | None = None
    needs: str | None = None
    cpu_only: bool = False


WORKS: dict[str, Work] = {
    "map": Work(map_works.against_loop),
    "map-1": Work(map_works.against_numba, threads=1, needs="numba"),
    "rays": Work(ray_works.casting, threads=1),
    "ray-build": Work(ray_works.building),
    "nearest-lattice": Work(nearest_works.on_lattice),
    "nearest-free": Work(nearest_works.of_free_clouds),
    "nearest-apart": Work(nearest_works.apart),
    "associate": Work(association_works.nearest_pose),
    "associate-all": Work(association_works.every_pose),
    "threads": Work(association_works.threads_nearest, cpu_only=True),
    "threads-all": Work(association_works.threads_all, cpu_only=True),
    "render": Work(render_works.depth),
    "score": Work(command_works.warm),
    "score-cold": Work(command_works.cold),
    "memory": Work(memory_works.peak_memory, cpu_only=True),
}
