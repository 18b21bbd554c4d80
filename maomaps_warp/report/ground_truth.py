"""A ground-truth map that was made of a recording, as a table and as JSON."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maomaps_warp.map_protocol import MapProtocol
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.pose_convention import parse_convention
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelMap
from maomaps_warp.report.json_report import versions

if TYPE_CHECKING:
    from rich.console import RenderableType

#: Raised when a field changes its meaning or goes away.
SCHEMA = 1


@dataclass(frozen=True, eq=False)
class MadeMap:
    """What there is to say about a map.

    Attributes:
        source, kind: what it was made of, and what that was recognised as.
        camera: of the depth images.
        protocol: constants and choices.
        voxels, trajectory: what was made.
        counts: what became of frames, samples and voxels.
        notes: what was decided or left out.
        device: what it was made on.
        files: what was written.
        milliseconds: wall time of each stage.
    """

    source: str
    kind: str
    camera: Camera
    protocol: MapProtocol
    voxels: VoxelMap
    trajectory: Trajectory
    counts: dict[str, int]
    notes: tuple[str, ...]
    device: str
    files: tuple[Path, ...]
    milliseconds: dict[str, float]

    @property
    def lowest(self) -> list[float]:
        """Least coordinates of the map's voxel centres, metres."""
        return [round(float(x), 9) for x in self.voxels.points.min(axis=0)]

    @property
    def size(self) -> list[float]:
        """Extent of the map along x, y and z, whole voxels, metres."""
        extent = (np.ptp(self.voxels.ijk, axis=0) + 1) * self.voxels.grid.voxel_size
        return [round(float(x), 9) for x in extent]


def ground_truth_document(made: MadeMap) -> dict[str, Any]:
    """Everything as plain JSON values; metres, radians, seconds.

    Everything except `milliseconds` is the same for the same input.
    """
    trajectory = made.trajectory
    return {
        "schema": SCHEMA,
        "source": {"name": made.source, "kind": made.kind},
        "camera": {name: getattr(made.camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")},
        "pose_frame": trajectory.pose_frame,
        "counts": made.counts,
        "map": {"lowest": made.lowest, "size": made.size, "has_colors": made.voxels.colors is not None},
        "trajectory": {
            "poses": len(trajectory),
            "path_length_m": trajectory.path_length,
            "duration_s": trajectory.duration_s,
        },
        "files": [str(path) for path in made.files],
        "protocol": made.protocol.effective(),
        "notes": list(made.notes),
        "device": made.device,
        "versions": versions(),
        "milliseconds": {name: round(ms, 3) for name, ms in made.milliseconds.items()},
    }


def ground_truth_table(made: MadeMap) -> Iterable[RenderableType]:
    """What was made of what, what became of frames and samples, and the files."""
    from rich.table import Table

    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 3, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for label, text in _rows(made):
        table.add_row(label, text)
    yield table


def _rows(made: MadeMap) -> Iterable[tuple[str, str]]:
    trajectory, counts = made.trajectory, made.counts
    yield "source", f"{made.source} ({made.kind})"
    yield "protocol", f"{made.protocol.name}; device {made.device}"
    yield "camera", str(made.camera)
    yield "poses", f"{trajectory.pose_frame}: {parse_convention(trajectory.pose_frame).meaning}"
    duration = "" if trajectory.duration_s is None else f", {trajectory.duration_s:.3f} s"
    yield "trajectory", f"{len(trajectory)} poses, {trajectory.path_length:.3f} m{duration}"
    left_out = [
        f"{counts[name]} without {name.removeprefix('frames_without_')}"
        for name in ("frames_without_pose", "frames_without_color")
        if name in counts
    ]
    yield "depth images", f"{counts['frames']}, {', '.join(left_out)}"
    yield "samples", f"{counts['pixels_used']} of {counts['pixels']} are in the map"
    removed = f", {counts['ceiling_removed']} more removed with the ceiling" if counts["ceiling_removed"] else ""
    yield "map", f"{counts['voxels']} voxels of {made.protocol.voxel_size:g} m{removed}"
    yield "size", " x ".join(f"{x:.6g}" for x in made.size) + " m from " + " ".join(f"{x:.6g}" for x in made.lowest)
    for note in made.notes:
        yield "note", note
    for path in made.files:
        yield "wrote", str(path)
