"""Conditions as numbers, 1 or 0, joined by `&` and `|`: `and` is a branch, and lanes of a vector cannot branch."""

import warp as wp

from maomaps_warp.kernels.lanes import lanes_i


@wp.func(inline=True)
def flag(condition: wp.bool) -> wp.int32:
    """1 if the condition holds, else 0."""
    return wp.where(condition, 1, 0)


@wp.func(inline=True)
def any_of(mask: lanes_i) -> wp.bool:
    """Whether a lane is 1."""
    return wp.dot(mask, mask) != 0
