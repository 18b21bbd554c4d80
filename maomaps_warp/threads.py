"""How many threads the stages use on a CPU, and work side by side on them."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from maomaps_warp.errors import InputError

#: Overrides the number of threads; by default one for each core that this process may use.
THREADS_VARIABLE = "MAOMAPS_THREADS"


def thread_count(device: str = "cpu") -> int:
    """Threads for work on `device`: MAOMAPS_THREADS, else the usable cores; 1 on a GPU.

    Raises:
        InputError: MAOMAPS_THREADS is no whole number above 0.
    """
    if device != "cpu":
        return 1
    given = os.environ.get(THREADS_VARIABLE)
    if given is None:
        # Affinity, where the system knows it: a container or taskset may allow fewer cores than there are.
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not given.isdecimal() or int(given) < 1:
        raise InputError(THREADS_VARIABLE, f"{given!r} is no number of threads", "give a whole number above 0")
    return int(given)


def side_by_side(*works: Callable[[], Any], device: str = "cpu") -> tuple[Any, ...]:
    """What each of `works` returns, on as many threads as there are for `device`; of their errors the first work's.

    For work that lets go of the interpreter's lock, as NumPy does on large arrays, and launches on a CPU.
    """
    threads = min(thread_count(device), len(works))
    if threads < 2:
        return tuple(work() for work in works)
    with ThreadPoolExecutor(threads) as pool:
        started = [pool.submit(work) for work in works]
        return tuple(each.result() for each in started)
