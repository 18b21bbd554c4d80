"""Distances between clouds that lie on one lattice: integers, so exact."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: How far from its lattice point a coordinate may be, metres: rounding of float64 a thousand kilometres from zero.
_TOLERANCE = 1e-9
#: A single point shows no lattice.
_LEAST_POINTS = 2
#: Points that a step is looked for in, and the least step that is one, metres: somewhere free points differ by less.
_SAMPLE = 512
_LEAST_STEP = 1e-3
#: Decimals of a metre of a step found in the data.
_STEP_DECIMALS = 9
#: How far around itself, in cells, a query looks for columns with points; and of how many queries one does so to see
#: whether the others should.
_REACH = 10
_SAMPLED = 61
#: So far look the few that are left in the end, no more than so many.
_FAR_REACH = 80
_FAR_QUERIES = 4096
#: Cells of the transform at most, 128 MB; and of what it takes beside that while it runs, rows padded by the window.
_MAX_VOLUME = 1 << 26
_MAX_PADDED = 1 << 27
#: Windows of the transform, cells, and how many cells of volume for each query and point each is worth, where what was
#: done before leaves more than this share of the queries undecided. Packets decide the rest.
_WINDOWS = ((15, 100), (100, 10))
_UNDECIDED = 0.02
#: A volume so small is always worth it.
_SMALL_VOLUME = 1 << 18


@dataclass(frozen=True, eq=False)
class LatticeClouds:
    """Two clouds on one lattice.

    Attributes:
        step: between neighbours, metres.
        queries, points: (Q, 3) and (N, 3) int32, cells.
        lower, upper: (3,) int64, lowest and highest cell of both.
    """

    step: float
    queries: NDArray[np.int32]
    points: NDArray[np.int32]
    lower: NDArray[np.int64]
    upper: NDArray[np.int64]


def find_lattice(
    queries: NDArray[np.float64],
    points: NDArray[np.float64],
    voxel_size: float | None = None,
    device: str = "cpu",
    threads: int = 1,
) -> LatticeClouds | None:
    """Both clouds as cells of one lattice, or None where they do not lie on one.

    Args:
        queries, points: (Q, 3) and (N, 3) float64, metres, C-contiguous.
        voxel_size: the step of the lattice, metres; None: looked for in `points`.
        device: Warp device.
        threads: how many a CPU uses.
    """
    import warp as wp

    from maomaps_warp.kernels.lattice import cells_on_lattice

    if not len(queries) or len(points) < _LEAST_POINTS:
        return None
    step = voxel_size or step_of(points)
    if step is None:
        return None
    zero = wp.vec3d(*points[0].tolist())
    clouds, lowest, highest = [], [], []
    for cloud in (points, queries):
        on_device = wp.array(cloud, dtype=wp.vec3d, device=device, copy=False)
        cells, lower, upper, off = cells_on_lattice(on_device, zero, step, _TOLERANCE, threads=threads)
        if off.numpy().any():
            return None
        clouds.append(cells.numpy())
        lowest.append(lower.numpy().min(axis=0))
        highest.append(upper.numpy().max(axis=0))
    lower_cell = np.minimum(*lowest).astype(np.int64)
    return LatticeClouds(step, clouds[1], clouds[0], lower_cell, np.maximum(*highest).astype(np.int64))


def step_of(points: NDArray[np.float64]) -> float | None:
    """Least difference between coordinates of a few points: of a lattice most likely its step."""
    steps = []
    # Neighbours in the cloud are neighbours in space more often than points picked from all over it.
    few = points[:_SAMPLE]
    for axis in range(3):
        differences = np.diff(np.sort(few[:, axis]))
        differences = differences[differences > 2.0 * _TOLERANCE]
        if len(differences):
            steps.append(differences.min())
    step = round(float(min(steps)), _STEP_DECIMALS) if steps else 0.0
    return step if step >= _LEAST_STEP else None


def exchanged(clouds: LatticeClouds) -> LatticeClouds:
    """The other way: from the points to the queries."""
    return replace(clouds, queries=clouds.points, points=clouds.queries)


def near_squares(clouds: LatticeClouds, threads: int = 1) -> NDArray[np.int32]:
    """Squared distance of each query to the nearest point, (Q,) int32, cells^2; -1 where it is not near. On a CPU."""
    import warp as wp

    from maomaps_warp.kernels.distance_transform import ROW_CELLS, squares_along_z, squares_within

    shape = _padded_shape(clouds)
    volume = math.prod(shape.tolist())
    worth = [max(_SMALL_VOLUME, each * (len(clouds.queries) + len(clouds.points))) for _, each in _WINDOWS]
    if volume > min(worth[0], _MAX_VOLUME):
        return np.full(len(clouds.queries), -1, dtype=np.int32)
    queries, points = (
        wp.array(cloud, dtype=wp.vec3i, device="cpu", copy=False) for cloud in (clouds.queries, clouds.points)
    )
    i, j, k = clouds.lower.tolist()
    x, y, z = shape.tolist()
    box: Any = {"lower": (i, j, k), "shape": (x, y, z), "threads": threads}
    along_z = squares_along_z(points, **box)
    squares = _around(clouds.queries, along_z, box)
    for (window, _), cells in zip(_WINDOWS, worth, strict=True):
        padded = volume // x * (x + 2 * -(-window // ROW_CELLS) * ROW_CELLS)
        if volume <= cells and padded <= _MAX_PADDED and _much_is_left(squares):
            squares = squares_within(queries, along_z, window=window, **box).numpy()
    left = np.flatnonzero(squares < 0)
    if 0 < len(left) <= _FAR_QUERIES:
        squares[left] = _look_around(clouds.queries[left], _FAR_REACH, along_z, box)
    return squares


def _around(queries: NDArray[np.int32], along_z: Any, box: dict[str, Any]) -> NDArray[np.int32]:
    """What the columns around each query decide; nothing where a sample of the queries finds little."""
    sample = _look_around(np.ascontiguousarray(queries[::_SAMPLED]), _REACH, along_z, box)
    if _much_is_left(sample):
        return np.full(len(queries), -1, dtype=np.int32)
    return _look_around(queries, _REACH, along_z, box)


def _look_around(queries: NDArray[np.int32], reach: int, along_z: Any, box: dict[str, Any]) -> NDArray[np.int32]:
    import warp as wp

    from maomaps_warp.kernels.distance_transform import squares_around

    cells, columns = (wp.array(each, dtype=wp.vec3i, device="cpu", copy=False) for each in (queries, _columns(reach)))
    return np.asarray(squares_around(cells, columns, along_z, **box).numpy())


def _much_is_left(squares: NDArray[np.int32]) -> bool:
    return int(np.count_nonzero(squares < 0)) > _UNDECIDED * len(squares)


def _columns(reach: int) -> NDArray[np.int32]:
    """Columns within reach: x, y and squared distance, nearest first; then one with the least distance beyond."""
    away = np.arange(-reach, reach + 1)
    y, x = (side.ravel() for side in np.meshgrid(away, away, indexing="ij"))
    squares = x * x + y * y
    in_order = np.argsort(squares, kind="stable")
    in_order = in_order[squares[in_order] <= reach * reach]
    columns = np.stack([x, y, squares], axis=1)[in_order]
    return np.concatenate([columns, [[0, 0, reach * reach + 1]]]).astype(np.int32)


def _padded_shape(clouds: LatticeClouds) -> NDArray[np.int64]:
    """Cells of a box around both clouds, in whole vectors along x."""
    from maomaps_warp.kernels.distance_transform import ROW_CELLS

    shape = clouds.upper - clouds.lower + 1
    shape[0] = -(-shape[0] // ROW_CELLS) * ROW_CELLS
    return shape
