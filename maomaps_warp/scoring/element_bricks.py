"""Elements in bricks: neighbours together, so that one look at a pose answers for all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Edge of a cell by which elements are sorted, voxels; two to the edge of a brick.
_CELL_VOXELS = 4


@dataclass(frozen=True, eq=False)
class ElementBricks:
    """Elements sorted into bricks; coordinates are metres relative to the grid's origin.

    Attributes:
        order: (N,) int64, the element at each place.
        columns: x, y, z of the elements in this order, (N,) float32 each.
        first: (B + 1,) int32: those of brick b are at places first[b] to first[b + 1] - 1.
    """

    order: NDArray[np.int64]
    columns: tuple[NDArray[np.float32], ...]
    first: NDArray[np.int32]


def sort_into_bricks(columns: tuple[NDArray[np.float32], ...], voxel_size: float) -> ElementBricks:
    """Sort elements into bricks of 8 x 8 x 8 voxels, within them into eighths.

    Args:
        columns: x, y, z of the elements, (N,) float32 each, N >= 1, metres.
        voxel_size: metres.
    """
    cell = [((c - c.min()) * np.float32(1.0 / (_CELL_VOXELS * voxel_size))).astype(np.int32) for c in columns]
    brick, eighth = np.zeros(len(cell[0]), dtype=np.int64), np.zeros(len(cell[0]), dtype=np.int64)
    bricks = 1
    for axis in cell:
        count = (int(axis.max()) >> 1) + 1
        brick = brick * count + (axis >> 1)
        eighth = 2 * eighth + (axis & 1)
        bricks *= count
    key = 8 * brick + eighth
    order = _stable_order(key, 8 * bricks)
    brick = brick[order]
    first = np.flatnonzero(np.concatenate([[True], brick[1:] != brick[:-1], [True]])).astype(np.int32)
    x, y, z = (c[order] for c in columns)
    return ElementBricks(order, (x, y, z), first)


def _stable_order(keys: NDArray[np.int64], bound: int) -> NDArray[np.int64]:
    """What sorts `keys`, all in [0, bound), 16 bits at a time: NumPy sorts such keys in linear time."""
    order = np.argsort((keys & 0xFFFF).astype(np.uint16), kind="stable")
    for shift in range(16, max(bound - 1, 1).bit_length(), 16):
        digit = ((keys[order] >> shift) & 0xFFFF).astype(np.uint16)
        order = order[np.argsort(digit, kind="stable")]
    return order
