"""A dataset's figures as a table for people, CSV, LaTeX and JSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from maomaps_warp.model.dataset import DatasetFigures, OverlapFigures, RunFigures, SampleFigures
from maomaps_warp.report.json_report import versions
from maomaps_warp.report.latex import latex_text

if TYPE_CHECKING:
    from rich.console import RenderableType

#: Raised when a field changes its meaning or goes away.
SCHEMA = 1

_ORDINALS = ("1st", "2nd", "3rd", "4th", "5th", "6th", "7th", "8th", "9th", "10th")

_Value = str | float | int | None


@dataclass(frozen=True)
class _Column:
    """A column: its title for people, its name in files, its value in full, and that value for people."""

    title: str
    name: str
    value: Callable[[SampleFigures], _Value]
    show: Callable[[Any], str] = str


def dataset_tables(dataset: DatasetFigures) -> Iterator[RenderableType]:
    """Table II, then what was decided on the way and what is missing."""
    from rich import box
    from rich.table import Table

    columns = _columns(dataset.samples)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for i, column in enumerate(columns):
        table.add_column(column.title, justify="left" if i == 0 else "right", vertical="bottom")
    for sample in dataset.samples:
        table.add_row(*_shown(columns, sample, "–"))
    yield table
    for note in dataset.notes:
        yield f"note     {note}"
    for sample in dataset.samples:
        for note in sample.notes:
            yield f"note     {sample.name}: {note}"
        for problem in sample.problems:
            yield f"problem  {sample.name}: {problem}"


def overlap_lines(overlap: OverlapFigures) -> Iterator[str]:
    """The three IoUs with what they are made of."""
    figures = (
        ("IoU 2D known", "known", overlap.known_iou, "columns that are free or occupied"),
        ("IoU 2D obstacle", "obstacle", overlap.obstacle_iou, "occupied columns"),
        ("IoU 3D voxels", "voxel", overlap.voxel_iou, "voxels"),
    )
    for title, name, iou, what in figures:
        common, either = overlap.counts[f"{name}_common"], overlap.counts[f"{name}_any"]
        value = "–" if iou is None else f"{iou:.3f}"
        yield f"{title:<16} {value:<6} {common} of {either} {what} are in two maps or more"


def dataset_csv(dataset: DatasetFigures) -> str:
    """Table II as RFC 4180: a header line, full precision, metres, seconds and cells, empty where unknown."""
    columns = [column for column in _columns(dataset.samples) if column.name != "resolution_2d"]
    columns += [
        _Column("", "width_2d_cells", lambda sample: sample.size and sample.size[0]),
        _Column("", "height_2d_cells", lambda sample: sample.size and sample.size[1]),
        _Column("", "problems", lambda sample: "; ".join(sample.problems)),
    ]
    text = io.StringIO()
    writer = csv.writer(text)  # \r\n and quotes as the RFC has them
    writer.writerow(column.name for column in columns)
    for sample in dataset.samples:
        values = (column.value(sample) for column in columns)
        writer.writerow("" if value is None else value for value in values)
    return text.getvalue()


def dataset_latex(dataset: DatasetFigures) -> str:
    """Table II as a `tabular`; what is missing stands in comments behind the rows."""
    columns = _columns(dataset.samples)
    lines = [
        rf"\begin{{tabular}}{{l|{'|'.join('r' * (len(columns) - 1))}}}",
        " & ".join(latex_text(column.title) for column in columns) + r" \\",
        r"\hline",
    ]
    for sample in dataset.samples:
        lines.append(" & ".join(latex_text(cell) for cell in _shown(columns, sample, "--")) + r" \\")
        lines += [f"% {' '.join(problem.split())}" for problem in sample.problems]
    return "\n".join([*lines, r"\end{tabular}", ""])


def dataset_document(dataset: DatasetFigures) -> dict[str, Any]:
    """Everything as plain JSON values; the units stand beside the figures."""
    return {
        "schema": SCHEMA,
        "dataset": dataset.name,
        "units": {
            "path_length": "m",
            "duration": "s",
            "voxel_size": "m",
            "ground_z": "m",
            "size_2d": "cells of voxel_size, [along x, along y]",
            "iou": "share: seen by at least two runs / seen by any",
        },
        "voxel_size": dataset.voxel_size,
        "ground": dataset.ground,
        "samples": [_sample_document(sample) for sample in dataset.samples],
        "notes": list(dataset.notes),
        "versions": versions(),
    }


def _sample_document(sample: SampleFigures) -> dict[str, Any]:
    overlap = sample.overlap
    return {
        "name": sample.name,
        "runs": [vars(run) for run in sample.runs],
        "iou": overlap
        and {"known_2d": overlap.known_iou, "obstacle_2d": overlap.obstacle_iou, "voxels_3d": overlap.voxel_iou},
        "overlap_counts": overlap and overlap.counts,
        "points_3d": sample.elements,
        "size_2d": sample.size and list(sample.size),
        "ground_z": sample.ground_z,
        "problems": list(sample.problems),
        "notes": list(sample.notes),
    }


def _columns(samples: Sequence[SampleFigures]) -> list[_Column]:
    """The table's columns; there are as many runs as the sample with the most has."""
    runs = max(len(sample.runs) for sample in samples)
    names = [run.name for run in max(samples, key=lambda sample: len(sample.runs)).runs]
    columns = [_Column("Sample", "sample", lambda sample: sample.name)]
    for i in range(runs):
        value = _of_run(i, lambda run: run.path_length)
        columns.append(_Column(f"{_ORDINALS[i]} path length in m", f"path_length_{names[i]}_m", value, "{:.1f}".format))
    for i in range(runs):
        value = _of_run(i, lambda run: run.duration)
        columns.append(_Column(f"{_ORDINALS[i]} duration in s", f"duration_{names[i]}_s", value, "{:.1f}".format))
    return [
        *columns,
        _Column("IoU 2D known", "iou_2d_known", _of_overlap(lambda o: o.known_iou), "{:.3f}".format),
        _Column("IoU 2D obstacle", "iou_2d_obstacle", _of_overlap(lambda o: o.obstacle_iou), "{:.3f}".format),
        _Column("IoU 3D voxels", "iou_3d_voxels", _of_overlap(lambda o: o.voxel_iou), "{:.3f}".format),
        _Column("Points 3D", "points_3d", lambda s: s.elements, _grouped),
        _Column("Resolution 2D", "resolution_2d", lambda s: s.size and f"{s.size[0]}x{s.size[1]}"),
    ]


def _of_run(index: int, figure: Callable[[RunFigures], _Value]) -> Callable[[SampleFigures], _Value]:
    return lambda sample: figure(sample.runs[index]) if index < len(sample.runs) else None


def _of_overlap(figure: Callable[[OverlapFigures], float | None]) -> Callable[[SampleFigures], _Value]:
    return lambda sample: figure(sample.overlap) if sample.overlap else None


def _shown(columns: Sequence[_Column], sample: SampleFigures, absent: str) -> list[str]:
    values = [(column, column.value(sample)) for column in columns]
    return [absent if value is None else column.show(value) for column, value in values]


def _grouped(number: int) -> str:
    """405288 as the paper prints it: 405 288."""
    return f"{number:,}".replace(",", "\N{NO-BREAK SPACE}")
