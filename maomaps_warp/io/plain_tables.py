"""Large tables of plain decimal numbers ("-12.35", "7", "1e-5"), parsed by the kernels' text parser.

What holds anything else (long numbers, comments between rows, empty lines, rows of unequal length, words) is left to
the careful reader, which reads it or says what is wrong. Both give the same numbers, bit for bit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.threads import thread_count

#: Smaller texts are read as fast without; loading Warp takes longer.
LEAST_BYTES = 1 << 20

#: Places in a text are int32.
_MOST_BYTES = (1 << 31) - 1
_LINE_FEED = 10
_WHITE = b" \t\n\r\v\f"
_SEPARATORS = re.compile(rb"[,;]\s*|\s+")
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


@dataclass(frozen=True, eq=False)
class PlainTable:
    """Numbers of a text, row by row.

    Attributes:
        values: (N, C) float64, N >= 1.
        first_line: the line that the first row stands on, from 1; each further row is one line on.
        delimited: whether commas or semicolons separate the cells.
    """

    values: NDArray[np.float64]
    first_line: int
    delimited: bool


def parse_plain_table(data: bytes) -> PlainTable | None:
    """Numbers of a text of equally long rows, with blanks, or one comma or semicolon, between them.

    Args:
        data: the text. Comment lines (`#`) at its start are passed over.

    Returns:
        The table; None if the text is not so plain, or damaged: the careful reader finds out.
    """
    import warp as wp

    from maomaps_warp.kernels.text_tables import parse_table

    first = _behind_comments(data)
    stop = len(data)
    while stop > first and data[stop - 1] in _WHITE:  # rstrip would copy it all
        stop -= 1
    # NaN, words and control characters are refused by the parser; a lone carriage return would pass for a blank.
    if first >= stop or len(data) > _MOST_BYTES or (b"\r" in data and data.count(b"\r") != data.count(b"\r\n")):
        return None
    if not data[:first].removeprefix(_BYTE_ORDER_MARK).isascii() or b"\0" in data[:first]:
        return None
    text = np.frombuffer(data, np.uint8)[first:stop]
    ends = np.append(np.flatnonzero(text == _LINE_FEED), len(text)).astype(np.int32)
    line = text[: ends[0]].tobytes().strip()
    is_delimited = b"," in line or b";" in line
    values, is_refused = parse_table(
        wp.array(text, dtype=wp.uint8, device="cpu", copy=False),
        wp.array(ends, dtype=wp.int32, device="cpu", copy=False),
        len(_SEPARATORS.split(line)),
        is_delimited=is_delimited,
        threads=thread_count(),
    )
    if is_refused.numpy().any():
        return None
    return PlainTable(values.numpy(), data.count(b"\n", 0, first) + 1, is_delimited)


def _behind_comments(data: bytes) -> int:
    """Where the first line that starts with no `#` begins."""
    start = len(_BYTE_ORDER_MARK) if data.startswith(_BYTE_ORDER_MARK) else 0
    while data.startswith(b"#", start):
        start = data.find(b"\n", start) + 1 or len(data)
    return start
