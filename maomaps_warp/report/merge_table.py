"""Many merges as one table: a row a pair, for each method success and AME, as in the paper's Tables IV and V."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from maomaps_warp.report.latex import latex_text
from maomaps_warp.report.merge_json import MergeEntry

if TYPE_CHECKING:
    from rich.table import Table

#: A merge that succeeded, failed, and one whose success cannot be told.
_MARKS = {True: "+", False: "-", None: "?"}
#: In the place of the AME of a merge that failed.
FAILED = "x"


@dataclass(frozen=True)
class MergeTable:
    """The cells of the table as text.

    Attributes:
        header: "Pair", the methods, then "METHOD AME" of each.
        rows: cells of each pair; empty where that pair was not merged by that method.
        notes: what a reader should know.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]


def merge_table(entries: Sequence[MergeEntry]) -> MergeTable:
    """Arrange merges: pairs in natural order (2 before 10), methods likewise.

    A failed merge has "x" for its AME, whatever its AME was; so has one that succeeded without an AME.

    Raises:
        ValueError: two entries are of the same pair and method; names both.
    """
    by_place: dict[tuple[str, str], MergeEntry] = {}
    for entry in entries:
        if (entry.pair, entry.method) in by_place:
            raise ValueError(f"pair {entry.pair} by {entry.method} is given twice")
        by_place[entry.pair, entry.method] = entry
    pairs = sorted({pair for pair, _ in by_place}, key=_natural)
    methods = sorted({method for _, method in by_place}, key=_natural)
    rows = []
    for pair in pairs:
        found = [by_place.get((pair, method)) for method in methods]
        marks = ["" if entry is None else _MARKS[entry.is_success] for entry in found]
        rows.append((pair, *marks, *(_ame(entry) for entry in found)))
    flat = sorted({entry.method for entry in entries if entry.is_2d}, key=_natural)
    notes = [f"AME of occupancy grids, in the plane: {', '.join(flat)}"] if flat else []
    if any(entry.is_success is None for entry in entries):
        notes.append("?: success unknown, the merge gave no transforms and no limit of the AME was set")
    if any(not cell for row in rows for cell in row):
        notes.append("empty: not given")
    return MergeTable(("Pair", *methods, *(f"{method} AME" for method in methods)), tuple(rows), tuple(notes))


def as_rich(table: MergeTable) -> Table:
    """The table for a terminal."""
    from rich import box
    from rich.table import Table

    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    marks = (len(table.header) - 1) // 2
    for i, name in enumerate(table.header):
        shown.add_column(name, justify="left" if i == 0 else "center" if i <= marks else "right")
    for row in table.rows:
        shown.add_row(*row)
    return shown


def as_csv(table: MergeTable) -> str:
    """The table as RFC 4180: commas, CRLF, quotes where they are needed; without the notes."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\r\n").writerows((table.header, *table.rows))
    return text.getvalue()


def as_latex(table: MergeTable) -> str:
    """The table as a `tabular` environment; the notes are comments before it."""
    lines = [f"% {note}" for note in table.notes]
    lines.append(f"\\begin{{tabular}}{{{'|'.join('c' * len(table.header))}}}")
    rows = [" & ".join(latex_text(cell) for cell in row) + " \\\\" for row in (table.header, *table.rows)]
    lines += [rows[0], "\\hline", *rows[1:], "\\end{tabular}"]
    return "\n".join(lines) + "\n"


def _ame(entry: MergeEntry | None) -> str:
    if entry is None:
        return ""
    return FAILED if entry.is_success is False or entry.ame is None else f"{entry.ame:.3f}"


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Sort key: numbers by value, other text as it is."""
    parts = re.split(r"([0-9]+)", name)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts if part]
