"""Work in chunks, on every core where the device is a CPU."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from maomaps_warp.threads import thread_count

Result = TypeVar("Result")


def slices(count: int, size: int) -> list[slice]:
    """Consecutive slices of at most `size` that cover range(count)."""
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def each_in_order(work: Callable[[slice], Result], chunks: Sequence[slice], device: str) -> Iterator[Result]:
    """Results of `work` on each chunk, in the order of the chunks, however they are computed.

    A launch on a CPU is one serial loop that releases the interpreter's lock, so chunks run side by side, one
    thread for each core; on a GPU one after the other. They must not write to the same memory.
    """
    if chunks:
        yield work(chunks[0])  # alone: it loads the kernels
    with ThreadPoolExecutor(thread_count(device)) as pool:
        yield from pool.map(work, chunks[1:])
