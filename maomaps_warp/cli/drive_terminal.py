"""Driving a robot in a terminal: what it sees in half blocks, its place on the plan, and the keys."""

from __future__ import annotations

import os
import re
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

import numpy as np

from maomaps_warp.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from maomaps_warp.jobs.drive import Drive, Glance, Key

_ARROW_ENDS: dict[str, Key] = {"A": "forward", "B": "back", "D": "left", "C": "right"}
#: What each key means to the robot; terminals send arrows as escape sequences, of one of two modes.
_KEYS: dict[str, Key] = {
    "w": "forward",
    "s": "back",
    "a": "left",
    "d": "right",
    " ": "stop",
    **{f"\x1b{mode}{end}": key for mode in "[O" for end, key in _ARROW_ENDS.items()},
}
#: A key: an escape sequence, or one character. And what may be the beginning of a sequence.
_KEY = re.compile("\x1b[O\\[][0-9;]*[A-Za-z~]|.", re.DOTALL)
_UNFINISHED = re.compile("\x1b([O\\[][0-9;]*)?$")
_HELP = "W A S D or arrows drive, space stops, R begins and ends the run, Q leaves"
_ARROWS = "→↗↑↖←↙↓↘"


def picture_size(aspect: float) -> tuple[int, int]:
    """Columns and rows of pixels of the picture that the terminal has room for: two rows of pixels a line.

    Args:
        aspect: width over height.

    Raises:
        InputError: standard input or output is no terminal.
    """
    if os.name != "posix" or not (sys.stdin.isatty() and sys.stdout.isatty()):
        found = "needs a terminal (on POSIX systems) to show the view and read keys"
        raise InputError("--drive terminal", found, "--drive browser, or --waypoint")
    columns, lines = shutil.get_terminal_size()
    wide, high = max(10, columns - 2), max(8, 2 * (lines - 3))
    width = min(wide, max(10, int(high * aspect)))
    return width, min(high, 2 * max(4, round(width / aspect / 2)))


def drive_in_terminal(drive: Drive) -> None:
    """Let the user drive until the run is done or left; Ctrl-C leaves."""
    with _raw_terminal(), suppress(KeyboardInterrupt):
        due, unread = time.monotonic(), ""
        while drive.state in ("waiting", "recording"):
            keys, unread = keys_of(unread + _typed())
            for key in keys:
                if key in _KEYS:
                    drive.press(_KEYS[key])
                elif key == "r":
                    drive.toggle()
                elif key == "q":
                    drive.leave()
            glance = drive.step()
            _draw(drive, glance)
            due = max(due + drive.step_s, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
    drive.leave()


@contextmanager
def _raw_terminal() -> Iterator[None]:
    """Keys one by one and unseen, on the terminal's other screen."""
    import termios
    import tty

    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor)
        sys.stdout.write("\x1b[?1049h\x1b[?25l\x1b[2J")
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
        sys.stdout.write("\x1b[?25h\x1b[?1049l")
        sys.stdout.flush()


def _typed() -> str:
    """What was typed since the last time."""
    import select

    descriptor, text = sys.stdin.fileno(), ""
    while select.select([descriptor], [], [], 0.0)[0]:
        some = os.read(descriptor, 1024).decode("utf-8", "replace")
        if not some:
            return text + "q"  # the terminal is gone
        text += some
    return text


def keys_of(text: str) -> tuple[list[str], str]:
    """The keys of what was typed, in small letters, and the beginning of one that is not complete."""
    unfinished = _UNFINISHED.search(text)
    rest = unfinished.group() if unfinished else ""
    keys = _KEY.findall(text[: len(text) - len(rest)])
    return [key.lower() if len(key) == 1 else key for key in keys], rest


def _draw(drive: Drive, glance: Glance) -> None:
    columns, lines = shutil.get_terminal_size()
    colors = glance.seen.colors
    assert colors is not None
    picture = half_blocks(colors)
    side = columns - colors.shape[1] - 2
    plan = plan_lines(drive, side, len(picture)) if side >= 12 else [""] * len(picture)
    rows = [f"{left}\x1b[0m  {right}\x1b[K" for left, right in zip(picture, plan, strict=True)][: lines - 2]
    mark = "\x1b[31m●\x1b[0m recording" if glance.state == "recording" else "○ waiting"
    x, y = drive.robot.place
    status = f"{mark} {glance.seconds:5.1f} s   ({x:.2f}, {y:.2f}) m   {drive.robot.speed:+.2f} m/s"
    sys.stdout.write("\x1b[H" + "\r\n".join([*rows, status + "\x1b[K", _HELP[: columns - 1] + "\x1b[K"]) + "\x1b[J")
    sys.stdout.flush()


def half_blocks(colors: NDArray[np.uint8]) -> list[str]:
    """An image, (H, W, 3), as lines of text for a terminal: each character is two pixels, the upper in its ink."""
    upper, lower = colors[0::2], colors[1::2]
    return [
        "".join(
            f"\x1b[38;2;{a[0]};{a[1]};{a[2]}m\x1b[48;2;{b[0]};{b[1]};{b[2]}m▀"
            for a, b in zip(above.tolist(), below.tolist(), strict=True)
        )
        for above, below in zip(upper, lower, strict=False)
    ]


def plan_lines(drive: Drive, columns: int, lines: int) -> list[str]:
    """The free space from above, north up, with an arrow where the robot is."""
    free = drive.space.is_free
    # A character is about twice as high as it is wide.
    per = max(free.shape[0] / columns, free.shape[1] / (2.0 * lines), 1.0)
    wide, high = int(np.ceil(free.shape[0] / per)), int(np.ceil(free.shape[1] / (2.0 * per)))
    i = np.minimum((np.arange(min(wide, columns)) + 0.5) * per, free.shape[0] - 1).astype(int)
    j = np.minimum((np.arange(min(high, lines)) + 0.5) * 2.0 * per, free.shape[1] - 1).astype(int)
    marks = np.where(free[np.ix_(i, j)], "·", " ")
    cell = drive.space.cell_of(drive.robot.place)
    at = (min(int(cell[0] / per), len(i) - 1), min(int(cell[1] / (2.0 * per)), len(j) - 1))
    marks[at] = _ARROWS[round(drive.robot.yaw / (np.pi / 4)) % 8]
    text = ["".join(row) for row in marks.T[::-1]]
    return text + [""] * (lines - len(text))
