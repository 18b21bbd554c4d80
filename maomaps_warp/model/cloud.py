"""A point cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points of a map.

    Attributes:
        points: (N, 3) float64, metres, world frame, finite.
        colors: (N, 3) uint8 RGB, or None.
        dropped_nonfinite: how many points of the source were NaN or infinite and left out.
        source: what it was read from, for messages.
        frame_id: the world's name where the source states one, else empty.
        notes: what the reader dropped or decided, one short sentence each.
    """

    points: NDArray[np.float64]
    colors: NDArray[np.uint8] | None = None
    dropped_nonfinite: int = 0
    source: str = "cloud"
    frame_id: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 3 or self.points.dtype != np.float64:
            raise ValueError(f"points must be (N, 3) float64, got {self.points.shape} {self.points.dtype}")
        if not np.isfinite(self.points).all():
            raise ValueError("points hold values that are not finite")
        if self.colors is not None and self.colors.shape != self.points.shape:
            raise ValueError(f"colors must be {self.points.shape}, got {self.colors.shape}")

    def __len__(self) -> int:
        return len(self.points)
