"""PLY files, read for their vertices: our own reader.

Written here because trimesh, which reads the scenes, is made for whole meshes: it takes an ASCII file that
is cut off without a word, refuses binary meshes that mix triangles and larger faces, and takes the format
for binary if a comment stands before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.tables import data_rows, parse_rows, read_bytes

_TYPES = {
    **{
        "char": "i1",
        "uchar": "u1",
        "short": "i2",
        "ushort": "u2",
        "int": "i4",
        "uint": "u4",
        "float": "f4",
        "double": "f8",
    },
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float32": "f4", "float64": "f8"},
}
_ENCODINGS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CUT_OFF = "the file is cut off or its header is wrong: write it again"


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str  # NumPy type code without byte order
    length_kind: str = ""  # type code of the list's length; empty for a single value


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]

    @property
    def has_lists(self) -> bool:
        return any(prop.length_kind for prop in self.properties)


@dataclass(frozen=True)
class _Header:
    encoding: str
    elements: tuple[_Element, ...]
    body: int  # offset of the first byte behind the header
    lines: int  # how many lines the header has


def read_ply(path: Path) -> tuple[NDArray[np.float64], NDArray[np.generic] | None, tuple[str, ...]]:
    """Reads the vertices of a PLY, ascii or binary, with or without faces.

    Returns:
        points: (N, 3) float64, metres, as they stand (NaN included), in the file's order, none merged.
        colors: (N, 3) of the file's own type, or None.
        notes: what was not used.

    Raises:
        InputError: the header is wrong, there are no vertices with x, y, z, or data is missing.
    """
    data = read_bytes(path)
    header = _read_header(path, data)
    vertex = next((element for element in header.elements if element.name == "vertex"), None)
    if vertex is None:
        raise InputError(path, "PLY without an element vertex", "the file holds no points")
    names = [prop.name for prop in vertex.properties]
    if missing := [axis for axis in "xyz" if axis not in names]:
        raise InputError(path, f"PLY vertices without {' '.join(missing)}", f"their properties are {' '.join(names)}")
    if vertex.has_lists:
        raise InputError(path, "PLY vertices with a list property", "only single values a vertex are understood")
    read = _read_ascii if header.encoding == "ascii" else _read_binary
    columns = read(path, data, header)
    with np.errstate(invalid="ignore"):  # a signalling NaN may warn; all NaN are counted later
        points = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
    colors = next(
        (
            np.column_stack([columns[name] for name in rgb])
            for rgb in (
                ("red", "green", "blue"),
                ("r", "g", "b"),
                ("diffuse_red", "diffuse_green", "diffuse_blue"),
            )
            if set(rgb) <= set(names)
        ),
        None,
    )
    faces = sum(element.count for element in header.elements if element.name == "face")
    return points, colors, (f"a mesh of {faces} faces: its vertices are the points",) if faces else ()


def _read_header(path: Path, data: bytes) -> _Header:
    if not data.startswith((b"ply\n", b"ply\r\n")):
        raise InputError(path, "is no PLY file: it does not start with a line `ply`")
    encoding = ""
    elements: list[_Element] = []
    offset = lines = 0
    while True:
        end = data.find(b"\n", offset)
        if end < 0:
            raise InputError(path, "PLY header without end_header", _CUT_OFF)
        words = data[offset:end].decode("latin-1").split()
        offset, lines = end + 1, lines + 1
        match words:
            case ["end_header"]:
                break
            case ["format", name, *_]:
                encoding = name
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count), ()))
            case ["property", *rest] if elements and (prop := _property(rest)):
                last = elements[-1]
                elements[-1] = _Element(last.name, last.count, (*last.properties, prop))
            case [] | ["ply"] | ["comment", *_] | ["obj_info", *_]:
                pass
            case _:
                raise InputError(f"{path}, line {lines}", f"{' '.join(words)[:60]!r} is no PLY header line")
    if encoding not in _ENCODINGS:
        raise InputError(path, f"PLY of format {encoding!r}", f"{', '.join(_ENCODINGS)} are understood")
    return _Header(encoding, tuple(elements), offset, lines)


def _property(words: list[str]) -> _Property | None:
    match words:
        case [kind, name] if kind in _TYPES:
            return _Property(name, _TYPES[kind])
        case ["list", length_kind, kind, name] if kind in _TYPES and length_kind in _TYPES:
            return _Property(name, _TYPES[kind], _TYPES[length_kind])
    return None


def _read_ascii(path: Path, data: bytes, header: _Header) -> dict[str, NDArray[np.generic]]:
    rows, lines = data_rows(data[header.body :].decode("latin-1"), header.lines + 1)
    expected = sum(element.count for element in header.elements)
    if len(rows) < expected:
        raise InputError(path, f"{len(rows)} lines of data, but the elements need {expected}", _CUT_OFF)
    start = 0
    for element in header.elements:
        if element.name == "vertex":
            break
        start += element.count
    names = [prop.name for prop in element.properties]
    if not element.count:
        return {name: np.empty(0) for name in names}
    stop = start + element.count
    values = parse_rows(path, rows[start:stop], lines[start:stop])
    if values.shape[1] != len(names):
        raise InputError(
            f"{path}, line {lines[start]}",
            f"{values.shape[1]} values, but a vertex has {len(names)} properties",
        )
    columns: dict[str, NDArray[np.generic]] = {}
    for column, prop in enumerate(element.properties):
        # Text keeps its digits; whole numbers (colours) become integers again.
        numbers = values[:, column]
        whole = prop.kind[0] in "iu" and bool((np.abs(numbers) < 2**53).all() and (numbers == np.rint(numbers)).all())
        columns[prop.name] = numbers.astype(np.int64) if whole else numbers
    return columns


def _read_binary(path: Path, data: bytes, header: _Header) -> dict[str, NDArray[np.generic]]:
    order = _ENCODINGS[header.encoding]
    offset = header.body
    columns: dict[str, NDArray[np.generic]] = {}
    for element in header.elements:
        end = _end_of(element, data, offset, order)
        if end > len(data):
            found = f"data ends within the {element.count} elements {element.name}"
            raise InputError(path, found, _CUT_OFF)
        if element.name == "vertex":
            record = np.dtype([(f"f{i}", order + prop.kind) for i, prop in enumerate(element.properties)])
            records = np.frombuffer(data, record, element.count, offset)
            columns = {prop.name: records[f"f{i}"] for i, prop in enumerate(element.properties)}
        offset = end
    return columns


def _end_of(element: _Element, data: bytes, offset: int, order: str) -> int:
    """Where an element's data ends; beyond the end of `data` if it is cut off."""
    if not element.has_lists:
        return offset + element.count * sum(np.dtype(prop.kind).itemsize for prop in element.properties)
    if len(element.properties) == 1:
        end = _end_of_equal_lists(element, data, offset, order)
        if end is not None:
            return end
    for _ in range(element.count):
        for prop in element.properties:
            size = np.dtype(prop.kind).itemsize
            if prop.length_kind:
                width = np.dtype(prop.length_kind).itemsize
                length = int.from_bytes(data[offset : offset + width], "big" if order == ">" else "little")
                size = width + length * size
            offset += size
        if offset > len(data):
            break
    return offset


def _end_of_equal_lists(element: _Element, data: bytes, offset: int, order: str) -> int | None:
    """Where lists of one length (a mesh of triangles) end; None if lengths differ or data is missing."""
    prop = element.properties[0]
    width = np.dtype(prop.length_kind).itemsize
    if not element.count or offset + width > len(data):
        return None
    length = int(np.frombuffer(data, order + prop.length_kind, 1, offset)[0])
    record = np.dtype([("length", order + prop.length_kind), ("items", order + prop.kind, (max(length, 0),))])
    end = offset + element.count * record.itemsize
    if end > len(data):
        return None
    lengths = np.frombuffer(data, record, element.count, offset)["length"]
    return end if bool((lengths == length).all()) else None
