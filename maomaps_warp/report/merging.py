"""What a merge did, for people and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.placements import Placement
from maomaps_warp.report.json_report import versions

if TYPE_CHECKING:
    from rich.table import Table

SCHEMA = 1


def merging_table(names: Sequence[str], placements: Sequence[Placement], seconds: Sequence[float]) -> Table:
    """A row a source: its transform in metres and degrees, the confidence and the time."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("source", overflow="fold")
    for heading in ("x m", "y m", "z m", "roll deg", "pitch deg", "yaw deg", "confidence", "s"):
        table.add_column(heading, justify="right")
    for name, placement, time in zip(names, placements, seconds, strict=True):
        T = placement.T_merged_source
        numbers = ["not merged", *[""] * 5]
        if T is not None:
            numbers = [f"{v + 0.0:.3f}" for v in (*T[:3, 3], *np.degrees(_roll_pitch_yaw(T)))]
        confidence = "-" if placement.confidence is None else f"{placement.confidence:.2f}"
        table.add_row(name, *numbers, confidence, f"{time:.1f}")
    return table


def merging_document(
    method: str, voxel_size: float, names: Sequence[str], placements: Sequence[Placement], seconds: Sequence[float]
) -> dict[str, Any]:
    """The same as plain JSON values: metres and radians, transforms as 4x4 rows; null where a source was not merged.

    Everything except `milliseconds` is the same for the same input.
    """
    sources = [
        {
            "source": name,
            "T_merged_source": None if p.T_merged_source is None else p.T_merged_source.tolist(),
            "confidence": p.confidence,
            "reason": p.reason or None,
        }
        for name, p in zip(names, placements, strict=True)
    ]
    return {
        "kind": "merge",
        "schema": SCHEMA,
        "method": method,
        "voxel_size": voxel_size,
        "sources": sources,
        "versions": versions(),
        "milliseconds": [round(1e3 * time, 3) for time in seconds],
    }


def _roll_pitch_yaw(T: NDArray[np.float64]) -> tuple[float, float, float]:
    """Radians of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    R = T[:3, :3]
    return math.atan2(R[2, 1], R[2, 2]), math.asin(max(-1.0, min(1.0, -R[2, 0]))), math.atan2(R[1, 0], R[0, 0])
