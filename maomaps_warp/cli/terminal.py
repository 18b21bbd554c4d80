"""What every command shares: errors to exit codes, progress bars, a quiet Warp."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from maomaps_warp.errors import InputError, MaomapsError, NoScoreError
from maomaps_warp.stopwatch import Stopwatch

if TYPE_CHECKING:
    from rich.console import Console

EXIT_BAD_INPUT = 2
EXIT_NO_SCORE = 3

#: Width of tables where there is no terminal to ask, columns.
_PIPE_WIDTH = 120
#: How long the speed of a stage is looked back at, seconds: the samples of a dataset take minutes each.
_SPEED_PERIOD_S = 3600.0


@contextmanager
def user_errors(debug: bool) -> Iterator[None]:
    """Turn the errors a user can cause into one line on stderr and an exit code; `debug` shows the traceback."""
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        # Files are guarded where they are read and written: what is left is standard output.
        if debug:
            traceback.print_exc()
        complain(f"{error.filename or 'standard output'}: {error.strerror or error}")
        raise typer.Exit(EXIT_BAD_INPUT) from None
    except MaomapsError as error:
        if debug:
            traceback.print_exc()
        complain(str(error))
        raise typer.Exit(EXIT_NO_SCORE if isinstance(error, NoScoreError) else EXIT_BAD_INPUT) from None


def check_device_name(name: str) -> None:
    """Refuse what names no device, before anything is read; whether the device exists is known once Warp starts."""
    if not re.fullmatch(r"auto|cpu|cuda(:\d+)?", name):
        raise InputError(f"--device {name}", "no such device", "auto, cpu, cuda or cuda:N")


def complain(message: str) -> None:
    """One line on stderr."""
    print("maomaps-warp: error: " + " ".join(message.split()), file=sys.stderr)


def console() -> Console:
    """Standard output, as wide as the terminal, or as tables need if there is none."""
    from rich.console import Console

    wide = Console(highlight=False, markup=False, emoji=False)
    if not wide.is_terminal or wide.width < 100:
        return Console(highlight=False, markup=False, emoji=False, width=_PIPE_WIDTH)
    return wide


@contextmanager
def progress_clock(out: Console | None = None) -> Iterator[Stopwatch]:
    """A stopwatch whose stages draw progress bars on stderr; silent where that is no terminal.

    What it is told to say is printed on `out`, above the bars.
    """

    def say(text: str) -> None:
        if out is not None:
            out.print(text, soft_wrap=True)
            sys.stdout.flush()

    from rich.console import Console

    stderr = Console(stderr=True)
    if not stderr.is_terminal:
        yield Stopwatch(say=say)
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description:<20}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(compact=True),
    )
    # Redirecting would send what is said to stderr.
    bars = Progress(
        *columns,
        console=stderr,
        transient=True,
        speed_estimate_period=_SPEED_PERIOD_S,
        redirect_stdout=False,
        redirect_stderr=False,
    )
    with bars:
        tasks = {}

        def show(stage: str, done: int, total: int | None) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            elif done == 0:  # the stage begins anew
                bars.reset(tasks[stage], total=total)
            bars.update(tasks[stage], completed=done, total=total)

        def say_above(text: str) -> None:
            # Where both streams are one screen, only the bars' own console can print above them.
            if out is not None and out.is_terminal:
                bars.print(text, soft_wrap=True, highlight=False, markup=False, emoji=False)
            else:
                say(text)

        yield Stopwatch(show, say_above)


def quiet_warp() -> None:
    """Start Warp without its greeting and without the line its C++ prints where there is no CUDA driver."""
    import warp as wp

    from maomaps_warp.mapping.device import start_warp

    wp.config.quiet = True
    wp.config.log_level = wp.LOG_ERROR
    sys.stderr.flush()
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        start_warp()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)
