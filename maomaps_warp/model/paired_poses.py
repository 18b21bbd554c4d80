"""Poses of both trajectories at the same moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class PairedPoses:
    """Poses of the estimate, aligned, and the ground truth at the same stamps.

    Attributes:
        T_world_camera_est, T_world_camera_gt: (P, 4, 4) float64, metres, the ground truth's world.
        stamps_ns: (P,) int64; None if they were paired by index.
        est_poses: poses of the estimate in all.
        unmatched: how many of them have no partner.
        method: "interpolate", "nearest" or "index".
        largest_gap_s: of the gaps that `max_stamp_gap` limits, seconds; 0 by index.
    """

    T_world_camera_est: NDArray[np.float64]
    T_world_camera_gt: NDArray[np.float64]
    stamps_ns: NDArray[np.int64] | None
    est_poses: int
    unmatched: int
    method: str
    largest_gap_s: float

    def __len__(self) -> int:
        return len(self.T_world_camera_est)

    @property
    def counts(self) -> dict[str, int]:
        """What became of the estimate's poses; `nearest` pairing may pair one pose several times."""
        return {
            "poses": self.est_poses,
            "matched": self.est_poses - self.unmatched,
            "unmatched": self.unmatched,
            "pairs": len(self),
        }
