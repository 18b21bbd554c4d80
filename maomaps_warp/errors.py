"""The errors a user can cause. Programming mistakes are ValueError or TypeError instead."""

from __future__ import annotations


class MaomapsError(Exception):
    """Base of every error that the command line turns into one line and an exit code."""


class InputError(MaomapsError):
    """Something the user gave cannot be used.

    Attributes:
        where: the file, option or topic, with the place inside it ("run.txt, line 7").
        found: what is wrong there.
        hint: what is allowed, or the option that would help; empty if there is no way out.
    """

    def __init__(self, where: object, found: str, hint: str = "") -> None:
        self.where = str(where)
        self.found = found
        self.hint = hint
        super().__init__(f"{self.where}: {found}" + (f" ({hint})" if hint else ""))


class NoScoreError(MaomapsError):
    """The input is readable, yet there is nothing to score (no pose matched, no overlap)."""


class CapacityError(MaomapsError):
    """A table on the device is full and may not grow further; nothing was dropped silently."""
