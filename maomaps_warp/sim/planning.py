"""Ways through free space: shortest ones that keep off walls, and ones that come near everything."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.sim.free_space import FreeSpace
from maomaps_warp.sim.tracks import resampled, smoothed

#: Way through a cell beside a wall counts so many times more; it fades with this distance, metres.
_WALL_COST, _WALL_FADE_M = 4.0, 0.25
#: A place counts as explored if the way has passed it this near, metres.
_EXPLORED_M = 1.5
#: Points of a way are so far apart, metres.
WAY_STEP_M = 0.01
#: How far corners are rounded, standard deviation of the smoothing, metres; less where that would leave free space.
_ROUNDING_M = (0.25, 0.15, 0.08, 0.04)


class Planner:
    """Shortest ways between places of a free space."""

    def __init__(self, space: FreeSpace) -> None:
        self.space = space
        self.cells = np.argwhere(space.is_free)
        self._number = np.full(space.is_free.shape, -1, dtype=np.int64)
        self._number[tuple(self.cells.T)] = np.arange(len(self.cells))

    def way(self, start: NDArray[np.float64], goal: NDArray[np.float64]) -> NDArray[np.float64]:
        """The cheapest way between two places, (2,) metres each: (K, 2) metres, cell by cell; they must be free."""
        ends = [self._number[tuple(self.space.cell_of(place))] for place in (start, goal)]
        before = self._before(int(ends[0]))
        chain = [int(ends[1])]
        while chain[-1] != ends[0]:
            chain.append(int(before[chain[-1]]))
        return self.space.place_of(self.cells[chain[::-1]])

    def along(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """The way along several places, (K, 2) metres."""
        legs = [self.way(a, b) for a, b in pairwise(places)]
        return np.concatenate([legs[0], *(leg[1:] for leg in legs[1:])])

    def exploration(self, start: NDArray[np.float64], length: float, seed: int) -> NDArray[np.float64]:
        """A way that comes near every place in a random order, and goes on until it is long enough.

        Args:
            start: (2,) metres, free.
            length: metres, at least.
            seed: of the order.

        Returns:
            (K, 2) metres, cell by cell.
        """
        if len(self.cells) < 2:
            raise InputError("free space", "is a single cell: there is nowhere to go", "give a smaller robot")
        rng = np.random.default_rng(seed)
        middles = self.space.place_of(self.cells)
        left = np.ones(len(middles), dtype=bool)
        legs, here, gone = [start[None]], start, 0.0
        while gone < length:
            self._mark_explored(middles, left, legs[-1])
            if not left.any():
                left[:] = True  # everything was seen: once more, another way
            goal = middles[rng.choice(np.flatnonzero(left))]
            leg = self.way(here, goal)
            gone += float(np.linalg.norm(np.diff(leg, axis=0), axis=1).sum())
            if len(leg) > 1:
                legs.append(leg[1:])
            left &= (middles != goal).any(axis=1)
            here = goal
        return np.concatenate(legs)

    @staticmethod
    def _mark_explored(middles: NDArray[np.float64], left: NDArray[np.bool_], way: NDArray[np.float64]) -> None:
        from scipy.spatial import cKDTree

        candidates = np.flatnonzero(left)
        near = cKDTree(way).query(middles[candidates], distance_upper_bound=_EXPLORED_M)[0] <= _EXPLORED_M
        left[candidates[near]] = False

    def _before(self, start: int) -> NDArray[np.int32]:
        from scipy.sparse.csgraph import dijkstra

        return np.asarray(dijkstra(self._graph, indices=start, return_predecessors=True)[1])

    @cached_property
    def _graph(self) -> Any:
        """Costs between neighbours of eight; diagonal ones only where both cells beside the step are free."""
        from scipy import ndimage
        from scipy.sparse import coo_array

        space = self.space
        clearance = ndimage.distance_transform_edt(np.pad(space.is_free, 1))[1:-1, 1:-1] * space.cell
        cost = 1.0 + _WALL_COST * np.exp(-clearance / _WALL_FADE_M)
        padded = np.pad(self._number, 1, constant_values=-1)
        rows, columns, weights = [], [], []
        i, j = self.cells.T + 1
        for di, dj in ((1, 0), (0, 1), (1, 1), (1, -1)):
            there = padded[i + di, j + dj]
            is_open = (there >= 0) & (padded[i + di, j] >= 0) & (padded[i, j + dj] >= 0)
            here, there = np.flatnonzero(is_open), there[is_open]
            mean = 0.5 * (cost[tuple(self.cells[here].T)] + cost[tuple(self.cells[there].T)])
            rows.append(here)
            columns.append(there)
            weights.append(mean * space.cell * np.hypot(di, dj))
        size = (len(self.cells), len(self.cells))
        half = coo_array((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=size)
        return (half + half.T).tocsr()


def rounded(way: NDArray[np.float64], space: FreeSpace) -> NDArray[np.float64]:
    """A way, (K, 2) metres, with points about `WAY_STEP_M` apart and its corners rounded, as far as free space allows.

    The ends stay where they are. Where the rounded way would leave free space it fades into the way as it was, which
    runs along the middles of free cells; if that does not help, all of it is rounded less, in the end not at all.
    """
    dense = resampled(way, WAY_STEP_M)
    for spread in _ROUNDING_M:
        smooth = smoothed(dense, spread / WAY_STEP_M)
        outside = ~space.holds(smooth)
        if outside.any():
            keep = smoothed(np.clip(smoothed(outside.astype(np.float64)[:, None], 30.0) * 8.0, 0.0, 1.0), 15.0)
            smooth = keep * dense + (1.0 - keep) * smooth
        if space.holds(smooth).all():
            return smooth
    return dense
