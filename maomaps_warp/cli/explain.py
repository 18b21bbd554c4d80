"""`maomaps-warp explain`."""

from __future__ import annotations

from typing import Annotated

import typer

from maomaps_warp.cli.options import Debug


def explain(
    name: Annotated[str, typer.Argument(help="maomaps, paper, slam_comparison, or a .toml file")] = "maomaps",
    toml: Annotated[bool, typer.Option("--toml", help="Print it as a TOML file to edit.")] = False,
    debug: Debug = False,
) -> None:
    """Print a protocol's formulas and constants with their sources."""
    from maomaps_warp.cli.terminal import user_errors
    from maomaps_warp.protocol_files import load_protocol, to_toml
    from maomaps_warp.report import explain as report

    with user_errors(debug):
        protocol = load_protocol(name)
        typer.echo(to_toml(protocol) if toml else report.explain(protocol), nl=False)
