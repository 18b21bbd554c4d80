"""Merging in the plane: the projections of two maps, correlated over every yaw and shift by FFT.

Correlation coefficients over the cells that both maps know, for every shift at once: D. Padfield, "Masked object
registration in the Fourier domain", IEEE Transactions on Image Processing 21(5), 2012.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.merging.plans import (
    CELL_VOXELS,
    MARGIN_CELLS,
    MIN_CORRELATION,
    MIN_OVERLAP,
    Plan,
    coefficients,
    correlate,
    draw,
    plan_of,
    turn,
)
from maomaps_warp.model.placements import Placement

#: The best place must be better than the best one elsewhere by this much: a corridor fits in many places.
MIN_LEAD = 0.05
#: A map with fewer obstacle cells is not merged: anything fits it.
MIN_OBSTACLE_CELLS = 50
#: Steps of the search in yaw, degrees; the refinement finds what lies between.
YAW_STEP_DEGREES = 2.0
#: Turns within so many degrees, or, at one yaw, shifts within so many metres along both axes, are one place.
SAME_YAW_DEGREES, SAME_SHIFT_M = 10.0, 1.0
#: Standard deviation of the Gaussian that softens obstacles for the refinement, voxels.
SOFTENING_VOXELS = 0.7


@dataclass(frozen=True)
class _Peak:
    """The best shift at one yaw.

    Attributes:
        correlation: there, and `elsewhere` the best one at the same yaw and another place.
        yaw: radians about the source's zero; x, y: metres, added after the turn.
    """

    correlation: float
    elsewhere: float
    yaw: float
    x: float
    y: float


def place_by_correlation(target: NDArray[np.float64], source: NDArray[np.float64], voxel_size: float) -> Placement:
    """Find yaw and shift of `source` in `target`; the height comes from the two grounds.

    Args:
        target: (N, 3) float64, metres, z up: voxel centres on multiples of the voxel size.
        source: (M, 3) likewise.
        voxel_size: metres.

    Returns:
        The placement; its confidence is the correlation of the obstacles over the cells that both know.
    """
    if not len(target) or not len(source):
        return Placement(None, None, "a map has no points")
    plans = plan_of(target, voxel_size), plan_of(source, voxel_size)
    fewest = min(len(plan.occupied) for plan in plans)
    if fewest < MIN_OBSTACLE_CELLS:
        return Placement(None, None, f"{fewest} obstacle cells in a projection, fewer than {MIN_OBSTACLE_CELLS}")
    cell = CELL_VOXELS * voxel_size
    peaks = _search(*plans, cell)
    if not peaks:
        return Placement(None, None, f"no place where {MIN_OVERLAP:.0%} of the smaller map overlaps")
    best = _refined(*plans, peaks[0], voxel_size)
    moved = replace(plans[1], occupied=_at(best, plans[1].occupied), known=_at(best, plans[1].known))
    correlation = max(correlate(plans[0], moved, cell)[0], 0.0)
    if correlation < MIN_CORRELATION:
        return Placement(None, correlation, f"correlation {correlation:.2f} is below {MIN_CORRELATION}")
    elsewhere = _best_elsewhere(peaks)
    if peaks[0].correlation - elsewhere < MIN_LEAD:
        return Placement(None, correlation, f"another place fits as well: {elsewhere:.2f}")
    T = np.eye(4)
    T[:2, :2] = turn(best.yaw)
    T[:3, 3] = best.x, best.y, plans[0].ground.z - plans[1].ground.z
    return Placement(T, correlation)


def _at(peak: _Peak, points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points @ turn(peak.yaw).T + (peak.x, peak.y)


def _search(target: Plan, source: Plan, cell: float) -> list[_Peak]:
    """The best shift at each yaw, best first."""
    from scipy import fft

    low = target.known.min(axis=0) - MARGIN_CELLS * cell
    middle = source.known.mean(axis=0)
    reach = float(np.linalg.norm(source.known - middle, axis=1).max()) + 2 * cell
    rows, columns = (int(n) for n in np.ceil((target.known.max(axis=0) - low) / cell) + 3)
    side = int(np.ceil(2 * reach / cell)) + 3
    shape = [fft.next_fast_len(n + side, real=True) for n in (rows, columns)]
    still = draw(target.occupied, target.known, low, (rows, columns), cell)
    F_occupied, F_known = fft.rfft2(still.occupied, shape), fft.rfft2(still.known, shape)
    peaks = []
    for yaw in np.radians(np.arange(0.0, 360.0, YAW_STEP_DEGREES)):
        R = turn(yaw)
        turned = ((source.occupied - middle) @ R.T, (source.known - middle) @ R.T)
        moving = draw(*turned, np.array([-reach, -reach]), (side, side), cell)
        G_occupied, G_known = (np.conj(fft.rfft2(image, shape)) for image in (moving.occupied, moving.known))
        products = (F_known * G_known, F_occupied * G_known, F_known * G_occupied, F_occupied * G_occupied)
        n, a, b, both = (np.rint(fft.irfft2(product, shape)) for product in products)
        correlation = coefficients(n, a, b, both)
        correlation[n < MIN_OVERLAP * min(still.known.sum(), moving.known.sum())] = -1.0
        best, elsewhere, at = _two_best(correlation, round(SAME_SHIFT_M / cell))
        if best > -1.0:
            # Shifts beyond the target's own size are negative ones.
            cells = [i if i < n else i - period for i, n, period in zip(at, (rows, columns), shape, strict=True)]
            x, y = low + np.array(cells) * cell + reach - R @ middle
            peaks.append(_Peak(best, elsewhere, float(yaw), float(x), float(y)))
    return sorted(peaks, key=lambda peak: -peak.correlation)


def _two_best(correlation: NDArray[np.float64], window: int) -> tuple[float, float, tuple[int, int]]:
    """The largest value, the largest one more than `window` cells from it along an axis (the image is periodic), and
    where the largest is."""
    row, column = (int(i) for i in np.unravel_index(int(correlation.argmax()), correlation.shape))
    near = np.arange(-window, window + 1)
    rest = correlation.copy()
    rest[np.ix_((row + near) % correlation.shape[0], (column + near) % correlation.shape[1])] = -1.0
    return float(correlation[row, column]), float(rest.max()), (row, column)


def _best_elsewhere(peaks: list[_Peak]) -> float:
    """The best correlation at another place than the first peak's."""
    turns = [abs((np.degrees(peak.yaw - peaks[0].yaw) + 180.0) % 360.0 - 180.0) for peak in peaks]
    others = [peak.correlation for peak, turn in zip(peaks, turns, strict=True) if turn > SAME_YAW_DEGREES]
    return max([peaks[0].elsewhere, *others])


