"""`maomaps-warp merge-table`: the paper's Tables IV and V from scores."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.report.merge_json import MergeEntry
from maomaps_warp.report.merge_table import as_csv, as_latex, merge_table

#: Four rows of the paper's Table IV (RTAB-MAP).
PAPER = {
    "9": {"MM1": None, "MM2": 0.127, "MM3": None},
    "10": {"MM1": 0.124, "MM2": None, "MM3": None},
    "3": {"MM1": 0.080, "MM2": 0.168, "MM3": 0.155},
    "20": {"MM1": 0.080, "MM2": None, "MM3": 0.261},
}


def document(pair: Any, method: str, success: Any, ame: float | None, **changes: Any) -> dict[str, Any]:
    names = {"kind": "merge score", "schema": 1, "pair": pair, "method": method}
    return {**names, "success": success, "metrics": {"ame": {"value": ame}, "ame_2d": {"value": None}}, **changes}


def write(folder: Path, *documents: dict[str, Any]) -> list[str]:
    paths = [folder / f"{number}.json" for number in range(len(documents))]
    for path, content in zip(paths, documents, strict=True):
        path.write_text(json.dumps(content))
    return [str(path) for path in paths]


@pytest.fixture
def results(tmp_path: Path) -> list[str]:
    return write(
        tmp_path,
        *(
            # What a failed merge's map has for an AME is not shown.
            document(pair, method, ame is not None, 0.9 if ame is None else ame)
            for pair, methods in PAPER.items()
            for method, ame in reversed(methods.items())
        ),
    )


def run(*arguments: object) -> Any:
    result = CliRunner().invoke(app, ["merge-table", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_rows_and_columns_are_those_of_the_paper_in_natural_order(results: list[str]):
    result = run(*results, "--format", "csv")
    assert result.exit_code == 0, result.stderr
    rows = list(csv.reader(io.StringIO(result.stdout)))
    assert rows == [
        ["Pair", "MM1", "MM2", "MM3", "MM1 AME", "MM2 AME", "MM3 AME"],
        ["3", "+", "+", "+", "0.080", "0.168", "0.155"],
        ["9", "-", "+", "-", "x", "0.127", "x"],
        ["10", "+", "-", "-", "0.124", "x", "x"],
        ["20", "+", "-", "+", "0.080", "x", "0.261"],
    ]


def test_text_shows_the_same_cells(results: list[str]):
    lines = [line.split() for line in run(*results).stdout.splitlines()]
    assert ["9", "-", "+", "-", "x", "0.127", "x"] in lines
    assert ["Pair", "MM1", "MM2", "MM3", "MM1", "AME", "MM2", "AME", "MM3", "AME"] in lines


def test_latex_is_a_tabular(results: list[str]):
    text = run(*results, "--format", "latex").stdout
    assert text.startswith("\\begin{tabular}{c|c|c|c|c|c|c}\n") and text.endswith("\\end{tabular}\n")
    assert "9 & - & + & - & x & 0.127 & x \\\\\n" in text


def test_latex_and_csv_escape_names():
    table = merge_table([MergeEntry("50% of_a & b", 'say "no", {x}\\', True, 0.1, False)])
    assert "50\\% of\\_a \\& b" in as_latex(table)
    assert "\\{x\\}\\textbackslash{}" in as_latex(table)
    assert as_csv(table).split("\r\n")[0] == 'Pair,"say ""no"", {x}\\","say ""no"", {x}\\ AME"'
    (_, row) = csv.reader(io.StringIO(as_csv(table)))
    assert row == ["50% of_a & b", "+", "0.100"]


def test_combinations_that_are_missing_unknown_or_without_ame_are_told_apart():
    table = merge_table(
        [
            MergeEntry("1", "A", True, None, False),
            MergeEntry("1", "B", None, 0.25, False),
            MergeEntry("2", "A", False, None, False),
            MergeEntry("2", "C", True, 0.5, True),
        ]
    )
    assert table.rows == (
        ("1", "+", "?", "", "x", "0.250", ""),
        ("2", "-", "", "+", "x", "", "0.500"),
    )
    notes = " / ".join(table.notes)
    assert "in the plane: C" in notes and "success unknown" in notes and "not given" in notes


def test_the_ame_of_an_occupancy_grid_stands_in_where_there_is_no_other(tmp_path: Path):
    flat = document("1", "A", True, None)
    flat["metrics"]["ame_2d"]["value"] = 0.3
    result = run(*write(tmp_path, flat))
    assert "0.300" in result.stdout and "in the plane: A" in result.stdout


def test_a_file_is_written_whole_and_not_replaced_unasked(results: list[str], tmp_path: Path):
    output = tmp_path / "table.csv"
    assert run(*results, "--format", "csv", "--output", output).exit_code == 0
    written = output.read_bytes()
    assert written.count(b"\r\n") == 5 == written.count(b"\n")
    again = run(*results, "--format", "latex", "--output", output)
    assert again.exit_code == 2 and "--overwrite" in again.stderr and output.read_bytes() == written
    assert run(*results, "--format", "latex", "--output", output, "--overwrite").exit_code == 0
    assert output.read_text().startswith("\\begin{tabular}")
    assert "is an input" in run(*results, "--output", results[0], "--overwrite").stderr


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "is no JSON"),
        ("[" * 100_000, "is no JSON"),
        ("[]", "not the score of a merge"),
        ('{"schema": 1, "metrics": {}}', "not the score of a merge"),
        (json.dumps(document("1", "A", True, 0.1, schema=2)), "schema 2"),
        (json.dumps(document("1", "A", True, 0.1, metrics={})), "is damaged"),
        (json.dumps(document(7, "A", True, 0.1)), "is damaged"),
        (json.dumps(document("1", "A", "yes", 0.1)), "is damaged"),
        (json.dumps(document("1", "A", 1, 0.1)), "is damaged"),
        ('{"kind": "merge score", "schema": 1, "pair": "1", "method": "A", "success": true, '
         '"metrics": {"ame": {"value": NaN}, "ame_2d": {"value": null}}}', "is damaged"),
    ],
)  # fmt: skip
def test_other_documents_are_refused_with_their_name(tmp_path: Path, content: str, words: str):
    path = tmp_path / "other.json"
    path.write_text(content)
    result = run(path)
    assert result.exit_code == 2 and result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert "other.json" in line and words in line


def test_an_absent_file_is_refused(tmp_path: Path):
    assert "no such file" in run(tmp_path / "absent.json").stderr


def test_the_same_pair_and_method_twice_is_refused(tmp_path: Path):
    result = run(*write(tmp_path, document("1", "A", True, 0.1), document("1", "A", False, None)))
    assert result.exit_code == 2 and "pair 1 by A is given twice" in result.stderr
