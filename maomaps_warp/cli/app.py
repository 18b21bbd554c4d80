"""The application and its commands, one file each; a command's file is loaded when that command is run."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

from maomaps_warp.cli import EXIT_INTERRUPTED
from maomaps_warp.cli.terminal import EXIT_BAD_INPUT, complain

#: Name of each command, in the order of the help, and the function in `maomaps_warp.cli` that is it.
_COMMANDS = {
    "score": "score.score",
    "demo": "demo.demo",
    "explain": "explain.explain",
    "check": "check.check",
    "map": "map.map_recording",
    "sample": "sample.sample",
    "describe": "describe.describe",
    "transform": "transform.transform",
    "extract": "extract.extract",
    "pack": "pack.pack",
    "merge": "merge.merge",
    "score-merge": "score_merge.score_merge",
    "merge-table": "merge_table.merge_table",
    "project": "project.project",
    "record": "record.record",
    "create-dataset": "create_dataset.create_dataset",
    "disturb": "disturb.disturb",
    "score-2d": "score_2d.score_2d",
}

#: Base of every error about the words of a command; typer exports only this one's child.
_UsageError: Any = typer.BadParameter.__base__

_PLAIN: dict[str, Any] = {"add_completion": False, "rich_markup_mode": None, "pretty_exceptions_enable": False}


class _LoadedOnUse(Mapping[str, Any]):
    """The commands by name; looking one up imports its file and reads its options, a few milliseconds each."""

    def __getitem__(self, name: str) -> Any:
        file, function = _COMMANDS[name].split(".")
        alone = typer.Typer(**_PLAIN)
        alone.command(name)(getattr(import_module(f"maomaps_warp.cli.{file}"), function))
        return typer.main.get_command(alone)

    def __iter__(self) -> Iterator[str]:
        return iter(_COMMANDS)

    def __len__(self) -> int:
        return len(_COMMANDS)


class _Group(TyperGroup):
    """Says in one line what is wrong with a command, as for every other bad input."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        commands: Any = _LoadedOnUse()  # not a dict, as typer declares it, but never written to
        self.commands = commands

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self.commands)

    def main(self, *args: Any, **options: Any) -> Any:
        standalone = options.pop("standalone_mode", True)
        options["standalone_mode"] = False
        if not standalone:
            return super().main(*args, **options)
        try:
            code = super().main(*args, **options)
            sys.stdout.flush()
        except OSError as error:  # of --help and --version; commands guard their own
            complain(f"{error.filename or 'standard output'}: {error.strerror or error}")
            sys.exit(EXIT_BAD_INPUT)
        except _UsageError as error:
            complain(f"{error.format_message().replace('Value error, ', '')} (see --help)")
            sys.exit(EXIT_BAD_INPUT)
        except typer.Abort:
            code = EXIT_INTERRUPTED
        if code == EXIT_INTERRUPTED:  # what typer makes of Ctrl-C, without a word
            raise KeyboardInterrupt
        sys.exit(code if isinstance(code, int) else 0)


app = typer.Typer(
    name="maomaps-warp",
    help="Measure how good the maps of visual SLAM are.",
    cls=_Group,
    context_settings={"help_option_names": ["-h", "--help"]},
    **_PLAIN,
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
