"""Tables of decimal numbers in text, parsed a block of lines at a time.

The idea: the lines are found beforehand, so threads parse disjoint blocks of them, byte by byte. A number of at most 15
digits is an integer below 2^53, and a power of ten up to 10^22 is exact in float64 too, so that one division or product
rounds once and gives what `float` gives, bit for bit (W. D. Clinger, "How to read floating point numbers accurately",
PLDI 1990, section 5). The cost: a few instructions a byte. The limit: a block that holds anything else (longer numbers,
nan, words, comments, rows of another length) is marked, and is not for this parser.
"""

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import TEXT
from maomaps_warp.kernels.ranges import launch_ranges

#: Lines of a task.
BLOCK_LINES = wp.constant(512)
#: So many digits always fit into float64.
MAX_DIGITS = wp.constant(15)
#: 10 to this power is exact in float64.
MAX_POWER = wp.constant(22)

_ZERO, _NINE, _POINT, _MINUS, _PLUS = (wp.constant(wp.uint8(ord(c))) for c in "09.-+")
_BLANK, _TAB, _RETURN, _COMMA, _SEMICOLON = (wp.constant(wp.uint8(ord(c))) for c in " \t\r,;")
_MANY = wp.constant(0x7FFFFFFF)
_SMALL_E, _LARGE_E = (wp.constant(wp.uint8(ord(c))) for c in "eE")


@wp.func(inline=True)
def byte_at(text: wp.uint64, place: wp.int32) -> wp.uint8:
    # Of the bare address: a Warp array asks at each byte for the sign of the index and for its stride.
    characters = wp.array(ptr=text, shape=(_MANY,), dtype=wp.uint8)
    return characters[place & _MANY]


@wp.func
def skip_blanks(text: wp.uint64, place: wp.int32, stop: wp.int32) -> wp.int32:
    """The first place from `place` on that holds no blank, tab or carriage return; at most `stop`."""
    i = int(place)
    while i < stop and (byte_at(text, i) == _BLANK or byte_at(text, i) == _TAB or byte_at(text, i) == _RETURN):
        i += 1
    return i


@wp.func
def digits_at(text: wp.uint64, place: wp.int32, stop: wp.int32, before: wp.int64):
    """Digits from `place` on, appended to the number `before`: (the place behind them, the number)."""
    i = int(place)
    value = wp.int64(before)
    while i < stop and byte_at(text, i) >= _ZERO and byte_at(text, i) <= _NINE:
        if i - place <= MAX_DIGITS:  # more are refused by their count: the number must only not overflow
            value = value * wp.int64(10) + wp.int64(byte_at(text, i) - _ZERO)
        i += 1
    return i, value


@wp.func
def number_at(text: wp.uint64, place: wp.int32, stop: wp.int32, powers: wp.array(dtype=wp.float64)):
    """The decimal number at `place`: (the place behind it, its value); (-1, any) if it is none for this parser."""
    i = int(place)
    is_negative = False
    if i < stop and (byte_at(text, i) == _MINUS or byte_at(text, i) == _PLUS):
        is_negative = byte_at(text, i) == _MINUS
        i += 1
    first = i
    i, value = digits_at(text, i, stop, wp.int64(0))
    digits = i - first
    power = int(0)
    if i < stop and byte_at(text, i) == _POINT and digits <= MAX_DIGITS:
        point = i
        i, value = digits_at(text, i + 1, stop, value)
        power = point + 1 - i
        digits -= power
    is_plain = digits > 0 and digits <= MAX_DIGITS
    if is_plain and i < stop and (byte_at(text, i) == _SMALL_E or byte_at(text, i) == _LARGE_E):
        i += 1
        is_down = False
        if i < stop and (byte_at(text, i) == _MINUS or byte_at(text, i) == _PLUS):
            is_down = byte_at(text, i) == _MINUS
            i += 1
        behind, exponent = digits_at(text, i, stop, wp.int64(0))
        is_plain = behind > i and behind - i <= 3
        i = behind
        power += wp.where(is_down, -wp.int32(exponent), wp.int32(exponent))
    result = wp.float64(value)
    if not is_plain or power > MAX_POWER or power < -MAX_POWER:
        i = int(-1)
    elif power < 0:
        result = result / powers[-power]
    else:
        result = result * powers[power]
    if is_negative:
        result = result * wp.float64(-1.0)  # Warp's minus would turn 0 into 0, and not into -0
    return i, result