def _refined(target: Plan, source: Plan, start: _Peak, voxel_size: float) -> _Peak:
    """Find yaw and shift between the steps of the search, by the same correlation of softened obstacles."""
    from scipy import ndimage, optimize

    low, known, soft = _softened(target, voxel_size)
    source_low, _, source_soft = _softened(source, voxel_size)
    labels = _sampled(source_soft, source.known, source_low, voxel_size)
    middle = source.known.mean(axis=0)
    centered = source.known - middle
    reach = float(np.linalg.norm(centered, axis=1).max())
    place = turn(start.yaw) @ middle + (start.x, start.y)

    def cost(moves: NDArray[np.float64]) -> float:
        # All three in metres, so that one step means as much in each.
        moved = centered @ turn(start.yaw + moves[0] / reach).T + place + moves[1:]
        at = (moved - low) / voxel_size - 0.5
        both = ndimage.map_coordinates(known, at.T, order=0, mode="constant") > 0
        seen = _sampled(soft, moved[both], low, voxel_size)
        here = labels[both] - labels[both].mean() if both.any() else labels[both]
        spread = float(np.linalg.norm(here)) * float(np.linalg.norm(seen - seen.mean())) if both.any() else 0.0
        return -float(here @ seen) / spread if spread > 0 else 0.0

    step = CELL_VOXELS * voxel_size
    simplex = np.vstack([np.zeros(3), step * np.eye(3)])
    options = {"initial_simplex": simplex, "xatol": 0.01 * voxel_size, "fatol": 1e-7, "maxiter": 400}
    moves = optimize.minimize(cost, np.zeros(3), method="Nelder-Mead", options=options).x
    yaw = start.yaw + moves[0] / reach
    x, y = place + moves[1:] - turn(yaw) @ middle
    return _Peak(start.correlation, start.elsewhere, float(yaw), float(x), float(y))


def _softened(plan: Plan, voxel_size: float) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float64]]:
    """Where cell [0, 0] begins, the known cells, and the obstacles under a Gaussian; one cell a voxel."""
    from scipy import ndimage

    low = plan.known.min(axis=0) - 4.5 * voxel_size  # voxel centres in the middle of cells
    rows, columns = (int(n) for n in np.ceil((plan.known.max(axis=0) - low) / voxel_size) + 4)
    images = draw(plan.occupied, plan.known, low, (rows, columns), voxel_size, thickness=0)
    return low, images.known, np.asarray(ndimage.gaussian_filter(images.occupied.astype(np.float64), SOFTENING_VOXELS))


def _sampled(
    image: NDArray[np.float64], points: NDArray[np.float64], low: NDArray[np.float64], voxel_size: float
) -> NDArray[np.float64]:
    from scipy import ndimage

    at = (points - low) / voxel_size - 0.5
    return np.asarray(ndimage.map_coordinates(image, at.T, order=1, mode="constant"))
