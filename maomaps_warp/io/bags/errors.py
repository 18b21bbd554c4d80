"""The one place where what the bag libraries raise becomes a message for the user."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from maomaps_warp.errors import InputError

#: What a damaged bag makes rosbags, mcap and the decompressors stumble over. The libraries parse straight on:
#: flipped or missing bytes surface as whatever Python raises where the nonsense is first used, KeyError for
#: an unknown channel, TypeError for ord(b""), RuntimeError from lz4, MemoryError for an absurd length.
_STUMBLES: tuple[type[Exception], ...] = (
    AssertionError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    OverflowError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
)


@contextmanager
def bag_errors(where: object, hint: str) -> Iterator[None]:
    """Run library code that reads a bag; its complaints become an InputError.

    Only calls into the libraries belong inside: a mistake of ours in here would be blamed on the bag.

    Args:
        where: the bag, with the topic where it is known.
        hint: how such a bag is repaired.
    """
    told = _library_errors()
    try:
        yield
    except PermissionError as error:
        raise InputError(where, "no permission to read it") from error
    except told as error:
        raise InputError(where, f"the bag cannot be read: {_sentence(error)}", hint) from error
    except _STUMBLES as error:
        raise InputError(where, f"the bag is damaged or cut short ({_sentence(error)})", hint) from error


def _library_errors() -> tuple[type[Exception], ...]:
    """Errors that the libraries raise on purpose, whose text explains itself."""
    import apsw
    import zstandard
    from mcap.exceptions import McapError
    from rosbags.rosbag1 import ReaderError as Ros1Error
    from rosbags.rosbag2 import ReaderError as Ros2Error
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return (
        Ros1Error,
        Ros2Error,
        SerdeError,
        TypesysError,
        McapError,
        apsw.Error,
        zstandard.ZstdError,
        zstd.ZstdError,
    )


def _sentence(error: Exception) -> str:
    """The error's text on one line, with its type where the text alone would not be understood."""
    text = " ".join(str(error).split())
    if isinstance(error, _STUMBLES) or not text:
        text = f"{type(error).__name__}: {text}" if text else type(error).__name__
    return text.removesuffix(".")
