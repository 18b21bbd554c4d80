"""Merging in space: features, poses that many matches agree on, then generalised ICP by small_gicp."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.merging.plans import CELL_VOXELS, MIN_CORRELATION, MIN_OVERLAP, correlate, plan_of
from maomaps_warp.merging.point_features import describe, most_distinct
from maomaps_warp.model.placements import Placement

#: A pose is refined if so many of the points near the other map lie on it; halves of one flat reach 0.6 to 0.9. From
#: worse poses ICP wanders about for long.
MIN_AGREEMENT = 0.5
#: A map with fewer points is not merged: it has no shape.
MIN_POINTS = 200
#: Distances in voxels: spacing of the points described, radius of a description, what two matches' lengths may
#: differ by, shortest length looked at, where a match counts for a pose.
SPACING, RADIUS, LENGTH_TOLERANCE, MIN_LENGTH, MATCH_TOLERANCE = 2.0, 12.0, 3.0, 6.0, 4.0
#: Points to describe a surface's normal.
NORMAL_NEIGHBOURS = 20
#: Points of a map that are matched: the matches' agreement takes the square of their number in memory.
MAX_KEYPOINTS = 2500
#: Matches that each start a pose, and how many of the matches that agree with it are fitted at first.
SEEDS, SEED_MATCHES = 200, 20
#: Poses that are looked at by the whole maps.
MAX_CANDIDATES = 10
#: Points this near to the other map are in the overlap, metres.
OVERLAP_REACH_M = 0.5
#: Points this near to the other map agree with it, in voxels.
AGREEMENT_TOLERANCE = 3.0
#: How far ICP looks for a point's partner, voxels.
ICP_REACH = 4.0
ICP_ITERATIONS = 20

INSTALL = "pip install 'maomaps-warp[merge]'"


def import_library() -> Any:
    """The registration library.

    Raises:
        InputError: it is not installed.
    """
    try:
        import small_gicp
    except ImportError:
        raise InputError("registration-3d", "needs the package small_gicp, which is not installed", INSTALL) from None
    return small_gicp


def place_by_registration(target: NDArray[np.float64], source: NDArray[np.float64], voxel_size: float) -> Placement:
    """Find the pose of `source` in `target`, all six degrees of freedom of it.

    The same input gives the same answer: nothing is drawn at random, and the library runs on one thread.

    Args:
        target: (N, 3) float64, metres, z up: voxel centres on multiples of the voxel size.
        source: (M, 3) likewise; its z may be off by a few degrees.
        voxel_size: metres.

    Returns:
        The placement; its confidence is the correlation of the obstacles seen from above, over the cells that both
        know. Surfaces alone do not tell a false pose, for walls and floors fit many; what is free does.

    Raises:
        InputError: small_gicp is not installed.
    """
    library = import_library()
    fewest = min(len(target), len(source))
    if fewest < MIN_POINTS:
        return Placement(None, None, f"{fewest} points in a map, fewer than {MIN_POINTS}")
    # Near zero, so that nothing is lost far from the world's origin.
    shift_target, shift_source = target.mean(axis=0), source.mean(axis=0)
    target, source = target - shift_target, source - shift_source
    coarse_target, features_target = _described(library, target, voxel_size)
    coarse_source, features_source = _described(library, source, voxel_size)
    matches = _matches(features_target, features_source)
    candidates = list(_poses(coarse_target[matches[0]], coarse_source[matches[1]], voxel_size))
    if not candidates:
        return Placement(None, None, "no pose that several matches of features agree on")
    rated = [(_agreement(coarse_target, coarse_source, T, voxel_size), T) for T in candidates]
    agreement, T = max(rated, key=lambda pose: pose[0])
    if agreement < MIN_AGREEMENT:
        reason = f"{agreement:.0%} of the points in the overlap agree, fewer than {MIN_AGREEMENT:.0%}"
        return Placement(None, None, reason)
    T = _refined(library, target, source, T, voxel_size)
    T[:3, 3] += shift_target - T[:3, :3] @ shift_source
    return _judged(target + shift_target, (source + shift_source) @ T[:3, :3].T + T[:3, 3], T, voxel_size)


def _judged(
    target: NDArray[np.float64], moved: NDArray[np.float64], T: NDArray[np.float64], voxel_size: float
) -> Placement:
    """The placement, if the plans of the two maps, now in one frame, agree."""
    plan = plan_of(target, voxel_size)
    moved_plan = plan_of(np.rint(moved / voxel_size) * voxel_size, voxel_size, plan.ground)
    correlation, overlap = correlate(plan, moved_plan, CELL_VOXELS * voxel_size)
    correlation = max(correlation, 0.0)
    if overlap < MIN_OVERLAP:
        return Placement(None, correlation, f"overlap {overlap:.0%} is below {MIN_OVERLAP:.0%}")
    if correlation < MIN_CORRELATION:
        return Placement(None, correlation, f"correlation {correlation:.2f} is below {MIN_CORRELATION}")
    return Placement(T, correlation)


def _described(
    library: Any, points: NDArray[np.float64], voxel_size: float
) -> tuple[NDArray[np.float64], tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Points in a wider spacing; of these the distinct ones, and their descriptors."""
    cloud = library.voxelgrid_sampling(points, SPACING * voxel_size, num_threads=1)
    library.estimate_normals_covariances(cloud, num_neighbors=NORMAL_NEIGHBOURS, num_threads=1)
    # The library's points have a fourth, homogeneous coordinate.
    coarse = np.ascontiguousarray(cloud.points()[:, :3])
    descriptors = describe(coarse, cloud.normals()[:, :3], RADIUS * voxel_size)
    distinct = most_distinct(descriptors, MAX_KEYPOINTS)
    return coarse, (distinct, descriptors[distinct])


