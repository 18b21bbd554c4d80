"""The application and its commands, one file each."""

from __future__ import annotations

import typer

from maomaps_warp.cli.demo import demo
from maomaps_warp.cli.explain import explain
from maomaps_warp.cli.score import score

app = typer.Typer(
    name="maomaps-warp",
    help="Measure how good the maps of visual SLAM are.",
    no_args_is_help=True,
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


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    """Measure how good the maps of visual SLAM are."""


app.command()(score)
app.command()(demo)
app.command()(explain)


def main() -> None:
    """Entry point of `maomaps-warp`."""
    app()
