"""Merging by known start poses: what a merge has to beat."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.placements import Placement


def place_by_start_poses(T_world_source: Sequence[NDArray[np.float64]]) -> tuple[Placement, ...]:
    """Place each source by the pose that its run started at; the first source's frame is the merged map's.

    A source's world is that of its robot at start, so T_merged_source = T_world_first^-1 T_world_source.

    Args:
        T_world_source: (4, 4) float64 each, metres: where each run started, in one world.
    """
    return tuple(Placement(np.asarray(np.linalg.solve(T_world_source[0], T), np.float64)) for T in T_world_source)
