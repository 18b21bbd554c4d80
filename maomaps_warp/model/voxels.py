"""Voxel grids and the maps on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.statistics import median

#: Bits of one axis in a packed key; voxel indices lie in [-KEY_BIAS, KEY_BIAS).
KEY_BITS = 21
KEY_BIAS = 1 << (KEY_BITS - 1)


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """A lattice of cubic cells in the world.

    A cell's centre is `origin + (ijk + center_offset) * voxel_size`.

    Attributes:
        voxel_size: edge length, metres.
        origin_ijk: (3,) int64: the lattice index that ijk (0, 0, 0) stands for. Coordinates on the device are
            relative to it, so that float32 suffices far from the world's zero.
        center_offset: 0.0 if cells are centred on multiples of the voxel size (index by rounding), 0.5 if they
            start there (index by floor, as OctoMap does).
    """

    voxel_size: float
    origin_ijk: NDArray[np.int64]
    center_offset: float = 0.0

    def __post_init__(self) -> None:
        if not self.voxel_size > 0:
            raise ValueError(f"voxel_size must be above 0, got {self.voxel_size}")
        if self.center_offset == 0.0 and np.any(self.origin_ijk % 2):
            # Halves round to even: relative to an odd origin they would round to the other cell than in the world.
            raise ValueError(f"origin_ijk must be even where cells are rounded, got {self.origin_ijk.tolist()}")

    @classmethod
    def around(cls, points: NDArray[np.float64], voxel_size: float, center_offset: float = 0.0) -> VoxelGrid:
        """A grid whose origin lies in the middle of `points`, (N, 3) float64 metres, N >= 1."""
        middle = np.array([median(points[:, axis]) for axis in range(3)])
        return cls(voxel_size, 2 * np.rint(middle / (2.0 * voxel_size)).astype(np.int64), center_offset)

    @property
    def origin(self) -> NDArray[np.float64]:
        """The world point that the device calls zero, (3,) float64, metres."""
        return np.asarray(self.origin_ijk * self.voxel_size, dtype=np.float64)

    def ijk_of(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Cells of `points`, (N, 3) float64 metres, world: (N, 3) int64.

        Halves round to even, as in the original map creator; floor cells as in OctoMap.
        """
        # Times the inverse, as OctoMap does: 0.15 / 0.05 = 2.9999999999999996 would lie below a face.
        cells = points * (1.0 / self.voxel_size)
        (np.rint if self.center_offset == 0.0 else np.floor)(cells, out=cells)
        ijk = cells.astype(np.int64)
        # In place and column by column, here and below: fresh memory costs more to touch than to fill, and NumPy is
        # many times slower along rows of three.
        for axis in range(3):
            ijk[:, axis] -= self.origin_ijk[axis]
        return ijk

    def centers_of(self, ijk: NDArray[np.integer]) -> NDArray[np.float64]:
        """Centres of cells `ijk`, (N, 3) integer: (N, 3) float64, metres, world."""
        centers = np.empty(ijk.shape)
        for axis in range(3):
            in_world = ijk[:, axis] + (self.origin_ijk[axis] + self.center_offset)
            np.multiply(in_world, self.voxel_size, out=centers[:, axis])
        return centers


def pack_keys(ijk: NDArray[np.integer]) -> NDArray[np.int64]:
    """Packed keys of cells, (N, 3) -> (N,) int64, 21 bits an axis; their order is the order of (i, j, k)."""
    keys = np.zeros(len(ijk), dtype=np.int64)
    biased = np.empty_like(keys)
    for axis in range(3):
        np.add(ijk[:, axis], KEY_BIAS, out=biased, dtype=np.int64)
        # All bits of an index lie within the key's: of all indices at once.
        if np.bitwise_or.reduce(biased) >> KEY_BITS:
            raise ValueError(f"voxel indices must lie within {KEY_BIAS} of the grid's origin")
        keys <<= KEY_BITS
        keys |= biased
    return keys


def unpack_keys(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """Cells of packed keys, (N,) int64 -> (N, 3) int32."""
    mask = (1 << KEY_BITS) - 1
    ijk = np.empty((len(keys), 3), dtype=np.int32)
    biased = np.empty_like(keys)
    for axis in range(3):
        np.right_shift(keys, (2 - axis) * KEY_BITS, out=biased)
        biased &= mask
        biased -= KEY_BIAS
        ijk[:, axis] = biased
    return ijk


@dataclass(frozen=True, eq=False)
class VoxelMap:
    """Occupied cells of a grid, sorted by key.

    Attributes:
        grid: the lattice.
        ijk: (N, 3) int32, unique, in the order of `pack_keys`.
        counts: (N,) int64, how many samples fell into each cell.
        colors: (N, 3) uint8 mean RGB, or None.
    """

    grid: VoxelGrid
    ijk: NDArray[np.int32]
    counts: NDArray[np.int64]
    colors: NDArray[np.uint8] | None = None

    def __len__(self) -> int:
        return len(self.ijk)

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Cell centres, (N, 3) float64, metres, world."""
        return self.grid.centers_of(self.ijk)
