"""Plain decimal numbers: parsed in blocks, they are what Python's float makes of them; everything else is refused."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from maomaps_warp.errors import InputError
from maomaps_warp.io.plain_tables import parse_plain_table
from maomaps_warp.io.tables import read_table

# Where Warp is loaded, large maps are parsed by a kernel.
pytest.importorskip("warp")

RNG = np.random.default_rng(11)

#: Numbers as files spell them: of one to twenty digits, with and without a point and a sign.
plain_numbers = st.from_regex(r"[+-]?([0-9]{1,8}(\.[0-9]{0,7})?|\.[0-9]{1,15})", fullmatch=True)
other_numbers = st.from_regex(r"[+-]?[0-9]{1,3}(\.[0-9]{1,3})?([eE][+-]?1?[0-9])?", fullmatch=True)
long_numbers = st.from_regex(r"-?[0-9]{1,12}\.[0-9]{1,12}([eE][+-]?[0-9]{1,3})?", fullmatch=True)


def bits(values):
    return np.ascontiguousarray(values, np.float64).view(np.uint64)


@settings(max_examples=200, deadline=None)
@given(st.lists(plain_numbers | other_numbers, min_size=1, max_size=60))
def test_every_number_is_the_float_of_its_text_bit_for_bit(words):
    table = parse_plain_table(" ".join(words).encode())
    assert table is not None
    np.testing.assert_array_equal(bits(table.values[0]), bits([float(word) for word in words]))


@settings(max_examples=200, deadline=None)
@given(st.lists(long_numbers, min_size=1, max_size=3))
def test_a_long_number_is_exact_or_left_to_the_careful_reader(words):
    table = parse_plain_table(" ".join(words).encode())
    if table is not None:
        np.testing.assert_array_equal(bits(table.values[0]), bits([float(word) for word in words]))


@pytest.mark.parametrize("threads", ["1", "3"])
@pytest.mark.parametrize("decimals", [0, 1, 2, 4, 6, 8, 12])
def test_columns_of_any_precision_are_exact_over_many_blocks(monkeypatch, decimals, threads):
    monkeypatch.setenv("MAOMAPS_THREADS", threads)
    words = [[f"{value:.{decimals}f}" for value in row] for row in RNG.normal(size=(9000, 3)) * 40.0]
    table = parse_plain_table("".join(" ".join(row) + "\n" for row in words).encode())
    assert table is not None
    np.testing.assert_array_equal(bits(table.values), bits([[float(word) for word in row] for row in words]))
    assert table.first_line == 1


@pytest.mark.parametrize("word", ["0", "-0", "-0.0", "5.", ".5", "-.5", "007", "99999999", "-99999999", "9999999.9"])
@pytest.mark.parametrize("neighbour", ["1", "-1234567.1234567", "1e-5"])
def test_numbers_at_the_edges_of_a_word_are_exact(word, neighbour):
    table = parse_plain_table(f"{word} {neighbour} {word}".encode())
    assert table is not None
    np.testing.assert_array_equal(bits(table.values[0]), bits([float(x) for x in (word, neighbour, word)]))


@pytest.mark.parametrize(
    "word",
    ["-", ".", "-.", "--1", "1-", "1-2", "1.2.3", "1..2", "/1", "1/2", "1:2", "x", "1x", "nan", "inf", "1_0", "0x1"]
    + ["1234567.1234567.1", "-1234567-1234567", "12345678-", ".1234567.", "1e", "e5", "\x7f1", "1é", "1\x00", "1\x0b2"],
)
@pytest.mark.parametrize("row", ["{}", "1 {}", "1 2\n3 {}\n"])
def test_what_is_no_plain_number_is_left_to_the_careful_reader(word, row):
    assert parse_plain_table(row.format(word).encode()) is None


@pytest.mark.parametrize(
    "text", ["", "\n \n", "1 2\n3\n", "1\n2 3\n", "1 2\n3 4 5 6\n", "1 2\n3 4 5\n6\n", "1 2 # x\n"]
)
def test_rows_of_unequal_length_and_inner_comments_are_left_to_the_careful_reader(text):
    assert parse_plain_table(text.encode()) is None


@pytest.mark.parametrize("text", ["1,,2", ",1,2", "1, ,2", "1 2,3", "1,2 3", "1,2,,", "1 , 2", "1,2\n3 4\n"])
def test_cells_in_doubt_are_left_to_the_careful_reader(text):
    assert parse_plain_table(text.encode()) is None


@pytest.mark.parametrize(
    ("text", "first_line"),
    [
        ("1 2\n3 4", 1),
        ("1 2\r\n3 4\r\n\r\n", 1),
        (" 1  2 \n3\t4\n\n\n", 1),
        ("# a, b\n#c\n1 2\n3 4\n", 3),
        ("\ufeff1 2\n3 4\n", 1),
        ("1,2\n3, 4\n", 1),
        ("1;2 \n3;4\n", 1),
    ],
)
def test_comments_on_top_line_ends_and_separators_are_understood(text, first_line):
    table = parse_plain_table(text.encode())
    assert table is not None
    assert table.values.tolist() == [[1, 2], [3, 4]]
    assert table.first_line == first_line
    assert table.delimited == any(mark in text.replace("a, b", "") for mark in ",;")


@pytest.mark.parametrize("text", ["\n1 2\n3 4\n", "1 2\n\n3 4\n", "1 2\n# x\n3 4\n", "1 2\r3 4\n", "1;2;\n3;4;\n"])
def test_empty_lines_and_odd_line_ends_are_left_to_the_careful_reader(text):
    assert parse_plain_table(text.encode()) is None


@pytest.mark.parametrize("head", ["# a\n", "1.50 2\n\n", "% a\n", ""])
def test_both_readers_give_the_same_table(tmp_path, monkeypatch, head):
    path = tmp_path / "table.txt"
    rows = "".join(f"{a:.3f} {b:.7g}\n" for a, b in RNG.normal(size=(500, 2)) * 100.0)
    path.write_text(head + rows, encoding="utf-8")
    careful = read_table(path, is_map=True)
    monkeypatch.setattr("maomaps_warp.io.tables.LEAST_BYTES", 1)
    quick = read_table(path, is_map=True)
    np.testing.assert_array_equal(bits(quick.values), bits(careful.values))
    np.testing.assert_array_equal(quick.lines, careful.lines)
    assert quick.delimited == careful.delimited


def test_a_damaged_large_map_is_refused_at_its_line(tmp_path, monkeypatch):
    monkeypatch.setattr("maomaps_warp.io.tables.LEAST_BYTES", 1)
    path = tmp_path / "map.txt"
    path.write_text("# map\n" + "1 2 3\n" * 700 + "1 2 x\n" + "1 2 3\n" * 700, encoding="utf-8")
    with pytest.raises(InputError, match=r"map\.txt, line 702: 'x' is not a number"):
        read_table(path, is_map=True)


def test_reading_a_large_map_does_not_load_warp_where_nothing_else_does(tmp_path):
    path = tmp_path / "table.txt"
    path.write_text("1 2 3 4 5 6 7 8\n" * 200_000, encoding="utf-8")
    code = "import sys; from pathlib import Path; from maomaps_warp.io.tables import read_table; "
    code += f"read_table(Path({str(path)!r}), is_map=True); print('warp' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
