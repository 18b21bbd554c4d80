"""Errors of correspondences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.correspondences import Correspondences
from maomaps_warp.threads import thread_count


def pair_errors(
    correspondences: Correspondences,
    T_world_camera_est: NDArray[np.float64],
    T_world_camera_gt: NDArray[np.float64],
    device: str = "cpu",
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The absolute and the relative error of each correspondence.

    Args:
        correspondences: M of them.
        T_world_camera_est: (P, 4, 4) float64, the matched (aligned) poses that `correspondences.pose` indexes.
        T_world_camera_gt: (P, 4, 4) float64.
        device: Warp device.

    Returns:
        |m* - m| in the world, (M,) float64, metres: drift and reconstruction; and |T_est^-1 m* - T_gt^-1 m|, each
        point in its own camera's frame, (M,) float64, metres: reconstruction without drift.
    """
    import warp as wp

    from maomaps_warp.kernels import pair_errors as kernels

    def shared(array: NDArray[np.generic], dtype: object) -> wp.array:
        # On a CPU the device works on our memory; kernels never write to their inputs.
        return wp.array(np.ascontiguousarray(array), dtype=dtype, device=device, copy=False)

    pairs = kernels.Pairs()
    pairs.pose = shared(correspondences.pose, wp.int32)
    pairs.est_index = shared(correspondences.est_index, wp.int32)
    pairs.gt_index = shared(correspondences.gt_index, wp.int32)
    pairs.est_points = shared(correspondences.est_points, wp.vec3d)
    pairs.gt_points = shared(correspondences.gt_points, wp.vec3d)
    pairs.T_world_camera_est = shared(T_world_camera_est, wp.mat44d)
    pairs.T_world_camera_gt = shared(T_world_camera_gt, wp.mat44d)
    absolute, relative = kernels.pair_errors(pairs, threads=thread_count(device))
    return absolute.numpy(), relative.numpy()
