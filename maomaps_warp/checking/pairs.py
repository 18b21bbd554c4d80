"""Which frames to carry into which: pairs whose motion tells conventions apart and whose views may still overlap."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.checking.sampling import FrameSample
from maomaps_warp.model.pose_convention import inverse_poses

F64 = NDArray[np.float64]

#: Frames between the two of a pair, counted in kept frames.
GAPS = (1, 2, 3, 5, 8, 13, 21, 34, 55)
#: Pairs that are chosen at most, and of these each frame is in so many at most.
MOST_PAIRS = 60
MOST_PAIRS_OF_A_FRAME = 6
#: The motion sought: this share of the horizontal field of view, or of the median depth. Much less shows little, much
#: more leaves no overlap.
MOTION_SOUGHT = 0.25


def choose_pairs(sample: FrameSample, T_recorded: F64) -> NDArray[np.int64]:
    """Pairs of frames, (P, 2) int64, by motions that all conventions agree upon.

    The angle between two poses is the same under every convention (inverting keeps it, and so does exchanging the
    fields of both quaternions); of the distance the smaller one of the poses and of their inverses counts. Half of
    the pairs are those that turn most nearly as sought, half those that move so.

    Args:
        sample: the frames.
        T_recorded: (N, 4, 4) float64, their poses, read as camera-to-world.
    """
    n = len(sample)
    pairs = np.array([(i, i + gap) for gap in GAPS for i in range(n - gap)], dtype=np.int64).reshape(-1, 2)
    if not len(pairs):
        return pairs
    turn, shift = _motions(T_recorded, pairs)
    field_of_view = 2.0 * math.atan(0.5 * sample.camera.width / sample.camera.fx)
    depths = sample.depth[sample.depth > 0]
    median_depth = float(np.median(depths)) if len(depths) else 1.0
    turned, moved = (
        np.log(np.maximum(motion, 1e-12) / MOTION_SOUGHT) for motion in (turn / field_of_view, shift / median_depth)
    )
    # Too much of the one motion leaves no overlap, however well the other fits.
    distances = [np.abs(turned) + np.maximum(moved, 0.0), np.abs(moved) + np.maximum(turned, 0.0)]
    chosen: dict[int, None] = {}
    used = np.zeros(n, dtype=np.int64)
    for distance, end in zip(distances, (MOST_PAIRS // 2, MOST_PAIRS), strict=True):
        for k in np.argsort(distance, kind="stable").tolist():
            if len(chosen) >= end:
                break
            if k not in chosen and used[pairs[k]].max() < MOST_PAIRS_OF_A_FRAME:
                chosen[k] = None
                used[pairs[k]] += 1
    return pairs[sorted(chosen)]


def _motions(T: F64, pairs: NDArray[np.int64]) -> tuple[F64, F64]:
    """Angle in radians and distance in metres between the poses of each pair."""
    i, j = pairs.T
    cosine = 0.5 * (np.einsum("pab,pab->p", T[i, :3, :3], T[j, :3, :3]) - 1.0)
    distance = np.linalg.norm(T[i, :3, 3] - T[j, :3, 3], axis=1)
    inverse = inverse_poses(T)
    distance_inverse = np.linalg.norm(inverse[i, :3, 3] - inverse[j, :3, 3], axis=1)
    return np.arccos(np.clip(cosine, -1.0, 1.0)), np.minimum(distance, distance_inverse)
