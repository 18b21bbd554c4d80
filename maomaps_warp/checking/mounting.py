"""Whether the camera sits in the recorded frame as the conventions suppose: looking along an axis, not tilted."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.checking.reprojection import search_costs
from maomaps_warp.checking.sampling import FrameSample

F64 = NDArray[np.float64]

#: Each camera is turned by this about each of its own axes, both ways, radians.
TURN_RAD = 0.1
#: A turn fits better if the search's cost falls by this share in the mean, and falls at all in this share of the pairs.
#: Four real recordings, rightly read, stay at 0.9 % and less; for a camera tilted by 20 degrees in the frame that they
#: state it falls by 1.4 to 12 %. Turns about the world's axes are no
#: such sign: rightly read recordings gain up to 2 % by them.
COST_FALLS = 0.02
FALLS_IN = 2.0 / 3.0


def better_turned(sample: FrameSample, pairs: NDArray[np.int64], T_world_camera: F64) -> float:
    """By how much the best turned camera lowers the cost, a share of it; 0 if none fits better by the rule above.

    Args:
        sample: the frames.
        pairs: (P, 2) int64.
        T_world_camera: (N, 4, 4) float64, the poses under the convention in question.
    """
    turned = [T_world_camera @ _turn(axis, angle) for axis in range(3) for angle in (-TURN_RAD, TURN_RAD)]
    cost = search_costs(sample, pairs, np.stack([T_world_camera, *turned]))
    mean = cost.mean(axis=1)
    best = int(np.argmin(mean))
    falls = 1.0 - float(mean[best] / max(mean[0], 1e-12))
    return falls if falls >= COST_FALLS and (cost[best] < cost[0]).mean() >= FALLS_IN else 0.0


def _turn(axis: int, angle: float) -> F64:
    """Rotation about an axis, (4, 4)."""
    T = np.eye(4)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    T[a, a] = T[b, b] = math.cos(angle)
    T[b, a] = math.sin(angle)
    T[a, b] = -math.sin(angle)
    return T
