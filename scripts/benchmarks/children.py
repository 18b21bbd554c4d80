"""Each work in a process of its own, which has as many threads as the work is measured on."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict
from importlib.util import find_spec
from typing import Any

from benchmarks.growth import curves
from benchmarks.rows import Row, Skipped, WrongResult, from_json, to_json
from benchmarks.setting import THREADS_VARIABLE, Setting
from benchmarks.works import WORKS, Work

#: Libraries of the peers take their threads from these, when they are loaded.
THREAD_VARIABLES = (THREADS_VARIABLE, "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
GROWTH = "growth"


def measure(command: list[str], name: str, setting: Setting) -> tuple[list[Row], list[Skipped], list[str]]:
    """Rows of one work, what was left out, and results that are wrong.

    `command` starts this script as the child that measures the work on the same setting; see `answer`.
    """
    work = WORKS[name]
    if reason := _not_here(work, setting):
        return [], [Skipped(name, reason)], []
    document = run_child(command, work.threads or setting.threads)
    rows = [from_json(row) for row in document["rows"]]
    return rows, [Skipped(**entry) for entry in document["skipped"]], document["wrong"]


def _not_here(work: Work, setting: Setting) -> str:
    """Why a work cannot be measured; empty if it can."""
    if work.cpu_only and setting.device != "cpu":
        return "is about the CPU"
    if (work.threads or setting.threads) > (os.cpu_count() or 1):
        return f"needs {work.threads or setting.threads} cores"
    if work.needs is not None and find_spec(work.needs) is None:
        return f"{work.needs} is not installed"
    return ""


def run_child(command: list[str], threads: int) -> dict[str, Any]:
    """What a child process on `threads` threads prints."""
    environment = os.environ | {name: str(threads) for name in THREAD_VARIABLES}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        return {"rows": [], "skipped": [], "wrong": [f"{command[-1]}: the process ended with {done.returncode}"]}
    document: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return document


def answer(name: str, setting: Setting) -> None:
    """Be the child: measure one work and print its rows as JSON, the last line of what is printed."""
    if hasattr(os, "sched_setaffinity"):
        # Embree's threads know no variable. The last cores: the first ones serve interrupts.
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-setting.threads :])
    _quiet_warp()
    document: dict[str, Any] = {"rows": [], "skipped": [], "wrong": []}
    if name == GROWTH:
        document["curves"] = [asdict(curve) for curve in curves(setting)]
    else:
        try:
            for entry in WORKS[name].run(setting):
                if isinstance(entry, Skipped):
                    document["skipped"].append(asdict(entry))
                else:
                    document["rows"].append(to_json(entry))
        except WrongResult as error:
            document["wrong"].append(f"{name}: {error}")
    sys.stdout.flush()
    print(json.dumps(document))


def _quiet_warp() -> None:
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
