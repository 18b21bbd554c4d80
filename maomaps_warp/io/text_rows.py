"""Rows of numbers as text, many at a time.

The idea: columns of maps repeat few different numbers (voxel centres, colours), so each is turned into text once, into
a table of equally wide cells padded by zero bytes; rows are gathered from the tables, and the padding is taken out of
the whole block at once. The cost: a sort of each column, and a few bytes copied for each that is written. The limit:
numbers that do not repeat cost one call of `spell` each; where most do not, rows are joined one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Rows that are put together at a time.
BLOCK_ROWS = 1 << 15


def text_rows(columns: Sequence[NDArray[Any]], spell: Callable[[Any], str]) -> Iterator[bytes]:
    """Lines of numbers with one blank between them, each ended by a line feed.

    Args:
        columns: (N,) arrays, of any numeric types.
        spell: the text of a number; ASCII. It is asked once for each number of a column.

    Yields:
        Some lines.
    """
    contiguous = [np.ascontiguousarray(column) for column in columns]
    distinct = [np.unique(_bits(column)) for column in contiguous]
    if 2 * sum(map(len, distinct)) > sum(map(len, contiguous)):
        yield from _joined_rows(contiguous, spell)
        return
    spelled = [_spelled(column, bits, spell) for column, bits in zip(contiguous, distinct, strict=True)]
    cells = [(f"cell{place}", table.dtype) for place, (table, _) in enumerate(spelled)]
    ends = [(f"end{place}", "u1") for place in range(len(spelled))]
    row = np.dtype([field for pair in zip(cells, ends, strict=True) for field in pair])
    for start in range(0, len(columns[0]), BLOCK_ROWS):
        block = slice(start, start + BLOCK_ROWS)
        rows = np.empty(len(columns[0][block]), row)
        for place, (table, index) in enumerate(spelled):
            rows[f"cell{place}"] = table[index[block]]
            rows[f"end{place}"] = ord("\n") if place == len(spelled) - 1 else ord(" ")
        characters = rows.view(np.uint8)
        yield characters[characters != 0].tobytes()


def _joined_rows(columns: Sequence[NDArray[Any]], spell: Callable[[Any], str]) -> Iterator[bytes]:
    for start in range(0, len(columns[0]), BLOCK_ROWS):
        texts = (map(spell, column[start : start + BLOCK_ROWS]) for column in columns)
        yield ("\n".join(map(" ".join, zip(*texts, strict=True))) + "\n").encode("ascii")


def _bits(column: NDArray[Any]) -> NDArray[Any]:
    # Compared by their bits: 0 and -0 are spelled differently, and NaN is equal to itself.
    return column.view(f"u{column.dtype.itemsize}")


def _spelled(
    column: NDArray[Any], distinct: NDArray[Any], spell: Callable[[Any], str]
) -> tuple[NDArray[np.bytes_], NDArray[np.intp]]:
    """The texts of the different numbers of a column, given by their bits, and which of them stands where."""
    texts = [spell(number).encode("ascii") for number in distinct.view(column.dtype)]
    return np.array(texts, dtype=np.bytes_), np.searchsorted(distinct, _bits(column))
