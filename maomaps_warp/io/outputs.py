"""Output files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Literal

from maomaps_warp.errors import InputError


@contextlib.contextmanager
def write_whole(path: Path, mode: Literal["w", "wb"] = "w") -> Iterator[IO[Any]]:
    """Opens a file that appears at `path` complete, or not at all.

    The bytes go into a hidden file in the same folder, which takes `path`'s place when the block ends well.
    When it does not, the hidden file is removed and a file that stood at `path` before is untouched. Devices
    and pipes (/dev/stdout, /dev/null) cannot be replaced and are written directly. Text is UTF-8 with \\n
    line ends.

    Args:
        path: the file to write; a link is followed, so that its target is replaced and not the link.
        mode: "w" for text, "wb" for bytes.

    Raises:
        InputError: the file cannot be written: no such folder, no permission, a folder stands there, the
            disk is full.
    """
    target, part = _target_and_part(Path(path))
    encoding, newline = (None, None) if mode == "wb" else ("utf-8", "\n")
    try:
        with part.open(mode, encoding=encoding, newline=newline) as file:
            yield file
        if part != target:
            if target.exists():
                shutil.copymode(target, part)
            part.replace(target)
    except OSError as error:
        # An OSError about another file was raised by the caller's own work inside the block: it is not ours
        # to tell.
        if error.filename not in (None, str(part), str(target)):
            raise
        raise _cannot_write(path, error) from error
    finally:
        if part != target:
            _remove(part)


def check_writable(path: Path) -> None:
    """Finds out, before a long computation, whether `path` could be written; leaves nothing behind.

    Raises:
        InputError: no such folder, no permission, or a folder stands there.
    """
    target, part = _target_and_part(Path(path))
    if part == target:
        return
    try:
        part.open("xb").close()
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        _remove(part)


def _target_and_part(path: Path) -> tuple[Path, Path]:
    """The file that `path` leads to, and the one to write first: a hidden one beside it; a device itself."""
    try:
        if path.is_dir():
            raise IsADirectoryError
        if path.exists() and not os.access(path, os.W_OK):
            # Replacing needs the folder's permission only, yet a file that is protected should stay as it is.
            raise PermissionError
        if path.exists() and not path.is_file():
            return path, path
        target = path.resolve() if path.is_symlink() else path
    except OSError as error:
        raise _cannot_write(path, error) from error
    return target, target.with_name(f".{os.urandom(8).hex()}.part")


def _remove(part: Path) -> None:
    # Where the folder is missing or closed there is no part, and the error that told so is already on its
    # way.
    with contextlib.suppress(OSError):
        part.unlink()


def _cannot_write(path: Path, error: OSError) -> InputError:
    if isinstance(error, IsADirectoryError):
        return InputError(path, "cannot be written: a folder stands there", "name a file inside it")
    if isinstance(error, PermissionError):
        return InputError(path, "cannot be written: permission denied", "choose another place, or change the rights")
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return InputError(path, f"cannot be written: no folder {path.parent}", "create the folder first")
    reason = error.strerror or type(error).__name__
    return InputError(path, f"cannot be written: {reason}", "free some space or choose another place")