def _matches(
    target: tuple[NDArray[np.int64], NDArray[np.float64]], source: tuple[NDArray[np.int64], NDArray[np.float64]]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of points of both maps whose descriptors are each other's nearest."""
    from scipy import spatial

    _, to_target = spatial.cKDTree(target[1]).query(source[1])
    _, to_source = spatial.cKDTree(source[1]).query(target[1])
    is_mutual = to_source[to_target] == np.arange(len(to_target))
    return target[0][to_target[is_mutual]], source[0][is_mutual]


def _poses(
    target: NDArray[np.float64], source: NDArray[np.float64], voxel_size: float
) -> Iterator[NDArray[np.float64]]:
    """Poses that many matches agree on, the most agreed ones first.

    Two matches agree if they keep the length between them; they belong together if many others agree with both
    (Z. Chen, K. Sun, F. Yang, W. Tao, "SC2-PCR: A second order spatial compatibility for efficient and robust point
    cloud registration", CVPR 2022).

    Args:
        target: (K, 3) float64, metres: matched points.
        source: (K, 3) their partners.
        voxel_size: metres.
    """
    from scipy import spatial

    if len(target) < 3:
        return
    length_target, length_source = (spatial.distance.cdist(points, points) for points in (target, source))
    agree = np.abs(length_target - length_source) < LENGTH_TOLERANCE * voxel_size
    agree &= np.minimum(length_target, length_source) > MIN_LENGTH * voxel_size
    # Counts, exact in float32 as far as there are keypoints; float32 takes the fast matrix product.
    ones = agree.astype(np.float32)
    support = ones * (ones @ ones)
    found: list[tuple[int, int, NDArray[np.float64]]] = []
    for seed in np.argsort(-support.sum(axis=1), kind="stable")[:SEEDS]:
        together = np.argsort(-support[seed], kind="stable")[: SEED_MATCHES - 1]
        chosen = np.append(together[support[seed, together] > 0], seed)
        T, votes = _voted(target, source, chosen, MATCH_TOLERANCE * voxel_size)
        if votes >= 4:
            found.append((-votes, len(found), T))
    yield from (T for _, _, T in sorted(found, key=lambda pose: pose[:2])[:MAX_CANDIDATES])


def _voted(
    target: NDArray[np.float64], source: NDArray[np.float64], chosen: NDArray[np.int64], tolerance: float
) -> tuple[NDArray[np.float64], int]:
    """The pose of the chosen matches, fitted anew to all matches that it brings within the tolerance; and how many."""
    T = np.eye(4)
    for _ in range(4):
        if len(chosen) < 3:
            return T, 0
        T = _fitted(target[chosen], source[chosen])
        chosen = np.flatnonzero(np.linalg.norm(source @ T[:3, :3].T + T[:3, 3] - target, axis=1) < tolerance)
    return T, len(chosen)


def _fitted(target: NDArray[np.float64], source: NDArray[np.float64]) -> NDArray[np.float64]:
    """The least-squares pose, (4, 4): W. Kabsch, Acta Crystallographica A32, 1976."""
    center_target, center_source = target.mean(axis=0), source.mean(axis=0)
    U, _, Vt = np.linalg.svd((target - center_target).T @ (source - center_source))
    T = np.eye(4)
    T[:3, :3] = (U * (1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt))) @ Vt
    T[:3, 3] = center_target - T[:3, :3] @ center_source
    return T


def _refined(
    library: Any,
    target: NDArray[np.float64],
    source: NDArray[np.float64],
    T_target_source: NDArray[np.float64],
    voxel_size: float,
) -> NDArray[np.float64]:
    fixed, tree = library.preprocess_points(target, voxel_size, NORMAL_NEIGHBOURS, 1)
    moving, _ = library.preprocess_points(source, voxel_size, NORMAL_NEIGHBOURS, 1)
    result = library.align(
        fixed,
        moving,
        tree,
        T_target_source,
        registration_type="GICP",
        max_correspondence_distance=ICP_REACH * voxel_size,
        num_threads=1,
        max_iterations=ICP_ITERATIONS,
        rotation_epsilon=1e-4,
        translation_epsilon=1e-4,
    )
    return np.array(result.T_target_source)


def _agreement(
    target: NDArray[np.float64], source: NDArray[np.float64], T: NDArray[np.float64], voxel_size: float
) -> float:
    """Of the points near the other map the share that lies on it; the lower one of the two maps'."""
    from scipy import spatial

    moved = source @ T[:3, :3].T + T[:3, 3]
    shares = []
    for one, other in ((target, moved), (moved, target)):
        distance, _ = spatial.cKDTree(other).query(one, distance_upper_bound=OVERLAP_REACH_M)
        near = distance[distance < OVERLAP_REACH_M]
        shares.append(float((near < AGREEMENT_TOLERANCE * voxel_size).mean()) if len(near) else 0.0)
    return min(shares)
