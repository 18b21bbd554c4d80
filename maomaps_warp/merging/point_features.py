"""Descriptors of points by the surfaces around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Bins of each of the three histograms.
BINS = 11
#: At most so many neighbours describe a point.
MAX_NEIGHBOURS = 60


def describe(points: NDArray[np.float64], normals: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Histograms of pair features, each point's plus the mean of its neighbours', weighted by nearness.

    The scheme is that of FPFH (R. B. Rusu, N. Blodow, M. Beetz, "Fast point feature histograms for 3D registration",
    ICRA 2009). The pair features are the absolute cosines between the two normals and between each normal and the
    line that joins the points: a voxel map has no viewpoint that would tell which way its normals face.

    Args:
        points: (N, 3) float64, metres, N >= 2.
        normals: (N, 3) float64 of length 1 (or 0 where unknown).
        radius: of the neighbourhood, metres.

    Returns:
        (N, 3 * BINS) float64, the same however the map is turned and shifted.
    """
    from scipy import sparse, spatial

    count = min(MAX_NEIGHBOURS, len(points))
    distances, neighbours = spatial.cKDTree(points).query(points, k=count, distance_upper_bound=radius)
    here, column = np.nonzero((neighbours < len(points)) & (distances > 0.0))
    there, distance = neighbours[here, column], distances[here, column]
    direction = (points[there] - points[here]) / distance[:, None]
    cosines = (
        (normals[here] * direction).sum(axis=1),
        (normals[there] * direction).sum(axis=1),
        (normals[here] * normals[there]).sum(axis=1),
    )
    neighbours_of = np.maximum(np.bincount(here, minlength=len(points)), 1)
    histograms = np.empty((len(points), 3 * BINS))
    for part, cosine in enumerate(cosines):
        bins = np.minimum((np.abs(cosine) * BINS).astype(np.int64), BINS - 1)
        counts = np.bincount(here * BINS + bins, minlength=len(points) * BINS).reshape(-1, BINS)
        histograms[:, part * BINS : (part + 1) * BINS] = counts / neighbours_of[:, None]
    shape = (len(points), len(points))
    weights = sparse.csr_array((1.0 / distance, (here, there)), shape=shape)
    total = np.maximum(np.asarray(weights.sum(axis=1)).reshape(-1), np.finfo(np.float64).tiny)
    return np.asarray(histograms + (weights @ histograms) / total[:, None])


def most_distinct(descriptors: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Indices, ascending, of the `count` descriptors farthest from the median one: corners and furniture, no walls."""
    distance = np.linalg.norm(descriptors - np.median(descriptors, axis=0), axis=1)
    return np.sort(np.argsort(-distance, kind="stable")[:count])
