"""Files that belong together and appear in a folder all at once, or not at all."""

from __future__ import annotations

import contextlib
import secrets
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

from maomaps_warp.errors import InputError
from maomaps_warp.io.outputs import check_writable


@contextlib.contextmanager
def write_file_set(folder: Path, names: Iterable[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Collects files in a hidden folder; when the block ends well they appear in `folder`, else no file changes.

    A folder that does not exist appears as a whole, with its parents. In one that exists, files change places by
    renaming; if one of the renames fails or is interrupted, the former files come back. What cannot be put back stays
    in a hidden folder beside them, which the error names.

    Args:
        folder: where the files shall lie.
        names: what the set may consist of. What stands under one of these names and is not written anew is removed,
            so that nothing of an older set lies beside the new one.
        overwrite: replace what stands there; else it is refused.

    Yields:
        The hidden folder to write into: entries of these names, and no others.

    Raises:
        InputError: an entry of one of the names exists and `overwrite` was not said, or something cannot be written.
    """
    names = tuple(names)
    check_file_set(folder, names, overwrite=overwrite)
    is_new = not folder.exists()
    staging = (folder.parent if is_new else folder) / f".{secrets.token_hex(8)}.part"
    made = [parent for parent in (staging, *staging.parents) if not parent.exists()]
    is_done = False
    try:
        staging.mkdir(parents=True)
        yield staging
        if is_new:
            staging.rename(folder)
        else:
            _exchange(staging, folder, names)
        is_done = True
    except InputError as error:
        # Errors name the hidden folder, which nobody knows.
        where = error.where.replace(str(staging), str(folder))
        raise InputError(where, error.found, error.hint) from error
    except OSError as error:
        # One about another file was raised by the caller's own work inside the block: it is not ours to tell.
        named = None if error.filename is None else Path(error.filename)
        if named is not None and not {folder, staging, *made} & {named, *named.parents}:
            raise
        raise _cannot_write(folder, error) from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        if not is_done:
            for parent in made[1:]:
                with contextlib.suppress(OSError):
                    parent.rmdir()


def check_file_set(folder: Path, names: Iterable[str], *, overwrite: bool = False) -> None:
    """Finds out, before a long computation, whether `write_file_set` could begin; leaves nothing behind.

    Raises:
        InputError: as `write_file_set`.
    """
    present = [name for name in names if _stands(folder / name)]
    if present and not overwrite:
        shown = ", ".join(present[:4]) + (f" and {len(present) - 4} more" if len(present) > 4 else "")
        raise InputError(folder, f"holds {shown} already", "--overwrite replaces them; or choose another folder")
    existing = folder
    while not existing.exists():
        existing = existing.parent
    if not existing.is_dir():
        raise InputError(folder, f"cannot be made: {existing} is a file", "choose another place")
    try:
        check_writable(existing / f"{secrets.token_hex(8)}.tmp")
    except InputError as error:
        # Its file is a probe, which nobody knows.
        raise InputError(folder, error.found, error.hint) from error


def _exchange(staging: Path, folder: Path, names: tuple[str, ...]) -> None:
    """Put the new entries in the place of the former ones, which wait in another hidden folder until all are there."""
    fresh = sorted(staging.iterdir())
    former = staging.with_suffix(".former")
    former.mkdir()
    moves = [(folder / name, former / name) for name in names if _stands(folder / name)]
    moves += [(entry, folder / entry.name) for entry in fresh]
    try:
        for source, target in moves:
            source.rename(target)
    except BaseException as error:  # Ctrl-C too
        for source, target in reversed(moves):
            if not _stands(source):
                with contextlib.suppress(OSError):  # the others can still come back
                    target.rename(source)
        with contextlib.suppress(OSError):
            former.rmdir()
        if former.exists() and isinstance(error, OSError):
            wrong = _cannot_write(folder, error)
            raise InputError(folder, wrong.found, f"not all that stood there could come back: see {former}") from error
        raise
    shutil.rmtree(former, ignore_errors=True)


def _cannot_write(folder: Path, error: OSError) -> InputError:
    reason = error.strerror or type(error).__name__
    return InputError(folder, f"cannot be written: {reason}", "free some space or choose another place")


def _stands(path: Path) -> bool:
    return path.exists() or path.is_symlink()
