"""A plain NumPy twin of the original ground-truth creator, and of a map with full poses; it imports none of ours.

Written from the facts about the original: images and poses join by equal stamps; yaw only; 320x240 pixels with
fx = fy = 160 and the centre (160, 120); 0.01 m < |p| < 10 m; voxel = round-half-even(p / 0.05); colour = truncated
mean; the ceiling is the fullest layer in the upper half of the occupied layers, and the map ends 1 m below it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Voxels = dict[tuple[int, int, int], tuple[int, int, int]]

#: Of a metre, in layers of 0.05 m.
CEILING_LAYERS = 20
#: Larger than any index here: makes them positive, so that three of them are one number.
SHIFT = 100_000


def yaw_of_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Heading of the x axis that a quaternion turns, radians."""
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def create(
    depths: Mapping[int, NDArray[np.float32]],
    colors: Mapping[int, NDArray[np.uint8]],
    poses: Mapping[int, tuple[float, float, float, float]],
) -> Voxels:
    """Voxels with their colours, the ceiling still on: depth, colours and (x, y, z, yaw) by stamp."""
    sums: dict[tuple[int, int, int], list[int]] = {}
    for stamp in depths.keys() & colors.keys() & poses.keys():
        px, py, pz, yaw = poses[stamp]
        v, u = np.indices(depths[stamp].shape)
        d = depths[stamp].astype(np.float64)
        forward, left, up = d, -(d * (u - 160.0) / 160.0), -(d * (v - 120.0) / 160.0)
        with np.errstate(invalid="ignore"):
            distance = np.sqrt(left**2 + up**2 + forward**2)
            kept = (d > 0) & (distance > 0.01) & (distance < 10.0)
        x = math.cos(yaw) * forward - math.sin(yaw) * left + px
        y = math.sin(yaw) * forward + math.cos(yaw) * left + py
        cells = np.round(np.stack([x, y, up + pz], axis=-1)[kept] / 0.05).astype(int) + SHIFT
        keys, inverse = np.unique(
            (cells[:, 0] * 2 * SHIFT + cells[:, 1]) * 2 * SHIFT + cells[:, 2], return_inverse=True
        )
        unique = (
            np.stack([keys // (4 * SHIFT**2), keys // (2 * SHIFT) % (2 * SHIFT), keys % (2 * SHIFT)], axis=1) - SHIFT
        )
        channels = [np.bincount(inverse, weights=colors[stamp][kept][:, c]) for c in range(3)]
        rows = np.stack([*channels, np.bincount(inverse)], axis=1).astype(int)
        for cell, row in zip(map(tuple, unique.tolist()), rows.tolist(), strict=True):
            total = sums.setdefault(cell, [0, 0, 0, 0])
            for i in range(4):
                total[i] += row[i]
    return {cell: (r // n, g // n, b // n) for cell, (r, g, b, n) in sums.items()}


def without_ceiling(voxels: Voxels) -> Voxels:
    """The map that ends a metre below its ceiling."""
    in_layer: dict[int, int] = {}
    for _, _, k in voxels:
        in_layer[k] = in_layer.get(k, 0) + 1
    layers = sorted(in_layer)
    ceiling = max(layers[len(layers) // 2 :], key=lambda k: (in_layer[k], -k))
    return {cell: color for cell, color in voxels.items() if not cell[2] > ceiling - CEILING_LAYERS}


def samples(depth: NDArray[np.float32], camera: tuple[float, float, float, float], T: F64) -> F64:
    """World points of the pixels with 0.01 m < |p| < 10 m under a full pose, (N, 3); camera = (fx, fy, cx, cy)."""
    fx, fy, cx, cy = camera
    v, u = np.nonzero(depth > 0)
    d = depth[v, u].astype(np.float64)
    x, y = d * (u - cx) / fx, d * (v - cy) / fy
    distance = np.sqrt(x * x + y * y + d * d)
    p = np.stack([x, y, d], axis=1)[(distance > 0.01) & (distance < 10.0)]
    return np.stack([T[i, 0] * p[:, 0] + T[i, 1] * p[:, 1] + T[i, 2] * p[:, 2] + T[i, 3] for i in range(3)], axis=1)
