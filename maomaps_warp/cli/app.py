"""The application and its commands, one file each."""

from __future__ import annotations

import sys
from typing import Any

import typer
from typer.core import TyperGroup

from maomaps_warp.cli.check import check
from maomaps_warp.cli.demo import demo
from maomaps_warp.cli.describe import describe
from maomaps_warp.cli.explain import explain
from maomaps_warp.cli.extract import extract
from maomaps_warp.cli.map import map_recording
from maomaps_warp.cli.merge import merge
from maomaps_warp.cli.merge_table import merge_table
from maomaps_warp.cli.pack import pack
from maomaps_warp.cli.project import project
from maomaps_warp.cli.sample import sample
from maomaps_warp.cli.score import score
from maomaps_warp.cli.score_2d import score_2d
from maomaps_warp.cli.score_merge import score_merge
from maomaps_warp.cli.terminal import EXIT_BAD_INPUT, complain
from maomaps_warp.cli.transform import transform

#: Base of every error about the words of a command; typer exports only this one's child.
_UsageError: Any = typer.BadParameter.__base__


class _OneLineErrors(TyperGroup):
    """Says in one line what is wrong with a command, as for every other bad input."""

    def main(self, *args: Any, **options: Any) -> Any:
        standalone = options.pop("standalone_mode", True)
        options["standalone_mode"] = False
        if not standalone:
            return super().main(*args, **options)
        try:
            code = super().main(*args, **options)
        except _UsageError as error:
            complain(f"{error.format_message().replace('Value error, ', '')} (see --help)")
            sys.exit(EXIT_BAD_INPUT)
        except typer.Abort:
            sys.exit(130)
        sys.exit(code if isinstance(code, int) else 0)


app = typer.Typer(
    name="maomaps-warp",
    help="Measure how good the maps of visual SLAM are.",
    cls=_OneLineErrors,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(asked: bool) -> None:
    if asked:
        from maomaps_warp.report.json_report import versions

        typer.echo(f"maomaps-warp {versions()['maomaps-warp']}")
        raise typer.Exit()


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    """Measure how good the maps of visual SLAM are."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


app.command()(score)
app.command()(demo)
app.command()(explain)
app.command()(check)
app.command("map")(map_recording)
app.command()(sample)
app.command()(describe)
app.command()(transform)
app.command()(extract)
app.command()(pack)
app.command()(merge)
app.command("score-merge")(score_merge)
app.command("merge-table")(merge_table)
app.command()(project)
app.command("score-2d")(score_2d)


def main() -> None:
    """Entry point of `maomaps-warp`."""
    app()
