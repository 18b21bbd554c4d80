"""The best rigid transform of a merged map onto the ground truth, by a registration library."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.model.merge_results import BestFit
from maomaps_warp.scoring.merge_transforms import moved, rotation_angle
from maomaps_warp.scoring.nearest import nearest_distances

#: From coarse to fine: how far apart points may be to count as the same surface, and to how large cells both maps are
#: thinned; voxels.
_STAGES = ((40.0, 4.0), (10.0, 2.0), (3.0, 1.0))
_ITERATIONS = 50
#: Fewer points give no normals to register by.
_MIN_POINTS = 20


def best_rigid(moving: NDArray[np.float64], fixed: NDArray[np.float64], voxel_size: float) -> NDArray[np.float64]:
    """T_fixed_moving, (4, 4) float64, metres: generalised ICP from where the clouds lie, coarse to fine.

    A. Segal et al., "Generalized-ICP", RSS 2009, by small_gicp. It finds the optimum near the start, not a global one.
    On one thread: on several the library adds up in another order each time, and the last digits change.

    Args:
        moving, fixed: (N, 3) and (M, 3) float64, metres.
        voxel_size: in the last of three stages both are thinned to one point a voxel of this edge, metres.

    Raises:
        InputError: the library is not installed, or a cloud has too few points.
    """
    try:
        import small_gicp
    except ImportError:
        hint = "install it with: pip install 'maomaps-warp[merge]'; or use --align first"
        raise InputError("--align best", "the package small_gicp is not installed", hint) from None
    if min(len(moving), len(fixed)) < _MIN_POINTS:
        found = f"maps of {len(moving)} and {len(fixed)} points determine no transform"
        raise InputError("--align best", found, "use --align first")
    # Around their middle: far from zero the sums of squares lose digits.
    middle = np.median(fixed, axis=0)
    T = np.eye(4)
    for reach, cell in _STAGES:
        T = small_gicp.align(
            fixed - middle,
            moving - middle,
            init_T_target_source=T,
            registration_type="GICP",
            downsampling_resolution=cell * voxel_size,
            max_correspondence_distance=reach * voxel_size,
            num_threads=1,
            max_iterations=_ITERATIONS,
            rotation_epsilon=1e-6,
            translation_epsilon=1e-6,
        ).T_target_source
    T_fixed_moving = np.array(T)
    T_fixed_moving[:3, 3] += middle - T_fixed_moving[:3, :3] @ middle
    return T_fixed_moving


def fit_merged(
    points: NDArray[np.float64], gt: NDArray[np.float64], voxel_size: float, device: str = "cpu"
) -> tuple[NDArray[np.float64], BestFit]:
    """The best rigid transform of a merged map from where it lies, and how much of its AME that takes away.

    A transform that does not lower the mean AME is not taken: the identity is returned then.

    Args:
        points: (N, 3) float64, metres: the merged map in the ground truth's world.
        gt: (M, 3) float64, metres.
        voxel_size: metres.
        device: Warp device of the search for neighbours.

    Returns:
        (4, 4) float64, metres, and what it hides.

    Raises:
        InputError: as `best_rigid`.
    """
    T = best_rigid(points, gt, voxel_size)
    before = float(nearest_distances(points, gt, device).mean())
    after = float(nearest_distances(moved(T, points), gt, device).mean())
    if after >= before:
        return np.eye(4), BestFit(before, before, 0.0, 0.0)
    middle = points.mean(axis=0)
    shift = float(np.linalg.norm(moved(T, middle[None])[0] - middle))
    return T, BestFit(before, after, shift, rotation_angle(T))
