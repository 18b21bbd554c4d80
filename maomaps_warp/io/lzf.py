"""LZF, the compression of PCD files (the format of liblzf), for reading."""

from __future__ import annotations


def lzf_decompress(packed: bytes, size: int) -> bytes:
    """Decompresses LZF into `size` bytes.

    A control byte c < 32 is followed by c + 1 literal bytes. Otherwise (c >> 5) + 2 bytes, 7 in the upper
    bits adding the next byte to that length, are copied from ((c & 31) << 8) + next byte + 1 bytes back.

    Raises:
        ValueError: the data is cut off, refers to bytes before its start, or gives another size.
    """
    out = bytearray()
    at, end = 0, len(packed)
    try:
        while at < end:
            control = packed[at]
            at += 1
            if control < 32:
                out += packed[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[at]
                at += 1
            length += 2
            back = ((control & 31) << 8) + packed[at] + 1
            at += 1
            start = len(out) - back
            if start < 0:
                raise ValueError("a copy from before the start")
            piece = out[start : start + length]
            # The copy may overlap what it writes: then it repeats the last `back` bytes.
            out += piece if back >= length else (piece * (length // back + 1))[:length]
    except IndexError:
        raise ValueError("it ends in the middle of a copy") from None
    if at != end or len(out) != size:
        raise ValueError(f"it gives {len(out)} bytes instead of {size}")
    return bytes(out)
