"""`maomaps-warp merge-table`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from maomaps_warp.cli.options import Debug

if TYPE_CHECKING:
    from maomaps_warp.report.merge_json import MergeEntry
    from maomaps_warp.report.merge_table import MergeTable


def merge_table(
    results: Annotated[list[Path], typer.Argument(help="Files that `score-merge --json` wrote.")],
    format: Annotated[Literal["text", "csv", "latex"], typer.Option(help="Of the table.")] = "text",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the table here instead of printing it.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a file that exists.")] = False,
    debug: Debug = False,
) -> None:
    """Print many merges as the paper's tables: a row a pair; for each method + or -, and the AME or x.

    A failed merge has x for its AME; ? is a merge whose success cannot be told; an empty cell was not given.
    """
    from maomaps_warp.cli.terminal import user_errors
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.outputs import check_writable, write_whole
    from maomaps_warp.report import merge_table as report

    with user_errors(debug):
        if output is not None:
            if output.is_file() and not overwrite:
                raise InputError(output, "exists already", "--overwrite replaces it")
            if output.resolve() in {path.resolve() for path in results}:
                raise InputError(f"--output {output}", "is an input", "give it a file of its own")
            check_writable(output)
        try:
            table = report.merge_table([_entry(path) for path in results])
        except ValueError as error:
            raise InputError(
                "merge-table", str(error), "name them apart by --pair and --method of score-merge"
            ) from None
        if format == "text":
            text = _rendered(table)
        else:
            text = report.as_csv(table) if format == "csv" else report.as_latex(table)
        if output is None:
            typer.echo(text, nl=False)
            return
        with write_whole(output, "wb") as file:
            file.write(text.encode())  # bytes: CSV ends its lines in CRLF on every system


def _rendered(table: MergeTable) -> str:
    """The table for a terminal, and its notes, as plain text."""
    from rich.console import Console

    from maomaps_warp.report.merge_table import as_rich

    wide = Console(width=10_000, color_system=None)
    with wide.capture() as captured:
        wide.print(as_rich(table))
    lines = [line.rstrip() for line in captured.get().splitlines()]
    return "\n".join([*lines, *table.notes]).strip("\n") + "\n"


def _entry(path: Path) -> MergeEntry:
    import json

    from maomaps_warp.errors import InputError
    from maomaps_warp.io.tables import decode_text, read_bytes
    from maomaps_warp.report.merge_json import merge_entry

    try:
        document = json.loads(decode_text(path, read_bytes(path)))
    except (ValueError, RecursionError) as error:
        raise InputError(
            path, f"is no JSON: {error}", "give files that `maomaps-warp score-merge --json` wrote"
        ) from None
    return merge_entry(str(path), document)
