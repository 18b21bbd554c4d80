"""A camera trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Camera poses, in order.

    Attributes:
        T_world_camera: (N, 4, 4) float64, metres: camera-frame coordinates (optical: x right, y down,
            z forward) to world coordinates. Each trajectory has its own world until it is aligned.
        stamps_ns: (N,) int64, nanoseconds, ascending (real recordings repeat one now and then); None if the
            source has none, in which case poses pair with another trajectory's, or with frames, by index.
        source: what it was read from, for messages.
        frame_id: the world's name where the source states one, else empty.
        pose_frame: what the source's poses were taken to mean (a text for `parse_convention`) and turned from.
        is_assumed: neither the source nor the user said so: such sources usually mean it.
        notes: what the reader dropped or decided, one short sentence each.
    """

    T_world_camera: NDArray[np.float64]
    stamps_ns: NDArray[np.int64] | None = None
    source: str = "trajectory"
    frame_id: str = ""
    pose_frame: str = "optical"
    is_assumed: bool = False
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        T = self.T_world_camera
        if T.ndim != 3 or T.shape[1:] != (4, 4) or T.dtype != np.float64:
            raise ValueError(f"T_world_camera must be (N, 4, 4) float64, got {T.shape} {T.dtype}")
        if not np.isfinite(T).all():
            raise ValueError("T_world_camera holds values that are not finite")
        stamps = self.stamps_ns
        if stamps is not None:
            if stamps.shape != (len(T),) or stamps.dtype != np.int64:
                raise ValueError(f"stamps_ns must be ({len(T)},) int64, got {stamps.shape} {stamps.dtype}")
            if np.any(np.diff(stamps) < 0):
                raise ValueError("stamps_ns must ascend")

    def __len__(self) -> int:
        return len(self.T_world_camera)

    @property
    def positions(self) -> NDArray[np.float64]:
        """Camera centres in the world, (N, 3) float64, metres."""
        return self.T_world_camera[:, :3, 3]

    @property
    def path_length(self) -> float:
        """Sum of the steps between consecutive positions, metres."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    @property
    def duration_s(self) -> float | None:
        """Seconds from the first stamp to the last; None without stamps."""
        if self.stamps_ns is None or not len(self):
            return None
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9

    def select(self, index: NDArray[np.int64]) -> Trajectory:
        """The poses at `index`, (M,) int64, ascending."""
        stamps = None if self.stamps_ns is None else self.stamps_ns[index]
        return replace(self, T_world_camera=self.T_world_camera[index], stamps_ns=stamps)