@wp.kernel(module=TEXT)
def _parse_table_kernel(
    start: wp.int32,
    # In:
    text: wp.uint64,
    ends: wp.array(dtype=wp.int32),
    is_delimited: wp.bool,
    powers: wp.array(dtype=wp.float64),
    # Out:
    out_values: wp.array2d(dtype=wp.float64),
    out_is_refused: wp.array(dtype=wp.bool),
):
    block = start + wp.tid()
    columns = out_values.shape[1]
    is_refused = bool(False)
    row = block * BLOCK_LINES
    last_row = wp.min(row + BLOCK_LINES, ends.shape[0])
    while row < last_row and not is_refused:
        i = int(0)
        if row > 0:
            i = ends[row - 1] + 1
        stop = ends[row]
        i = skip_blanks(text, i, stop)
        column = int(0)
        while column < columns and not is_refused:
            i, value = number_at(text, i, stop, powers)
            is_refused = i < 0
            if not is_refused:
                out_values[row, column] = value
                column += 1
                if column < columns:
                    behind = i
                    if is_delimited and i < stop and (byte_at(text, i) == _COMMA or byte_at(text, i) == _SEMICOLON):
                        i = skip_blanks(text, i + 1, stop)
                    elif not is_delimited:
                        i = skip_blanks(text, i, stop)
                    is_refused = i == behind
        if not is_refused:
            is_refused = skip_blanks(text, i, stop) < stop
        row += 1
    out_is_refused[block] = is_refused


def parse_table(
    text: wp.array,
    ends: wp.array,
    columns: int,
    *,
    is_delimited: bool = False,
    out_values: wp.array | None = None,
    out_is_refused: wp.array | None = None,
    threads: int = 1,
) -> tuple[wp.array, wp.array]:
    """Numbers of lines of text.

    Args:
        text: (B,) uint8.
        ends: (N,) int32, where each line ends: the place of its line feed, or B. The first starts at 0.
        columns: how many numbers a line holds.
        is_delimited: a comma or a semicolon stands right behind each number but the last; else blanks between them.
        out_values: (N, columns) float64. None: allocated.
        out_is_refused: (blocks of BLOCK_LINES lines,) bool. None: allocated.
        threads: on a CPU.

    Returns:
        out_values; and out_is_refused, whether a block holds what is no such line: then its values are not all set.
    """
    device, blocks = text.device, -(-len(ends) // int(BLOCK_LINES))
    check_array("text", text, wp.uint8, (None,), device)
    check_array("ends", ends, wp.int32, (None,), device)
    if columns < 1:
        raise ValueError(f"columns: expected at least 1, got {columns}")
    if out_values is None:
        out_values = wp.empty((len(ends), columns), dtype=wp.float64, device=device)
    if out_is_refused is None:
        out_is_refused = wp.empty(blocks, dtype=wp.bool, device=device)
    check_array("out_values", out_values, wp.float64, (len(ends), columns), device)
    check_array("out_is_refused", out_is_refused, wp.bool, (blocks,), device)
    powers = wp.array([10.0**power for power in range(int(MAX_POWER) + 1)], dtype=wp.float64, device=device)
    launch_ranges(
        _parse_table_kernel,
        blocks,
        inputs=[wp.uint64(text.ptr or 0), ends, is_delimited, powers],
        outputs=[out_values, out_is_refused],
        device=device,
        threads=threads,
        grain=8,
    )
    return out_values, out_is_refused
