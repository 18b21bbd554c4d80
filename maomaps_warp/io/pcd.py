"""PCD point clouds: our own reader and writer.

Written here because files in the wild are older and odder than pypcd4 1.5, the maintained package, allows:
it refuses VERSION .5 and .6 and headers without COUNT, and lays out fields of several values wrongly in
compressed files.

The format: a text header (VERSION, FIELDS, SIZE, TYPE, COUNT, WIDTH, HEIGHT, VIEWPOINT, POINTS, DATA), then
the points as text, as packed little-endian records, or as one column after the other compressed by LZF.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.lzf import lzf_decompress
from maomaps_warp.io.outputs import write_whole
from maomaps_warp.io.tables import data_rows, parse_rows, read_bytes

#: Coordinates beyond this, metres, are written as float64: float32 would move them by more than 0.5 mm.
FLOAT32_REACH_M = 1e4

_KEYWORDS = {
    *("VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT"),
    *("WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"),
}
_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
_TYPES = {(kind, size): f"<{kind.lower()}{size}" for kind, sizes in _SIZES.items() for size in sizes}
_CUT_OFF = "the file is cut off or its header is wrong: write it again"


@dataclass(frozen=True)
class _Field:
    name: str
    dtype: np.dtype[np.generic]
    count: int

    @property
    def size(self) -> int:
        return self.dtype.itemsize * self.count


@dataclass(frozen=True)
class _Header:
    fields: tuple[_Field, ...]
    points: int
    data: str
    body: int  # offset of the first byte behind the header
    lines: int  # how many lines the header has


def is_pcd(head: bytes) -> bool:
    """Whether a file that starts so is a PCD: PCD keywords begin its first lines, FIELDS among them."""
    words = [line.split(None, 1)[0] for line in head.splitlines()[:40] if line.strip() and line.lstrip()[:1] != b"#"]
    return bool(words) and words[0].decode("latin-1") in _KEYWORDS and bool({b"FIELDS", b"COLUMNS"} & set(words))


def read_pcd(path: Path) -> tuple[NDArray[np.float64], NDArray[np.generic] | None, tuple[str, ...]]:
    """Reads a PCD of any version and encoding; VIEWPOINT is not applied.

    Returns:
        points: (N, 3) float64, metres, as they stand (NaN included).
        colors: (N, 3) of the file's own type, or None.
        notes: what was not used.

    Raises:
        InputError: the header is wrong, x, y or z is missing, or the data is not as long as the header says.
    """
    data = read_bytes(path)
    header = _read_header(path, data)
    names = [field.name for field in header.fields]
    if missing := [axis for axis in "xyz" if axis not in names]:
        raise InputError(path, f"PCD without field {' '.join(missing)}", f"its fields are {' '.join(names)}")
    readers = {"ascii": _read_ascii, "binary": _read_binary, "binary_compressed": _read_compressed}
    if header.data not in readers:
        raise InputError(path, f"PCD with DATA {header.data}", "ascii, binary and binary_compressed are understood")
    columns = readers[header.data](path, data, header)
    with np.errstate(invalid="ignore"):  # a signalling NaN may warn; all NaN are counted later
        points = np.column_stack([columns[names.index(axis)][:, 0] for axis in "xyz"]).astype(np.float64)
    colors, notes = _colors(header, columns)
    return points, colors, notes


def write_pcd(path: Path, points: NDArray[np.float64], colors: NDArray[np.uint8] | None = None) -> None:
    """Writes a binary PCD, VERSION .7, that PCL reads.

    Coordinates are float32, or float64 where one exceeds FLOAT32_REACH_M: nothing is lost then, but PCL's
    own point types hold float32 only. Colours are packed as 0x00RRGGBB in a field `rgb` of type F, PCL's
    convention.

    Args:
        path: the file.
        points: (N, 3) float64, metres.
        colors: (N, 3) uint8 RGB.
    """
    large = bool(len(points)) and float(np.abs(points).max()) > FLOAT32_REACH_M
    kind = "<f8" if large else "<f4"
    fields = [(axis, kind) for axis in "xyz"] + ([("rgb", "<u4")] if colors is not None else [])
    records = np.empty(len(points), np.dtype(fields))
    for column, axis in enumerate("xyz"):
        records[axis] = points[:, column]
    if colors is not None:
        red, green, blue = colors.astype(np.uint32).T
        records["rgb"] = (red << 16) | (green << 8) | blue
    size = 8 if large else 4
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        f"FIELDS {' '.join(name for name, _ in fields)}\n"
        f"SIZE {' '.join(['4' if name == 'rgb' else str(size) for name, _ in fields])}\n"
        f"TYPE {' '.join('F' for _ in fields)}\nCOUNT {' '.join('1' for _ in fields)}\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    with write_whole(path, "wb") as file:
        file.write(header.encode("ascii"))
        file.write(records.tobytes())


def _read_header(path: Path, data: bytes) -> _Header:
    entries: dict[str, list[str]] = {}
    offset = lines = 0
    while "DATA" not in entries:
        end = data.find(b"\n", offset)
        if end < 0:
            raise InputError(path, "PCD header without a DATA line", _CUT_OFF)
        words = data[offset:end].decode("latin-1").split()
        offset, lines = end + 1, lines + 1
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _KEYWORDS:
            raise InputError(f"{path}, line {lines}", f"{words[0][:40]!r} is no PCD header entry")
        entries["FIELDS" if words[0] == "COLUMNS" else words[0]] = words[1:]
    encoding = (entries["DATA"] or [""])[0].lower()
    return _Header(_read_fields(path, entries, encoding), _point_count(path, entries), encoding, offset, lines)


def _read_fields(path: Path, entries: dict[str, list[str]], encoding: str) -> tuple[_Field, ...]:
    names = entries.get("FIELDS", [])
    needed = ["FIELDS"] if encoding == "ascii" else ["FIELDS", "SIZE", "TYPE"]
    if missing := [key for key in needed if not entries.get(key)]:
        raise InputError(path, f"PCD header without {' and '.join(missing)}", _CUT_OFF)
    sizes = _whole_numbers(path, entries, "SIZE", ["4"] * len(names))
    counts = _whole_numbers(path, entries, "COUNT", ["1"] * len(names))
    types = entries.get("TYPE", ["F"] * len(names))
    if not len(names) == len(sizes) == len(counts) == len(types):
        found = f"{len(names)} FIELDS, {len(sizes)} SIZE, {len(types)} TYPE and {len(counts)} COUNT entries"
        raise InputError(path, f"PCD header with {found}", "each needs one entry a field")
    for name, kind, size in zip(names, types, sizes, strict=True):
        if (kind.upper(), size) not in _TYPES:
            raise InputError(path, f"PCD field {name} of TYPE {kind} SIZE {size}", "F has 4 or 8; I and U 1, 2, 4 or 8")
    rows = zip(names, types, sizes, counts, strict=True)
    return tuple(_Field(name, np.dtype(_TYPES[kind.upper(), size]), count) for name, kind, size, count in rows)


def _whole_numbers(path: Path, entries: dict[str, list[str]], key: str, default: list[str]) -> list[int]:
    words = entries.get(key, default)
    if not all(word.isdecimal() for word in words):
        raise InputError(path, f"PCD header entry {key} {' '.join(words)[:40]!r} is no list of whole numbers")
    return [int(word) for word in words]


def _point_count(path: Path, entries: dict[str, list[str]]) -> int:
    points = _whole_numbers(path, entries, "POINTS", [])
    width, height = (_whole_numbers(path, entries, key, []) for key in ("WIDTH", "HEIGHT"))
    if not points and not width:
        raise InputError(path, "PCD header without POINTS and WIDTH", _CUT_OFF)
    product = width[0] * (height[0] if height else 1) if width else points[0]
    if points and points[0] != product:
        raise InputError(path, f"PCD header with POINTS {points[0]}, but WIDTH x HEIGHT = {product}", _CUT_OFF)
    return product


def _read_ascii(path: Path, data: bytes, header: _Header) -> list[NDArray[np.generic]]:
    rows, lines = data_rows(data[header.body :].decode("latin-1"), header.lines + 1)
    if len(rows) != header.points:
        raise InputError(path, f"{len(rows)} rows of data, but POINTS {header.points}", _CUT_OFF)
    width = sum(field.count for field in header.fields)
    if not rows:
        return [np.empty((0, field.count), field.dtype) for field in header.fields]
    values = parse_rows(path, rows, lines)
    if values.shape[1] != width:
        raise InputError(f"{path}, line {lines[0]}", f"{values.shape[1]} values a row, but FIELDS need {width}")
    columns: list[NDArray[np.generic]] = []
    start = 0
    for field in header.fields:
        block = values[:, start : start + field.count]
        # Colours may be packed in the bits of a float32 or of an integer, so each keeps its own type. A
        # coordinate does not gain from float32: the text may say more.
        columns.append(_packed_text(block, field) if field.name in ("rgb", "rgba") else block)
        start += field.count
    return columns


def _packed_text(block: NDArray[np.float64], field: _Field) -> NDArray[np.generic]:
    if field.dtype.kind == "f":
        with np.errstate(over="ignore"):
            return block.astype(field.dtype)
    if not bool(((block >= -(2**31)) & (block < 2**32)).all()):
        return block
    return (block.astype(np.int64) & 0xFFFFFFFF).astype("<u4")  # negative where written as a signed number


def _read_binary(path: Path, data: bytes, header: _Header) -> list[NDArray[np.generic]]:
    # Fields are named by place: padding fields are all called `_`.
    record = np.dtype([(f"f{i}", field.dtype, (field.count,)) for i, field in enumerate(header.fields)])
    present = (len(data) - header.body) // max(record.itemsize, 1)
    if present < header.points:
        raise InputError(path, f"data ends after {present} of {header.points} points", _CUT_OFF)
    if present > header.points:
        raise InputError(path, f"data of {present} points, but POINTS {header.points}", _CUT_OFF)
    records = np.frombuffer(data, record, header.points, header.body)
    return [records[f"f{i}"] for i in range(len(header.fields))]


def _read_compressed(path: Path, data: bytes, header: _Header) -> list[NDArray[np.generic]]:
    if len(data) < header.body + 8:
        raise InputError(path, "compressed data is missing", _CUT_OFF)
    packed_size, size = struct.unpack_from("<II", data, header.body)
    packed = data[header.body + 8 : header.body + 8 + packed_size]
    if len(packed) < packed_size:
        raise InputError(path, f"compressed data ends after {len(packed)} of {packed_size} bytes", _CUT_OFF)
    # PCL leaves padding out of compressed data; others may not. The size tells.
    sizes = [field.size * header.points for field in header.fields]
    is_padding = [field.name == "_" for field in header.fields]
    if size != sum(sizes):
        sizes = [0 if padding else size for size, padding in zip(sizes, is_padding, strict=True)]
    if size != sum(sizes):
        raise InputError(path, f"{size} bytes of data, but the header's points need {sum(sizes)}", _CUT_OFF)
    try:
        raw = lzf_decompress(packed, size)
    except ValueError as error:
        raise InputError(path, f"compressed data is damaged: {error}", _CUT_OFF) from None
    columns: list[NDArray[np.generic]] = []
    offset = 0
    for field, length in zip(header.fields, sizes, strict=True):
        count = length // field.dtype.itemsize
        columns.append(np.frombuffer(raw, field.dtype, count, offset).reshape(-1, max(field.count, 1)))
        offset += length
    return columns


def _colors(header: _Header, columns: list[NDArray[np.generic]]) -> tuple[NDArray[np.generic] | None, tuple[str, ...]]:
    by_name = {field.name: column for field, column in zip(header.fields, columns, strict=True)}
    for name in ("rgb", "rgba"):
        if name in by_name:
            packed = np.ascontiguousarray(by_name[name])
            if packed.shape[1:] != (1,) or packed.dtype.itemsize != 4:
                return None, (f"field {name} is not one packed value of 4 bytes: no colours",)
            bits = packed[:, 0].view("<u4")
            return np.column_stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255]).astype(np.uint8), ()
    for names in (("r", "g", "b"), ("red", "green", "blue")):
        if all(name in by_name and by_name[name].shape[1] == 1 for name in names):
            return np.column_stack([by_name[name] for name in names]), ()
    return None, ()
