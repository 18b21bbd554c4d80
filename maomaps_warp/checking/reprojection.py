"""Depth of one frame seen from another: do they agree?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.checking.sampling import FrameSample
from maomaps_warp.model.pose_convention import inverse_poses

F64 = NDArray[np.float64]

#: Two depths of one place agree if they differ by no more than this share of them. Poses of real recordings put a
#: wall at 2 m off by up to 10 cm.
AGREEMENT = 0.05
#: Points nearer than this to the other camera are not seen by it, metres.
NEAREST_DEPTH_M = 0.05


@dataclass(frozen=True, eq=False)
class Reprojection:
    """Pairs of frames under C hypotheses about their relative pose, both directions together.

    Attributes:
        valid: (P,) int64, pixels with depth.
        agreeing: (C, P) int64, pixels that land on depth which agrees.
        landed: (C, P) int64, pixels that land on any depth.
        residual_m: (C, P) float64, median |difference| of those that land, metres; NaN if none does.
        residual_share: (C, P) float64, the same relative to the depth they land on.
    """

    valid: NDArray[np.int64]
    agreeing: NDArray[np.int64]
    landed: NDArray[np.int64]
    residual_m: F64
    residual_share: F64

    @property
    def agreement(self) -> F64:
        """(C, P) float64: share of the pixels with depth that land on depth which agrees."""
        return self.agreeing / np.maximum(self.valid, 1)


def reproject_pairs(
    sample: FrameSample, pairs: NDArray[np.int64], T_world_camera: F64, *, depth_factor: float = 1.0
) -> Reprojection:
    """Carry the depth of each frame of a pair into the other, under several hypotheses.

    Args:
        sample: the frames.
        pairs: (P, 2) int64, places in the sample.
        T_world_camera: (C, N, 4, 4) float64, poses of the N frames under each hypothesis.
        depth_factor: multiplies all depths.
    """
    shape = (len(T_world_camera), len(pairs))
    valid = np.zeros(len(pairs), dtype=np.int64)
    agreeing, landed = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
    residual_m, residual_share = np.full(shape, np.nan), np.full(shape, np.nan)
    for p, (i, j) in enumerate(pairs.tolist()):
        difference, share = _differences(sample, i, j, T_world_camera, 1, depth_factor)
        valid[p] = share.shape[1]
        agreeing[:, p] = np.count_nonzero(share <= AGREEMENT, axis=1)
        landed[:, p] = np.count_nonzero(np.isfinite(share), axis=1)
        residual_m[:, p], residual_share[:, p] = _median(difference), _median(share)
    return Reprojection(valid, agreeing, landed, residual_m, residual_share)


def search_costs(sample: FrameSample, pairs: NDArray[np.int64], T_world_camera: F64, *, pixel_stride: int = 1) -> F64:
    """What a search for poses makes small; arguments as above, of every `pixel_stride`-th pixel with depth.

    Returns:
        (C, P) float64: mean over the pixels of |difference| in units of AGREEMENT of the depth landed on, at most 1 a
        pixel, and 1 for those that do not land. Unlike the agreement it tells good from better.
    """
    costs = np.ones((len(T_world_camera), len(pairs)))
    for p, (i, j) in enumerate(pairs.tolist()):
        _, share = _differences(sample, i, j, T_world_camera, pixel_stride, 1.0)
        if share.shape[1]:
            costs[:, p] = np.fmin(share / AGREEMENT, 1.0).mean(axis=1)
    return costs


def _differences(sample: FrameSample, i: int, j: int, T: F64, stride: int, factor: float) -> tuple[F64, F64]:
    """(C, M) |difference| of the pixels of both frames, in metres and relative to the depth landed on; NaN if none."""
    T_j_i = inverse_poses(T[:, j]) @ T[:, i]
    there = _one_way(sample, i, j, T_j_i, stride, factor)
    back = _one_way(sample, j, i, inverse_poses(T_j_i), stride, factor)
    difference, depth = (np.concatenate(both, axis=1) for both in zip(there, back, strict=True))
    return difference, difference / depth


def _one_way(sample: FrameSample, i: int, j: int, T_j_i: F64, stride: int, factor: float) -> tuple[F64, F64]:
    """(C, M) |difference| and the depth landed on, metres, of i's pixels in j; NaN where they do not land."""
    camera = sample.camera
    K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    v, u = np.nonzero(sample.depth[i])
    v, u = v[::stride], u[::stride]
    z_i = factor * sample.depth[i][v, u].astype(np.float64)
    points = np.stack([(u - camera.cx) / camera.fx * z_i, (v - camera.cy) / camera.fy * z_i, z_i])
    projected = (K @ T_j_i[:, :3, :3]) @ points + K @ T_j_i[:, :3, 3:]
    z = projected[:, 2]
    positive = np.maximum(z, NEAREST_DEPTH_M)
    column, row = np.rint(projected[:, 0] / positive), np.rint(projected[:, 1] / positive)
    inside = (z > NEAREST_DEPTH_M) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    pixel = np.where(inside, row * camera.width + column, 0.0).astype(np.intp)
    landing = factor * sample.depth[j].astype(np.float64).ravel()
    landing[landing == 0.0] = np.nan
    depth = np.where(inside, landing[pixel], np.nan)
    return np.abs(z - depth), depth


def _median(values: F64) -> F64:
    """Median of each row's finite values, NaN where there are none."""
    sorted_values = np.sort(values, axis=1)  # NaN last
    count = np.isfinite(values).sum(axis=1)
    rows = np.arange(len(values))
    if not values.shape[1]:
        return np.full(len(values), np.nan)
    last = values.shape[1] - 1
    low, high = (sorted_values[rows, np.clip(k, 0, last)] for k in ((count - 1) // 2, count // 2))
    return np.where(count > 0, 0.5 * (low + high), np.nan)
