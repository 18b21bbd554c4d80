"""The command line: the only place that prints, draws progress and picks exit codes."""

from __future__ import annotations

import atexit
import gc
import sys

__all__ = ["main"]

#: As a shell reports a command that SIGINT ended.
EXIT_INTERRUPTED = 130

#: Objects made between two searches for cycles. Importing makes hundreds of thousands that all stay; Python's 700 lets
#: the searches take a fifth of a short command.
OBJECTS_BETWEEN_COLLECTIONS = 100_000


def main() -> None:
    """Entry point of `maomaps-warp`; Ctrl-C ends it with one line, even while it is still loading."""
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    atexit.register(gc.freeze)  # else the last search goes through all that was imported: 0.3 s with Warp
    try:
        from maomaps_warp.cli.app import app

        app()
    except KeyboardInterrupt:
        print("maomaps-warp: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)
