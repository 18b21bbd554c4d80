"""Measure how fast this is, against others and against itself, and check that the results agree.

    python scripts/bench.py                  every work, on a flat of a dozen rooms
    python scripts/bench.py --quick --gate   a small flat and few repeats; exit code 1 where a ratio is too low
    python scripts/bench.py --only rays --flat big
    python scripts/bench.py --growth         time against voxels, poses and frames, with fitted exponents
    python scripts/bench.py --device cuda    ours on a GPU, the peers on the CPU

The peers come with the extra `bench`; one that is missing is said and left out. Each work runs in a process of its own
that is bound to as many cores as it has threads. `docs/performance.md` says what is measured, and how.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks import children, gate, machine, table
from benchmarks.flats import SIZES, default_folder
from benchmarks.growth import Growth, growth_table
from benchmarks.rows import Row, Skipped, to_json
from benchmarks.setting import THREADS_VARIABLE, Setting
from benchmarks.timing import Repeats
from benchmarks.works import WORKS

BASELINE = Path(__file__).parent / "benchmarks" / "baseline.json"
FULL, QUICK = Repeats(most=9, least=3, budget_s=30.0), Repeats(most=3, least=2, budget_s=3.0)


def main() -> None:
    parser = _parser()
    options = parser.parse_args()
    if options.growth and (options.gate or options.write_baseline or options.only):
        parser.error("--growth takes neither --gate nor --write-baseline nor --only: curves have no goals")
    flat = options.flat or ("small" if options.quick else "big" if options.growth else "apt")
    repeats = QUICK if options.quick or options.growth else FULL
    setting = Setting(flat, options.scenes, options.device, options.threads, repeats, long=not options.quick)
    if options.child:
        children.answer(options.child, setting)
        return
    assert setting.flat  # made here, once, and not in the first child's time
    document = _growth(setting, options) if options.growth else _works(setting, options)
    document |= {
        "machine": machine.machine() | machine.gpu(options.device),
        "versions": machine.versions(),
    }
    for facts in (document["machine"], document["versions"]):
        print(", ".join(f"{name} {value}" for name, value in facts.items()))
    if options.json is not None:
        options.json.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    for reason in document["failed"]:
        print(f"FAILED {reason}", file=sys.stderr)
    sys.exit(1 if document["failed"] else 0)


def _works(setting: Setting, options: argparse.Namespace) -> dict[str, Any]:
    """Measure the works that were asked for, print the table, hold it against the goals where that was asked for."""
    rows: list[Row] = []
    skipped: list[Skipped] = []
    failed: list[str] = []
    for name in options.only or WORKS:
        print(f"{name} ...", file=sys.stderr, flush=True)
        found, left_out, wrong = children.measure(_child_command(name, setting, options), name, setting)
        rows, skipped, failed = rows + found, skipped + left_out, failed + wrong
    print(table.table(rows, skipped))
    baseline: dict[str, Any] = json.loads(BASELINE.read_text(encoding="utf-8")) if BASELINE.exists() else {"ratios": {}}
    if options.gate:
        failed += gate.failures(rows, baseline["ratios"])
    if options.write_baseline and not failed:
        facts = {"machine": machine.machine(), "versions": machine.versions()}
        # Ratios of another machine, or against other peers, are no part of this baseline.
        is_same = {key: baseline.get(key) for key in facts} == facts
        if baseline["ratios"] and not is_same:
            print("the baseline was of another machine or other versions: begun anew", file=sys.stderr)
        older = baseline["ratios"] if is_same else {}
        kept = older | gate.ratios(rows)
        BASELINE.write_text(json.dumps(facts | {"ratios": dict(sorted(kept.items()))}, indent=2) + "\n", "utf-8")
    return {"rows": [to_json(row) for row in rows], "skipped": [asdict(entry) for entry in skipped], "failed": failed}


def _growth(setting: Setting, options: argparse.Namespace) -> dict[str, Any]:
    command = _child_command(children.GROWTH, setting, options)
    document = children.run_child(command, setting.threads)
    curves = [Growth(**curve) for curve in document.get("curves", [])]
    print(growth_table(curves))
    return {"curves": [asdict(curve) for curve in curves], "failed": document["wrong"]}


def _child_command(name: str, setting: Setting, options: argparse.Namespace) -> list[str]:
    threads = setting.threads if name == children.GROWTH else WORKS[name].threads or setting.threads
    words = ["--flat", setting.flat_name, "--scenes", str(setting.scenes), "--device", setting.device]
    words += ["--threads", str(threads), *(f"--{mode}" for mode in ("quick", "growth") if getattr(options, mode))]
    return [sys.executable, __file__, *words, "--child", name]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the small flat and few repeats: about a minute")
    parser.add_argument("--gate", action="store_true", help="exit with 1 where a goal or the baseline is missed")
    parser.add_argument("--only", action="append", choices=WORKS, metavar="NAME", help=f"one of: {', '.join(WORKS)}")
    parser.add_argument("--growth", action="store_true", help="the curves instead of the table")
    parser.add_argument("--flat", choices=SIZES, help="default: apt; with --quick small, with --growth big")
    parser.add_argument("--device", default="cpu", help="of ours: cpu, cuda or cuda:N")
    parser.add_argument("--threads", type=int, default=_default_threads(), help=f"default: {THREADS_VARIABLE}, or 2")
    parser.add_argument("--scenes", type=Path, default=default_folder(), help="keeps the flats; default: %(default)s")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything there too")
    parser.add_argument("--write-baseline", action="store_true", help=f"put the ratios into {BASELINE.name}")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    return parser


def _default_threads() -> int:
    return int(os.environ.get(THREADS_VARIABLE) or min(2, os.cpu_count() or 1))


if __name__ == "__main__":
    main()
