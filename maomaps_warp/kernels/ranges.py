"""Launches over ranges: how a CPU's cores share one kernel.

A launch on a CPU is one serial loop in the calling thread, which lets go of the interpreter's lock meanwhile. So a
kernel that takes the start of its range as its FIRST argument, and works on task `start + wp.tid()`, is launched once
for each range, on several threads. Ranges must not write to the same memory. On CUDA it is one launch with start 0.
"""

from __future__ import annotations

from collections.abc import Sequence
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
    # Recording a command loads the kernel and packs its arguments here; the threads only run it.
    commands = [
        wp.launch(
            kernel, dim=stop - start, inputs=[start, *inputs], outputs=list(outputs), device=device, record_cmd=True
        )
        for start, stop in pairwise(edges)
    ]
    with ThreadPoolExecutor(threads) as pool:
        for done in [pool.submit(command.launch) for command in commands]:
            done.result()
