"""Which images a TUM RGB-D folder holds, when they were taken, and which colours belong to which depth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from maomaps_warp.errors import InputError
from maomaps_warp.io.image_streams import ImageFiles
from maomaps_warp.io.images import MAX_COLOR_GAP_NS
from maomaps_warp.io.tables import data_rows, decode_text, place, read_bytes


def find_tum_images(folder: Path) -> tuple[list[ImageFiles], list[str]]:
    """Images of a TUM RGB-D folder by stamp: of depth.txt, else of associations.txt, else all of depth/.

    Colour images join the depth image of the nearest stamp, or the one that associations.txt names.

    Returns:
        The frames' files, and notes on what is not used.

    Raises:
        InputError: a listed file is missing, or a stamp is none.
    """
    associations = folder / "associations.txt"
    if associations.is_file() and not (folder / "depth.txt").is_file():
        images = _associated(associations)
        unlisted = len(set((folder / "depth").glob("*.png")) - {image.depth for image in images})
        return images, [f"{unlisted} depth images are not in associations.txt, not used"] if unlisted else []
    colors = _stamped_files(folder, "rgb")
    color_stamps = np.array([stamp for stamp, _ in colors], np.int64)
    images = []
    for stamp, depth in _stamped_files(folder, "depth"):
        gaps = np.abs(color_stamps - stamp)
        joined = len(gaps) and gaps.min() <= MAX_COLOR_GAP_NS
        images.append(ImageFiles(depth, colors[int(gaps.argmin())][1] if joined else None, stamp))
    return images, []


def _stamped_files(folder: Path, kind: str) -> list[tuple[int, Path]]:
    """Stamps and images of the list `kind`.txt, else of the folder `kind`, by stamp."""
    listing = folder / f"{kind}.txt"
    if not listing.is_file():
        return sorted((_stamp_ns(path.stem, path), path) for path in (folder / kind).glob("*.png"))
    rows = _rows(listing, ("stamp", "file"))
    entries = [(_stamp_ns(stamp, where), folder / file) for where, (stamp, file) in rows]
    _require([path for _, path in entries], listing)
    return sorted(entries)


def _associated(listing: Path) -> list[ImageFiles]:
    """Images of associations.txt, by stamp; depth may come before colour or after it."""
    images = []
    for where, cells in _rows(listing, ("stamp", "file", "stamp", "file")):
        pairs = sorted(((cells[0], cells[1]), (cells[2], cells[3])), key=lambda pair: not _lies_in_depth(pair[1]))
        (stamp, depth), (_, color) = pairs
        if not _lies_in_depth(depth) or _lies_in_depth(color):
            raise InputError(where, f"{cells[1]} and {cells[3]}", "one of the two must lie in depth/")
        images.append(ImageFiles(listing.parent / depth, listing.parent / color, _stamp_ns(stamp, where)))
    _require([path for image in images for path in (image.depth, image.color) if path], listing)
    return sorted(images, key=lambda image: image.stamp_ns or 0)


def _lies_in_depth(file: str) -> bool:
    return "depth" in Path(file).parts[:-1]


def _rows(listing: Path, columns: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """The place and the cells of each line of a list of files."""
    rows, lines = data_rows(decode_text(listing, read_bytes(listing)))
    for row, line in zip(rows, lines, strict=True):
        cells = row.split()
        if len(cells) != len(columns):
            raise InputError(place(listing, line), f"{row[:60]!r}", f"expected: {' '.join(columns)}")
        yield place(listing, line), cells


def _require(files: Sequence[Path], listing: Path) -> None:
    missing = [path for path in files if not path.is_file()]
    if missing:
        found = f"{len(missing)} of {len(files)} listed files are missing, the first is {missing[0]}"
        raise InputError(listing, found, "complete the folder, or remove their lines")


def _stamp_ns(seconds: str, where: object) -> int:
    """Nanoseconds of decimal seconds, exactly: float64 is off by up to 120 ns at today's stamps."""
    hint = "stamps are seconds, as in 1305031229.528784"
    try:
        stamp = int((Decimal(seconds) * 10**9).to_integral_value())
    except (InvalidOperation, ValueError, OverflowError):
        raise InputError(where, f"{seconds!r} is not a stamp", hint) from None
    if abs(stamp) >= 2**63:
        raise InputError(where, f"stamp {seconds} is beyond 292 years, is it nanoseconds?", hint)
    return stamp
