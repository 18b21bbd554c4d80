"""Tables of numbers: the dresses in which text comes."""

from __future__ import annotations

import pytest

from maomaps_warp.errors import InputError
from maomaps_warp.io.tables import read_table
from maomaps_warp.io.trajectories import read_trajectory

TUM = "1.5 1 2 3 0 0 0 1\n1.6 1 2 4 0 0 0 1\n"


def written(folder, text, name="run.txt"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return path


@pytest.mark.parametrize(
    "text",
    [
        b"\xef\xbb\xbf" + TUM.encode(),
        TUM.replace("\n", "\r\n"),
        TUM.replace("\n", "\r"),
        "# stamp x y z\n\n% more\n// and more\n" + TUM,
        TUM.replace("\n", "  # note\n"),
        TUM.replace(" ", "\t"),
        TUM.strip(),
    ],
    ids=["byte-order-mark", "crlf", "cr", "comments", "trailing-comments", "tabs", "no-last-newline"],
)
def test_text_may_come_in_many_dresses(tmp_path, text):
    plain = read_trajectory(written(tmp_path, TUM, "plain.txt"))
    dressed = read_trajectory(written(tmp_path, text))
    assert (dressed.T_world_camera == plain.T_world_camera).all()
    assert (dressed.stamps_ns == plain.stamps_ns).all()


@pytest.mark.parametrize("separator", [",", ", ", ";", " ; "])
def test_separated_columns_are_read_in_a_forced_format(tmp_path, separator):
    path = written(tmp_path, TUM.replace(" ", separator))
    assert read_trajectory(path, format="tum").stamps_ns.tolist() == [1_500_000_000, 1_600_000_000]


def test_line_numbers_count_comments_and_blank_lines(tmp_path):
    table = read_table(written(tmp_path, "# a\n\n1 2 3\n\n4 5 6\n"))
    assert table.lines.tolist() == [3, 5]
    assert table.values.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_the_first_column_is_kept_as_text_on_demand(tmp_path):
    path = written(tmp_path, "1403715524907143168, 2\n1.50e0, 3\n")
    assert read_table(path).first == ()
    assert read_table(path, keep_first=True).first == ("1403715524907143168", "1.50e0")
    assert read_table(path).delimited


def test_a_number_of_columns_that_is_not_allowed_is_refused(tmp_path):
    path = written(tmp_path, "# note\n1 2 3\n")
    with pytest.raises(InputError, match=r"line 2: 3 values a row \(1 or 4 are expected here\)"):
        read_table(path, columns={1, 4})
    assert len(read_table(path, columns={3})) == 1


@pytest.mark.parametrize("row", ["1,,2", ",1,2", "1, ,2"])
def test_an_empty_cell_is_refused(tmp_path, row):
    with pytest.raises(InputError, match="line 1: an empty cell"):
        read_table(written(tmp_path, row))


def test_a_separator_at_the_end_of_a_row_means_nothing(tmp_path):
    assert read_table(written(tmp_path, "1,2,\n3,4,\n")).values.tolist() == [[1, 2], [3, 4]]
