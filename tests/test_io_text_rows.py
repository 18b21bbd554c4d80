"""Rows of numbers as text: what a loop over rows would write."""

from __future__ import annotations

import numpy as np
import pytest

from maomaps_warp.io import text_rows as module
from maomaps_warp.io.text_rows import text_rows

RNG = np.random.default_rng(3)
NASTY = np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 1e-300, 1e20, 0.1, -12.35, 123456789.125])


def joined(columns, spell):
    return "".join(" ".join(map(spell, row)) + "\n" for row in zip(*columns, strict=True))


@pytest.mark.parametrize("spell", [str, lambda number: f"{number:.9g}"], ids=["str", "9g"])
@pytest.mark.parametrize("count", [0, 1, 7, 500])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rows_are_those_of_a_loop(monkeypatch, spell, count, dtype):
    monkeypatch.setattr(module, "BLOCK_ROWS", 64)
    columns = [
        RNG.choice(NASTY, count).astype(dtype),
        RNG.normal(size=count).astype(dtype),
        (RNG.integers(-9, 9, count) * 0.05).astype(dtype),
        RNG.integers(0, 256, count).astype(np.uint8),
    ]
    assert b"".join(text_rows(columns, spell)).decode() == joined(columns, spell)


def test_columns_of_a_matrix_need_not_be_contiguous():
    matrix = np.arange(12.0).reshape(4, 3)
    assert b"".join(text_rows(list(matrix.T), str)).decode() == joined(matrix.T, str)
