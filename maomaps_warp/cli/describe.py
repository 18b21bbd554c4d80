"""`maomaps-warp describe`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from maomaps_warp.cli.options import Debug

if TYPE_CHECKING:
    from maomaps_warp.model.dataset import DatasetFigures

TableFormat = Literal["text", "csv", "latex", "json"]


def describe(
    dataset: Annotated[Path, typer.Argument(help="Folder of sample directories, or one sample directory.")],
    format: Annotated[TableFormat, typer.Option(help="Of the table.")] = "text",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the table here instead of printing it.")
    ] = None,
    ground: Annotated[
        str, typer.Option(metavar="RULE", help="Ground of the projections: robust, original, or a height in metres.")
    ] = "robust",
    voxel_size: Annotated[float, typer.Option(metavar="M", help="Edge of a voxel of the maps.")] = 0.05,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace --output if it exists.")] = False,
    debug: Debug = False,
) -> None:
    """Print the figures of every sample of a dataset: the paper's Table II.

    Path lengths, durations, three IoUs, elements of the merged map, size of its projection. Exit code 3: a sample's
    files are missing or damaged; its row says which.
    """
    from maomaps_warp.cli.terminal import EXIT_NO_SCORE, complain, console, progress_clock, user_errors
    from maomaps_warp.io.outputs import write_whole
    from maomaps_warp.jobs.describe import describe_dataset
    from maomaps_warp.report.dataset_table import dataset_tables

    with user_errors(debug):
        _check_options(dataset, output, overwrite, voxel_size)
        with progress_clock() as clock:
            found = describe_dataset(dataset, voxel_size=voxel_size, ground=ground, clock=clock)
        if output is not None:
            with write_whole(output) as file:
                file.write(_text(found, format))
        elif format == "text":
            out = console()
            for part in dataset_tables(found):
                out.print(part, soft_wrap=isinstance(part, str))
        else:
            typer.echo(_text(found, format), nl=False)
        incomplete = [sample for sample in found.samples if sample.problems]
        for sample in incomplete:
            complain(f"{sample.name}: {'; '.join(sample.problems)}")
        if incomplete:
            raise typer.Exit(EXIT_NO_SCORE)


def _check_options(dataset: Path, output: Path | None, overwrite: bool, voxel_size: float) -> None:
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.outputs import check_writable
    from maomaps_warp.io.sample_directories import is_sample_file

    if not 0.0 < voxel_size <= 1e10:
        raise InputError(f"--voxel-size {voxel_size:g}", "must be a number of metres above 0")
    if output is not None:
        if output.is_file() and not overwrite:
            raise InputError(output, "exists already", "--overwrite replaces it")
        folder = output.resolve().parent
        if dataset.resolve() in (folder, folder.parent) and is_sample_file(output.name):
            raise InputError(output, "is an input", "give the table a file of its own")
        check_writable(output)


def _text(dataset: DatasetFigures, format: TableFormat) -> str:
    """The table as the text of a file."""
    import io

    from rich.console import Console

    from maomaps_warp.report.dataset_table import dataset_csv, dataset_document, dataset_latex, dataset_tables

    if format == "csv":
        return dataset_csv(dataset)
    if format == "latex":
        return dataset_latex(dataset)
    if format == "json":
        return json.dumps(dataset_document(dataset), indent=2, allow_nan=False) + "\n"
    page = Console(file=io.StringIO(), width=160, highlight=False, markup=False, emoji=False)
    with page.capture() as captured:
        for part in dataset_tables(dataset):
            page.print(part, soft_wrap=isinstance(part, str))
    return captured.get()
