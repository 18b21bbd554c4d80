"""The whole `score` command in a process of its own, beside a process that only imports Warp."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.flats import Flat
from benchmarks.rows import Row, WrongResult
from benchmarks.setting import Setting
from benchmarks.timing import Timed, interleaved

#: What Warp keeps compiled kernels in.
CACHE_VARIABLE = "WARP_CACHE_PATH"
#: A process starts as that of an installed package does, from bytecode.
_NO_BYTECODE = "PYTHONDONTWRITEBYTECODE"


def warm(setting: Setting) -> Iterator[Row]:
    """The kernels are compiled: by the round that is not timed."""
    with tempfile.TemporaryDirectory(prefix="maomaps-bench-") as name:
        folder = Path(name)
        write_text_input(setting.flat, folder)
        timed = interleaved(
            {"score": _score(folder, setting.device, lambda: folder / "kernels"), "import": _import_warp},
            # A difference of two processes scatters more than either.
            replace(setting.repeats, most=3 * setting.repeats.most, budget_s=3 * setting.repeats.budget_s),
        )
        yield _row("score", setting, folder, timed)


def cold(setting: Setting) -> Iterator[Row]:
    """Each round begins with an empty folder for kernels."""
    with tempfile.TemporaryDirectory(prefix="maomaps-bench-") as name:
        folder = Path(name)
        write_text_input(setting.flat, folder)
        warm_result = _score(folder, setting.device, lambda: folder / "kernels")()
        run = _score(folder, setting.device, lambda: Path(tempfile.mkdtemp(dir=folder)))
        timed = interleaved({"score": run, "import": _import_warp}, setting.repeats)
        if timed["score"].result != warm_result:
            raise WrongResult("score-cold: the metrics differ from those with a warm cache")
        row = _row("score-cold", setting, folder, timed)
        kernels = "carried compiled" if _are_kernels_carried() else "compiled in each round"
        yield replace(row, sizes=f"{row.sizes}; kernels {kernels}")


def write_text_input(flat: Flat, folder: Path) -> None:
    """Both maps and trajectories as the original program takes them: `x y z` and `x y z roll pitch yaw` lines."""
    from maomaps_warp.io.clouds import write_xyz
    from maomaps_warp.io.trajectories import write_maomaps_poses

    for side, voxels, trajectory in (("gt", flat.gt_map, flat.gt), ("slam", flat.est_map, flat.est)):
        write_xyz(folder / f"{side}_points.txt", voxels.points)
        write_maomaps_poses(folder / f"{side}_poses.txt", replace(trajectory, stamps_ns=None))


def _score(folder: Path, device: str, cache: Callable[[], Path]) -> Callable[[], dict[str, Any]]:
    report = folder / "score.json"
    first: list[dict[str, Any]] = []
    command = [sys.executable, "-m", "maomaps_warp", "score", str(folder), "--json", str(report), "--device", device]

    def run() -> dict[str, Any]:
        environment = {k: v for k, v in os.environ.items() if k != _NO_BYTECODE} | {CACHE_VARIABLE: str(cache())}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise WrongResult(f"`score` ended with {done.returncode}: {done.stderr.strip()[-500:]}")
        metrics: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))["metrics"]
        first.append(metrics)
        if metrics != first[0]:
            raise WrongResult("`score`: two processes gave different metrics")
        return metrics

    return run


def _are_kernels_carried() -> bool:
    import warp as wp

    from maomaps_warp.mapping.kernel_objects import SHIPPED

    return (SHIPPED / str(wp.config.version)).is_dir()


def _import_warp() -> None:
    subprocess.run([sys.executable, "-c", "import warp"], capture_output=True, check=True)


def _row(work: str, setting: Setting, folder: Path, timed: dict[str, Timed]) -> Row:
    whole, only_import = timed["score"], timed["import"]
    beyond = tuple(a - b for a, b in zip(whole.seconds, only_import.seconds, strict=True))
    megabytes = sum(file.stat().st_size for file in folder.glob("*.txt")) / 1e6
    medians = [sorted(part.seconds)[len(part.seconds) // 2] for part in (whole, only_import)]
    sizes = (
        f"{len(setting.flat.gt_map)} / {len(setting.flat.est_map)} points, {len(setting.flat.gt)} poses, "
        f"{megabytes:.1f} MB of text; the process takes {medians[0]:.2f} s, `import warp` {medians[1]:.2f} s of it"
    )
    return replace(
        setting.row(work, sizes, replace(whole, seconds=beyond)), agreement="metrics the same in every process"
    )
