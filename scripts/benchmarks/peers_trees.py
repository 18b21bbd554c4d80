"""Nearest neighbours by k-d trees of others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def pykdtree_distances(queries: F64, points: F64) -> F64:
    """pykdtree, tree included; OMP_NUM_THREADS says how many threads."""
    from pykdtree.kdtree import KDTree

    return np.asarray(KDTree(points).query(queries)[0])


def scipy_distances(queries: F64, points: F64, threads: int) -> F64:
    """SciPy's cKDTree, tree included, in its quickest setting for maps: no medians, no tight boxes."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    return np.asarray(tree.query(queries, workers=threads)[0])
