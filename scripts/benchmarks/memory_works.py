"""Peak memory of mapping recordings of growing length, by `bench_map_memory.py`."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from benchmarks.rows import Row, Skipped
from benchmarks.setting import Setting

SCRIPT = Path(__file__).parent.parent / "bench_map_memory.py"


def peak_memory(setting: Setting) -> Iterator[Row | Skipped]:
    """A row for each way of mapping: megabytes by length, shortest first."""
    if not setting.long:
        yield Skipped("memory", "takes minutes: run without --quick")
        return
    with tempfile.TemporaryDirectory(prefix="maomaps-bench-") as folder:
        report = Path(folder) / "memory.json"
        subprocess.run([sys.executable, str(SCRIPT), "--json", str(report)], stdout=sys.stderr, check=True)
        document = json.loads(report.read_text(encoding="utf-8"))
    for way, group in groupby(sorted(document["rows"], key=lambda row: row["way"]), key=lambda row: row["way"]):
        rows = list(group)
        peaks = tuple(row["peak_bytes"] / 1e6 for row in rows)
        lengths = ", ".join(f"{row['frames']} frames {peak:.0f} MB" for row, peak in zip(rows, peaks, strict=True))
        image = "x".join(map(str, document["image_size"]))
        voxels = {row["voxels"] for row in rows}
        yield Row(
            "memory",
            f"round of {document['round_frames']} frames",
            "cpu",
            setting.threads,
            f"{way}, images of {image}: {lengths}",
            peaks,
            agreement=f"{min(voxels)} voxels in every map" if len(voxels) == 1 else f"maps of {sorted(voxels)} voxels",
        )
