"""Tables of numbers in text files, and what a file looks like when it is none."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.plain_tables import LEAST_BYTES, parse_plain_table

#: First bytes of files that people hand over by mistake, and what to call them.
SIGNATURES = (
    (b"#ROSBAG", "a ROS 1 bag"),
    (b"\x89MCAP", "an MCAP recording"),
    (b"SQLite format 3", "a SQLite file (ROS 2 bag)"),
    (b"PK\x03\x04", "a zip or NPZ archive"),
    (b"PK\x05\x06", "an empty zip or NPZ archive"),
    (b"\x93NUMPY", "a NumPy array file"),
    (b"# Octomap OcTree", "an OctoMap file"),
    (b"# .PCD", "a PCD point cloud"),
    (b"VERSION .", "a PCD point cloud"),
    (b"VERSION 0.", "a PCD point cloud"),
    (b"ply\n", "a PLY file"),
    (b"ply\r", "a PLY file"),
    (b"glTF", "a glTF model"),
    (b"LASF", "a LAS point cloud"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"\xfd7zXZ", "an xz archive"),
    (b"%PDF", "a PDF"),
)

#: How much of a file is looked at to recognise it, bytes.
HEAD_BYTES = 1 << 16
#: How many rows must agree on their number of columns before a text counts as a table.
HEAD_ROWS = 20

_SEPARATORS = str.maketrans(",;", "  ")
_EMPTY_CELL = re.compile(r"^\s*[,;]|[,;]\s*[,;]")
_BLANK_BETWEEN_CELLS = re.compile(r"[^\s,;]\s+[^\s,;]")


@dataclass(frozen=True, eq=False)
class Table:
    """Numbers of a text file, row by row.

    Attributes:
        path: the file.
        values: (N, C) float64, N >= 1.
        lines: (N,) int64, the line each row stands on, from 1.
        first: the first column as text, for numbers that float64 cannot hold; empty unless asked for.
        delimited: whether commas or semicolons separate the cells.
    """

    path: Path
    values: NDArray[np.float64]
    lines: NDArray[np.int64]
    first: tuple[str, ...] = ()
    delimited: bool = False

    def __len__(self) -> int:
        return len(self.values)

    def where(self, row: int) -> str:
        """The place of a row, for messages."""
        return place(self.path, int(self.lines[row]))


def place(path: Path, line: int) -> str:
    """A line of a file, for messages."""
    return f"{path}, line {line}"


def read_table(path: Path, *, columns: set[int] | None = None, keep_first: bool = False, is_map: bool = False) -> Table:
    """Reads a table of numbers: blanks, commas or semicolons between them, `#`, `%` and `//` comments.

    Args:
        path: a UTF-8 text file, with or without byte order mark, with any line ends.
        columns: the numbers of columns that are allowed; None for any.
        keep_first: also keep the first column as text.
        is_map: large ones are parsed by a kernel where Warp is loaded anyway; the numbers are the same.

    Raises:
        InputError: the file cannot be read, is not text, holds no row, something that is no number, rows of
            unequal length or a number of columns that is not allowed.
    """
    path = Path(path)
    data = read_bytes(path)
    table = None
    is_large = len(data) >= LEAST_BYTES and signature(data) is None
    if is_map and not keep_first and is_large and "warp" in sys.modules:
        table = _read_plainly(path, data)
    table = table or _read_carefully(path, data, keep_first)
    count = table.values.shape[1]
    if columns is not None and count not in columns:
        allowed = " or ".join(str(column) for column in sorted(columns))
        raise InputError(table.where(0), f"{_counted(count)} a row", f"{allowed} are expected here")
    return table


def _read_plainly(path: Path, data: bytes) -> Table | None:
    """The table of a text of plain decimal numbers, which most are; None if it is not so plain."""
    plain = parse_plain_table(data)
    if plain is None:
        return None
    lines = np.arange(plain.first_line, plain.first_line + len(plain.values))
    return Table(path, plain.values, lines, (), plain.delimited)


def _read_carefully(path: Path, data: bytes, keep_first: bool) -> Table:
    """The table of any text that is one; finds what is wrong with one that is none."""
    rows, lines = data_rows(decode_text(path, data))
    if not rows:
        raise InputError(path, "holds no rows of numbers")
    rows, delimited = _undelimited(path, rows, lines)
    values = parse_rows(path, rows, lines)
    first = tuple(row.split(None, 1)[0] for row in rows) if keep_first else ()
    return Table(path, values, np.array(lines, np.int64), first, delimited)


def check_finite(table: Table) -> None:
    """Raise InputError, with the place, if a value is NaN or infinite."""
    if not np.isfinite(table.values).all():
        bad = np.flatnonzero(~np.isfinite(table.values).all(axis=1))
        found = "a value is NaN or infinite" + (f"; {len(bad)} rows are so" if len(bad) > 1 else "")
        raise InputError(table.where(int(bad[0])), found, "remove such rows")


def not_of_kind(path: Path, what: str, hint: str, meanings: Mapping[int, str] | None = None) -> InputError:
    """The error that a file or folder is not `what` ("a trajectory"), but looks like something else.

    Args:
        path: a file that was not recognised, or a folder.
        what: what was expected.
        hint: what is allowed.
        meanings: what a text with so many values a row usually is.
    """
    if path.is_dir():
        return InputError(path, "is a folder", f"{what} file is expected here")
    known = signature(read_bytes(path, HEAD_BYTES))
    if known is not None:
        return InputError(path, f"is {known}, not {what}", hint)
    columns = read_table(path).values.shape[1]  # tells what is wrong with a text that is no table
    meaning = f", as in {meanings[columns]}" if meanings and columns in meanings else ""
    return InputError(path, f"not {what}: {_counted(columns)} a row{meaning}", hint)


def read_bytes(path: Path, size: int = -1) -> bytes:
    """The first `size` bytes of a file, or all of them; raises InputError where it cannot be read."""
    try:
        with Path(path).open("rb") as file:
            return file.read(size)
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except IsADirectoryError:
        raise InputError(path, "is a folder", "a file is expected here") from None
    except PermissionError:
        raise InputError(path, "cannot be read: permission denied") from None
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error


def signature(head: bytes) -> str | None:
    """What a file is by its first bytes ("a ROS 1 bag"), or None if they say nothing."""
    return next((name for magic, name in SIGNATURES if head.startswith(magic)), None)


def decode_text(path: Path, data: bytes) -> str:
    """The text of a file; raises InputError, saying what it looks like, where it is none."""
    if not data:
        raise InputError(path, "is empty (0 bytes)")
    known = signature(data)
    if known is not None:
        raise InputError(path, f"is {known}, not a text table")
    if b"\0" in data:
        raise InputError(path, "holds binary data (or UTF-16 text), not a text table", "save it as UTF-8 text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(place(path, line), "is not UTF-8 text", "save it as UTF-8 text") from None


def data_rows(text: str, first_line: int = 1, *, most: int | None = None) -> tuple[list[str], list[int]]:
    """The lines of a text that hold data (the first `most` of them), stripped, without comments; and their numbers."""
    rows: list[str] = []
    lines: list[int] = []
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), first_line):
        row = line.partition("#")[0].strip()
        if row and row[0] != "%" and not row.startswith("//"):
            rows.append(row)
            lines.append(number)
            if len(rows) == most:
                break
    return rows, lines


def parse_rows(path: Path, rows: Sequence[str], lines: Sequence[int]) -> NDArray[np.float64]:
    """Numbers of blank-separated rows, one or more: (N, C) float64; raises InputError at the first fault."""
    try:
        return np.loadtxt(rows, dtype=np.float64, comments=None, ndmin=2)
    except ValueError:
        raise _first_fault(path, rows, lines) from None


def column_count(head: bytes) -> tuple[int, bool] | None:
    """How many numbers a row of this text holds, and whether they are delimited; None if it is no table.

    Args:
        head: the first bytes of a file.
    """
    if signature(head) is not None or b"\0" in head:
        return None
    text = head.decode("utf-8-sig", errors="replace")
    if len(head) >= HEAD_BYTES:
        text = text[: max(text.rfind("\n"), text.rfind("\r")) + 1]  # the last line may be cut off
    rows = data_rows(text, most=HEAD_ROWS)[0]
    cells = [row.translate(_SEPARATORS).split() for row in rows]
    if not cells or len({len(row) for row in cells}) > 1 or not all(_is_number(cell) for row in cells for cell in row):
        return None
    return len(cells[0]), any("," in row or ";" in row for row in rows)


def _undelimited(path: Path, rows: list[str], lines: list[int]) -> tuple[list[str], bool]:
    """The rows with blanks in the place of commas and semicolons, and whether there were any."""
    if not any("," in row or ";" in row for row in rows):
        return rows, False
    for row, line in zip(rows, lines, strict=True):
        is_empty, is_mixed = _EMPTY_CELL.search(row), _BLANK_BETWEEN_CELLS.search(row)
        if (is_empty or is_mixed) and (word := _first_word(row)) is not None:
            raise _no_number(path, line, word, line == lines[0])
        if is_empty:
            raise InputError(place(path, line), "an empty cell", "fill it in or remove the row")
        if is_mixed:
            raise InputError(
                place(path, line),
                f"{row[:40]!r}: both blanks and commas stand between the numbers",
                "use one of them; decimal commas are not understood",
            )
    return [row.translate(_SEPARATORS) for row in rows], True


def _first_fault(path: Path, rows: Sequence[str], lines: Sequence[int]) -> InputError:
    expected = len(rows[0].split())
    for row, line in zip(rows, lines, strict=True):
        if (word := _first_word(row)) is not None:
            return _no_number(path, line, word, line == lines[0])
        if (count := len(row.split())) != expected:
            found = f"{_counted(count)}, but the first row (line {lines[0]}) has {expected}"
            return InputError(place(path, line), found, "the file is cut off, or two tables stand in it")
    return InputError(path, "cannot be read as a table of numbers")


def _first_word(row: str) -> str | None:
    """The first cell that is no number."""
    return next((cell for cell in row.translate(_SEPARATORS).split() if not _is_number(cell)), None)


def _no_number(path: Path, line: int, word: str, is_first: bool) -> InputError:
    hint = "put # before a header line" if is_first else ""
    return InputError(place(path, line), f"{word[:40]!r} is not a number", hint)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell and cell.isascii()  # Python reads 1_000 and other alphabets' digits; files do not mean them


def _counted(count: int) -> str:
    return f"{count} value" if count == 1 else f"{count} values"
