"""Nearest neighbours: voxels on one lattice, free clouds, and clouds that lie apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from benchmarks import ours
from benchmarks.peers_trees import pykdtree_distances, scipy_distances
from benchmarks.rows import Row, Skipped, WrongResult
from benchmarks.setting import Setting
from benchmarks.timing import interleaved

F64 = NDArray[np.float64]
Measure = Callable[[Setting], Iterator[Row | Skipped]]
#: Distances of float64 trees differ by rounding alone; metres.
SAME_DISTANCE = 1e-9
#: Moves the estimate until its points are half a metre from the ground truth's on average; metres.
APART = np.array([0.8, 0.6, 0.5])


def on_lattice(setting: Setting) -> Iterator[Row | Skipped]:
    """Voxel centres of both maps."""
    est, gt = setting.flat.est_map, setting.flat.gt_map
    return _measured(setting, "nearest-lattice", est.points, gt.points, gt.grid.voxel_size)


def of_free_clouds(setting: Setting) -> Iterator[Row | Skipped]:
    """The same points, each moved at random within its voxel."""
    return _measured(setting, "nearest-free", *_free_clouds(setting))


def apart(setting: Setting) -> Iterator[Row | Skipped]:
    """Free clouds, the estimate beside the ground truth."""
    est, gt = _free_clouds(setting)
    return _measured(setting, "nearest-apart", est + APART, gt)


def _free_clouds(setting: Setting) -> tuple[F64, F64]:
    rng = np.random.default_rng(13)
    maps = (setting.flat.est_map, setting.flat.gt_map)
    est, gt = (m.points + m.grid.voxel_size * rng.uniform(-0.5, 0.5, (len(m), 3)) for m in maps)
    return est, gt


def _measured(
    setting: Setting, work: str, queries: F64, points: F64, voxel_size: float | None = None
) -> Iterator[Row | Skipped]:
    contestants: dict[str, Callable[[], F64]] = {
        "ours": lambda: ours.distances(queries, points, setting.device, voxel_size)
    }
    if find_spec("pykdtree") is None:
        yield Skipped(work, "pykdtree is not installed")
    else:
        contestants["pykdtree"] = lambda: pykdtree_distances(queries, points)
    contestants["SciPy"] = lambda: scipy_distances(queries, points, setting.threads)
    timed = interleaved(contestants, setting.repeats)
    distance = timed["ours"].result
    sizes = f"{len(queries)} queries, {len(points)} points, {distance.mean():.3f} m apart on average"
    for peer in list(contestants)[1:]:
        off = float(np.abs(distance - timed[peer].result).max())
        if not off <= SAME_DISTANCE:
            raise WrongResult(f"{work}: a distance differs from {peer}'s by {off:g} m")
        row = setting.row(work, sizes, timed["ours"], peer, timed[peer])
        yield replace(row, agreement=f"distances differ by at most {off:.1g} m")
