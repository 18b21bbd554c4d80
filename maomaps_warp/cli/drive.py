"""A drive by hand, as `record --drive` has it: in a terminal or a browser, and never lost."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from maomaps_warp.errors import InputError

if TYPE_CHECKING:
    from maomaps_warp.jobs.drive import Drive
    from maomaps_warp.jobs.record import RecordOptions

Where = Literal["terminal", "browser"]


def drive_by_hand(
    scene: str, options: RecordOptions, where: Where, *, port: int, device: str, tell: Callable[[str], None]
) -> Drive:
    """A drive that is over, and has a run to be recorded.

    Raises:
        InputError: the scene cannot be used, there is no terminal or no viser, or the drive was left without a run.
    """
    from maomaps_warp.cli import drive_browser, drive_terminal
    from maomaps_warp.jobs.drive import Drive

    aspect = options.camera.width / options.camera.height
    if where == "terminal":
        drive = Drive(scene, options, drive_terminal.picture_size(aspect), device=device)
        drive_terminal.drive_in_terminal(drive)
    else:
        drive = Drive(scene, options, drive_browser.picture_size(aspect), device=device)
        view = drive_browser.BrowserView(drive, port)
        tell(f"drive  {view.address}: Ctrl-C leaves")
        try:
            drive_browser.drive_in_browser(drive, view)
        finally:
            view.close()
    if drive.state == "left":
        raise InputError("the drive", "was left before a run began", "R begins a run, and R again ends it")
    return drive


@contextmanager
def kept_drive(drive: Drive, tell: Callable[[str], None]) -> Iterator[Callable[[], None]]:
    """Keeps the poses of a drive in a file if the recording in the block fails, or if what it yields is called."""
    from maomaps_warp.io.trajectories import write_tum

    def keep() -> None:
        path = Path(tempfile.mkdtemp(prefix="maomaps-warp-")) / "drive.txt"
        write_tum(path, drive.trajectory)
        tell(f"kept   {path}: the whole drive, for --trajectory")

    try:
        yield keep
    except BaseException:
        keep()
        raise
