"""Maps of the ground: which cells are free, occupied, unknown."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Cell(IntEnum):
    """What is known of a cell."""

    UNKNOWN = 0
    FREE = 1
    OCCUPIED = 2


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A grid on the ground plane.

    Attributes:
        cells: (H, W) uint8, a Cell each; row 0 has the LOWEST y and column 0 the lowest x of the grid's own frame,
            as in nav_msgs/OccupancyGrid; image files start at the other end.
        resolution: edge of a cell, metres.
        origin: x, y (metres) and yaw (radians) in the world of the outer corner of cell [0, 0].
        source: what it was read or made from, for messages.
        frame_id: the world's name where the source states one, else empty.
        notes: what was decided on the way, one short sentence each.
    """

    cells: NDArray[np.uint8]
    resolution: float
    origin: tuple[float, float, float]
    source: str = "occupancy grid"
    frame_id: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.cells.ndim != 2 or self.cells.dtype != np.uint8:
            raise ValueError(f"cells must be (H, W) uint8, got {self.cells.shape} {self.cells.dtype}")
        if not self.resolution > 0:
            raise ValueError(f"resolution must be above 0, got {self.resolution}")

    @property
    def counts(self) -> dict[str, int]:
        """Cells in all and by kind."""
        by_kind = {kind.name.lower(): int(np.count_nonzero(self.cells == kind)) for kind in Cell}
        return {"total": int(self.cells.size), **by_kind}

    def centers(self, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """World coordinates of the centres of the cells in `mask`, (H, W) bool: (N, 2) float64, metres, row by row."""
        row, column = np.nonzero(mask)
        own = (np.stack([column, row], axis=1) + 0.5) * self.resolution
        x, y, yaw = self.origin
        c, s = math.cos(yaw), math.sin(yaw)
        return np.asarray(own @ np.array([[c, s], [-s, c]]) + np.array([x, y]))
