"""`maomaps-warp explain`."""

from __future__ import annotations

from typing import Annotated

import typer

from maomaps_warp.cli.options import Debug


def explain(
    name: Annotated[
        str, typer.Argument(help="maomaps, paper, slam_comparison, gt_map_creator, or a .toml file")
    ] = "maomaps",
    map: Annotated[
        bool, typer.Option("--map", help="The protocol of `map` with this name, not that of `score`.")
    ] = False,
    toml: Annotated[bool, typer.Option("--toml", help="Print it as a TOML file to edit.")] = False,
    debug: Debug = False,
) -> None:
    """Print a protocol's formulas and constants with their sources."""
    from maomaps_warp.cli.terminal import user_errors
    from maomaps_warp.map_protocol import MAP_PRESETS
    from maomaps_warp.protocol import PRESETS
    from maomaps_warp.protocol_files import load_map_protocol, load_protocol, to_toml
    from maomaps_warp.report import explain as report

    with user_errors(debug):
        if map or name in MAP_PRESETS.keys() - PRESETS.keys():
            map_protocol = load_map_protocol(name)
            text = to_toml(map_protocol) if toml else report.explain_map(map_protocol)
        else:
            protocol = load_protocol(name)
            text = to_toml(protocol) if toml else report.explain(protocol)
        typer.echo(text, nl=False)
