"""The command line: the only place that prints, draws progress and picks exit codes."""

from __future__ import annotations

from maomaps_warp.cli.app import main

__all__ = ["main"]
