"""Maps seen from above, and how well two of them agree.

The score is the correlation coefficient of the obstacles over the cells that both maps know: a large map does not win
by its size, and free cells speak against obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.ground import Ground, find_ground
from maomaps_warp.mapping.projection import project
from maomaps_warp.model.occupancy import Cell

#: Below this correlation a source is not merged. Halves of one flat reach 0.9 and more, different flats 0.2 to 0.8.
MIN_CORRELATION = 0.8
#: A place counts where this share of the smaller map's known cells is known to the other map too.
MIN_OVERLAP = 0.2
#: Edge of a cell in which plans are compared, voxels.
CELL_VOXELS = 2
#: So many cells of obstacles, and as many of free ground, must both maps have where both know: few fit anywhere.
MIN_CELLS = 50
#: Empty cells round an image; the fraction keeps centres of voxels off the edges of cells.
MARGIN_CELLS = 2.25


@dataclass(frozen=True, eq=False)
class Plan:
    """A map seen from above: centres of its occupied and of all its known cells, (N, 2) float64, metres."""

    ground: Ground
    occupied: NDArray[np.float64]
    known: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlanImages:
    """Obstacles and known cells, (H, W) float32 of 0 and 1, rows along x and columns along y."""

    occupied: NDArray[np.float32]
    known: NDArray[np.float32]


def plan_of(points: NDArray[np.float64], voxel_size: float, ground: Ground | None = None) -> Plan:
    """The plan of a map, (N, 3) float64 voxel centres in metres with z up; `ground` is found if not given."""
    ground = find_ground(points, voxel_size) if ground is None else ground
    grid = project(points, voxel_size, ground)
    return Plan(ground, grid.centers(grid.cells == Cell.OCCUPIED), grid.centers(grid.cells != Cell.UNKNOWN))


def turn(yaw: float) -> NDArray[np.float64]:
    """(2, 2) rotation by `yaw` radians."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])


def draw(
    occupied: NDArray[np.float64],
    known: NDArray[np.float64],
    low: NDArray[np.float64],
    shape: tuple[int, int],
    cell: float,
    thickness: int = 1,
) -> PlanImages:
    """Images of points, (N, 2) metres, whose cell [0, 0] begins at `low`; obstacles grow by `thickness` cells."""
    from scipy import ndimage

    def drawn(points: NDArray[np.float64]) -> NDArray[np.bool_]:
        image = np.zeros(shape, dtype=bool)
        image[tuple(np.floor((points - low) / cell).astype(np.int64).T)] = True
        return image

    obstacles = drawn(occupied)
    if thickness:
        obstacles = ndimage.binary_dilation(obstacles, np.ones((3, 3), dtype=bool), iterations=thickness)
    return PlanImages(obstacles.astype(np.float32), (drawn(known) | obstacles).astype(np.float32))


def coefficients(
    n: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64], both: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Pearson's coefficient of two images of 0 and 1 over n cells; -1 where an image is nearly all ones or zeros.

    Args:
        n: cells that count; `a` and `b`: ones of either image in them; `both`: ones of both.
    """
    has_meaning = np.minimum(np.minimum(a, n - a), np.minimum(b, n - b)) >= MIN_CELLS
    n = np.maximum(n, 1.0)
    variances = (a - a * a / n) * (b - b * b / n)
    return np.where(has_meaning, (both - a * b / n) / np.sqrt(np.where(has_meaning, variances, 1.0)), -1.0)


def correlate(target: Plan, source: Plan, cell: float) -> tuple[float, float]:
    """The coefficient of two plans in one frame, and the share of the smaller one's known cells that both know."""
    everything = np.concatenate([target.known, source.known])
    low = everything.min(axis=0) - MARGIN_CELLS * cell
    rows, columns = (int(n) for n in np.ceil((everything.max(axis=0) - low) / cell) + 3)
    one = draw(target.occupied, target.known, low, (rows, columns), cell)
    other = draw(source.occupied, source.known, low, (rows, columns), cell)
    pairs = (
        (one.known, other.known),
        (one.occupied, other.known),
        (one.known, other.occupied),
        (one.occupied, other.occupied),
    )
    n, a, b, both = (np.asarray((x * y).sum(dtype=np.float64)) for x, y in pairs)
    return float(coefficients(n, a, b, both)), float(n / min(one.known.sum(), other.known.sum()))
