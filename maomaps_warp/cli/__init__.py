"""The command line: the only place that prints, draws progress and picks exit codes."""

from __future__ import annotations

import sys

__all__ = ["main"]

#: As a shell reports a command that SIGINT ended.
EXIT_INTERRUPTED = 130


def main() -> None:
    """Entry point of `maomaps-warp`; Ctrl-C ends it with one line, even while it is still loading."""
    try:
        from maomaps_warp.cli.app import app

        app()
    except KeyboardInterrupt:
        print("maomaps-warp: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)
