"""Point clouds and their files, put together byte by byte, independently of the package."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from maomaps_warp.errors import InputError
from maomaps_warp.io.clouds import read_cloud

POINTS = [(1.0, 2.0, 3.0), (-4.5, 0.25, 1e-3), (0.1, 7.0, -8.0)]
RGB = [(255, 0, 7), (1, 2, 3), (200, 100, 50)]
#: Metres: the points above, rounded to float32.
FLOAT32_TOLERANCE = 1e-6


def written(folder, content, name="cloud.bin"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
    return path


def error_of(path, **options):
    with pytest.raises(InputError) as caught:
        read_cloud(path, **options)
    assert str(caught.value).startswith(str(path))
    return str(caught.value)


def assert_cloud(cloud, colors=None):
    np.testing.assert_allclose(cloud.points, POINTS, rtol=0, atol=FLOAT32_TOLERANCE)
    assert (cloud.colors is None) == (colors is None)
    if colors is not None:
        assert cloud.colors.dtype == np.uint8
        assert cloud.colors.tolist() == [list(rgb) for rgb in colors]


def packed(rgb, alpha=0):
    return alpha << 24 | rgb[0] << 16 | rgb[1] << 8 | rgb[2]


def lzf_literals(data):
    """LZF without any copy: runs of up to 32 literal bytes."""
    runs = (data[i : i + 32] for i in range(0, len(data), 32))
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def lzf_greedy(data):
    """LZF with copies, near and far, short and long, overlapping what they write."""
    out, literal, at = bytearray(), bytearray(), 0
    last_seen = {}

    def flush():
        out.extend(lzf_literals(bytes(literal)))
        literal.clear()

    while at < len(data):
        start = last_seen.get(data[at : at + 3], -1)
        last_seen[data[at : at + 3]] = at
        length = 0
        if start >= 0 and at - start <= 8192:
            while length < 264 and at + length < len(data) and data[start + length] == data[at + length]:
                length += 1
        if length < 3:
            literal.append(data[at])
            at += 1
            continue
        flush()
        back = at - start - 1
        if length - 2 < 7:
            out.append((length - 2) << 5 | back >> 8)
        else:
            out.extend([7 << 5 | back >> 8, length - 2 - 7])
        out.append(back & 255)
        at += length
    flush()
    return bytes(out)


def pcd(fields, sizes, types, body, data="binary", counts=None, version="0.7", points=3, extra="", viewpoint=True):
    lines = ["# .PCD v.7 - Point Cloud Data file format", f"VERSION {version}", f"FIELDS {fields}"]
    lines += [f"SIZE {sizes}", f"TYPE {types}"]
    lines += [f"COUNT {counts}"] if counts else []
    lines += [f"WIDTH {points}", "HEIGHT 1"]
    lines += ["VIEWPOINT 10 20 30 0 1 0 0"] if viewpoint else []
    lines += [f"POINTS {points}", *([extra] if extra else []), f"DATA {data}"]
    return ("\n".join(lines) + "\n").encode() + body


def floats():
    return b"".join(struct.pack("<3f", *point) for point in POINTS)


def compressed(columns, encode):
    raw = b"".join(columns)
    data = encode(raw)
    return struct.pack("<II", len(data), len(raw)) + data


def ascii_rows(rows):
    return "".join(" ".join(str(v) for v in row) + "\n" for row in rows).encode()


def ply(encoding, vertex, body, count=3, after="", before="", comment="comment made by hand\n"):
    header = f"ply\n{comment}format {encoding} 1.0\nobj_info x\n{before}element vertex {count}\n"
    return (header + "".join(f"property {line}\n" for line in vertex) + after + "end_header\n").encode() + body
