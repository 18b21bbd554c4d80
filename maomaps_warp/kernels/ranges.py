"""Launches over ranges: how a CPU's cores share one kernel.

A launch on a CPU is one serial loop in the calling thread, which lets go of the interpreter's lock meanwhile. So a
kernel that takes the start of its range as its FIRST argument, and works on task `start + wp.tid()`, is launched once
for each range, on several threads. Ranges must not write to the same memory. On CUDA it is one launch with start 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import warp as wp

#: Ranges for each thread: enough that a thread which ends early takes over work from the others.
_RANGES_PER_THREAD = 8


def launch_ranges(
    kernel: Any,
    count: int,
    *,
    inputs: Sequence[Any],
    outputs: Sequence[Any] = (),
    device: Any,
    threads: int = 1,
    grain: int = 1,
) -> None:
    """Launch a kernel over tasks 0 to count - 1, in ranges on several threads where the device is a CPU.

    Args:
        kernel: takes the start of its range (int32) before `inputs` and `outputs`; one-dimensional.
        count: tasks.
        inputs, outputs: as for wp.launch, without the start.
        device: Warp device.
        threads: how many; 1 is one plain launch.
        grain: least tasks of a range, so that short work is not cut up.
    """
    if count <= 0:
        return
    device = wp.get_device(device)
    ranges = 1 if not device.is_cpu else min(threads * _RANGES_PER_THREAD, -(-count // grain))
    if threads <= 1 or ranges <= 1:
        wp.launch(kernel, dim=count, inputs=[0, *inputs], outputs=list(outputs), device=device)
        return
    edges = [count * k // ranges for k in range(ranges + 1)]
    left = iter(list(pairwise(edges)))
    # Recording a command loads the kernel and packs its arguments: once for each thread, not for each range.
    commands = [
        wp.launch(kernel, dim=1, inputs=[0, *inputs], outputs=list(outputs), device=device, record_cmd=True)
        for _ in range(min(threads, ranges))
    ]
    with ThreadPoolExecutor(len(commands) - 1) as pool:
        others = [pool.submit(_run, command, left) for command in commands[1:]]
        _run(commands[0], left)
        for other in others:
            other.result()


def _run(command: Any, left: Iterator[tuple[int, int]]) -> None:
    """Run a command on ranges until none is left; other threads take theirs from the same iterator."""
    for start, stop in left:
        command.set_param_at_index(0, start)
        command.set_dim(stop - start)
        command.launch()
