"""Bits of a word spread over digits of four bits each, as a distance field has one for each cell."""

import warp as wp


@wp.func
def spread_bits(bits: wp.uint64) -> wp.int32:
    """The lowest 8 bits, each as the lowest of four: eight clearances of 0 or 1."""
    x = wp.int32(bits & wp.uint64(255))
    x = (x | (x << 12)) & 0x000F000F
    x = (x | (x << 6)) & 0x03030303
    return (x | (x << 3)) & 0x11111111
