"""2D AME and shares of grids against plain loops over cells, and where the answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from maomaps_warp.errors import InputError
from maomaps_warp.model.occupancy import Cell, OccupancyGrid
from maomaps_warp.model.results import NoValue
from maomaps_warp.scoring.occupancy_errors import occupancy_errors

#: Rounding of distances (to a nanometre) and of sums, metres.
ROUNDING_M = 1e-8


def grid(cells, resolution=0.1, origin=(0.0, 0.0, 0.0), source="grid"):
    return OccupancyGrid(np.asarray(cells, dtype=np.uint8), resolution, origin, source)


def random_grid(seed, shape=(23, 31), resolution=0.1, origin=(0.0, 0.0, 0.0)):
    cells = np.random.default_rng(seed).choice(3, shape, p=[0.4, 0.4, 0.2])
    return grid(cells, resolution, origin)


def to_world(g, u, v):
    """World point of a point of the grid's own frame, metres."""
    x, y, yaw = g.origin
    return x + u * math.cos(yaw) - v * math.sin(yaw), y + u * math.sin(yaw) + v * math.cos(yaw)


def cell_of(g, point):
    """(row, column) of the cell that holds a world point; may lie outside."""
    x, y, yaw = g.origin
    dx, dy = point[0] - x, point[1] - y
    u = dx * math.cos(yaw) + dy * math.sin(yaw)
    v = -dx * math.sin(yaw) + dy * math.cos(yaw)
    return math.floor(v / g.resolution + 1e-6), math.floor(u / g.resolution + 1e-6)


def value_at(g, row, column):
    inside = 0 <= row < g.cells.shape[0] and 0 <= column < g.cells.shape[1]
    return int(g.cells[row, column]) if inside else None


def cells_of(g):
    for row in range(g.cells.shape[0]):
        for column in range(g.cells.shape[1]):
            center = to_world(g, (column + 0.5) * g.resolution, (row + 0.5) * g.resolution)
            yield row, column, center, int(g.cells[row, column])


def ame_by_loop(est, gt):
    wanted = [center for _, _, center, value in cells_of(gt) if value == Cell.OCCUPIED]
    found = [center for _, _, center, value in cells_of(est) if value == Cell.OCCUPIED]
    return [min(math.dist(a, b) for b in wanted) for a in found]


def resampled_by_loop(est, gt):
    """{(row, column) of the ground truth's lattice: value} by the documented rule; unknown is left out."""
    corners = [
        cell_of(gt, to_world(est, u * est.cells.shape[1] * est.resolution, v * est.cells.shape[0] * est.resolution))
        for u in (0, 1)
        for v in (0, 1)
    ]
    rows, columns = zip(*corners, strict=True)
    held = {}
    for _, _, center, value in cells_of(est):
        held.setdefault(cell_of(gt, center), []).append(value)
    found = {}
    for row in range(min(rows) - 1, max(rows) + 2):
        for column in range(min(columns) - 1, max(columns) + 2):
            if est.resolution < gt.resolution and (row, column) in held:
                value = max(held[row, column])
            else:
                center = to_world(gt, (column + 0.5) * gt.resolution, (row + 0.5) * gt.resolution)
                value = value_at(est, *cell_of(est, center))
            if value:
                found[row, column] = value
    return found


def shares_by_loop(est, gt):
    of_est = resampled_by_loop(est, gt)
    of_gt = {(row, column): value for row, column, _, value in cells_of(gt) if value}
    shares = {}
    for name, kinds in (("known", (Cell.FREE, Cell.OCCUPIED)), ("occupied", (Cell.OCCUPIED,))):
        a, b = ({cell for cell, value in side.items() if value in kinds} for side in (of_est, of_gt))
        shares[name] = len(a & b), len(a | b)
    return shares


PAIRS = {
    "equal lattices": ((0.1, (0.0, 0.0, 0.0)), (0.1, (0.0, 0.0, 0.0))),
    "shifted by whole cells": ((0.1, (0.0, 0.0, 0.0)), (0.1, (-0.7, 0.4, 0.0))),
    "shifted by a third of a cell": ((0.1, (3.0, -2.0, 0.0)), (0.1, (3.033, -2.067, 0.0))),
    "turned": ((0.1, (0.0, 0.0, 0.0)), (0.1, (0.5, 0.2, 0.4))),
    "both turned": ((0.1, (1.0, 0.0, -2.0)), (0.1, (1.1, 0.1, -1.5))),
    "finer": ((0.1, (0.0, 0.0, 0.0)), (0.05, (0.2, 0.1, 0.0))),
    "a little finer and turned": ((0.1, (0.0, 0.0, 0.0)), (0.09, (0.2, 0.1, 0.785))),
    "coarser": ((0.1, (0.0, 0.0, 0.0)), (0.25, (-1.0, -1.0, 0.3))),
    "apart": ((0.1, (0.0, 0.0, 0.0)), (0.1, (50.0, -80.0, 0.0))),
}


@pytest.mark.parametrize("name", PAIRS)
def test_errors_and_shares_are_those_of_loops_over_cells(name):
    (gt_size, gt_origin), (est_size, est_origin) = PAIRS[name]
    gt, est = random_grid(1, (23, 31), gt_size, gt_origin), random_grid(2, (19, 27), est_size, est_origin)
    found = occupancy_errors(est, gt)
    expected = ame_by_loop(est, gt)
    assert found.ame.count == len(expected)
    assert found.ame.mean == pytest.approx(sum(expected) / len(expected), abs=ROUNDING_M)
    assert found.ame.max == pytest.approx(max(expected), abs=ROUNDING_M)
    for share, (common, either) in shares_by_loop(est, gt).items():
        assert (found.counts[f"{share}_common"], found.counts[f"{share}_any"]) == (common, either)
        assert getattr(found, f"{share}_iou") == common / either
    beneath = [value_at(gt, *cell_of(gt, c)) for _, _, c, value in cells_of(est) if value == Cell.OCCUPIED]
    assert found.counts["est_occupied_on_gt_unknown"] == beneath.count(Cell.UNKNOWN)
    assert found.counts["est_occupied_outside_gt"] == beneath.count(None)
    for side, g in (("est", est), ("gt", gt)):
        for kind in Cell:
            assert found.counts[f"{side}_{kind.name.lower()}"] == sum(v == kind for *_, v in cells_of(g))


def test_a_grid_against_itself_has_no_error():
    for origin in ((0.0, 0.0, 0.0), (-4812.35, 911.05, 0.7)):
        found = occupancy_errors(random_grid(5, origin=origin), random_grid(5, origin=origin))
        assert found.ame.max == 0.0
        assert found.known_iou == found.occupied_iou == 1.0


def test_a_wall_moved_by_three_cells_is_wrong_by_three_cells():
    gt = np.full((20, 30), Cell.FREE)
    gt[:, 5] = Cell.OCCUPIED
    est = np.full((20, 30), Cell.FREE)
    est[:, 8] = Cell.OCCUPIED
    found = occupancy_errors(grid(est, 0.05), grid(gt, 0.05))
    assert [found.ame.mean, found.ame.max] == pytest.approx([0.15, 0.15], abs=ROUNDING_M)
    assert (found.known_iou, found.occupied_iou) == (1.0, 0.0)


def test_the_same_world_on_a_turned_lattice_is_right_to_half_a_cell():
    """A diagonal wall, drawn on two lattices: every centre lies within half a diagonal of the wall."""

    def drawn(resolution, origin, size):
        g = grid(np.full((size, size), Cell.FREE), resolution, origin)
        for row, column, (x, y), _ in cells_of(g):
            if abs(y - 0.5 * x) <= resolution * math.sqrt(0.5):
                g.cells[row, column] = Cell.OCCUPIED
        return g

    found = occupancy_errors(drawn(0.1, (1.0, -1.0, 0.6), 25), drawn(0.1, (0.0, -3.0, 0.0), 60))
    assert found.ame.max <= 0.15
    assert found.counts["est_occupied"] > 20


def test_a_finer_estimate_keeps_its_thin_walls():
    gt = grid([[Cell.OCCUPIED, Cell.FREE]], 0.1)
    fine = np.full((4, 8), Cell.FREE)
    fine[0, 0] = Cell.OCCUPIED
    assert occupancy_errors(grid(fine, 0.025), gt).occupied_iou == 1.0


@pytest.mark.parametrize("side", ["ground truth", "estimate"])
def test_a_side_without_occupied_cells_has_no_value_and_says_which(side):
    full, empty = random_grid(1), grid(np.full((5, 5), Cell.FREE), source="empty.yaml")
    pair = (full, empty) if side == "ground truth" else (empty, full)
    found = occupancy_errors(*pair)
    assert isinstance(found.ame, NoValue)
    assert found.ame.asked and side in found.ame.reason and "empty.yaml" in found.ame.reason
    assert found.known_iou is not None


def test_grids_that_know_nothing_have_no_share():
    nothing = grid(np.zeros((4, 4)))
    found = occupancy_errors(nothing, nothing)
    assert found.known_iou is None and found.occupied_iou is None
    assert found.counts["known_any"] == 0


def test_an_estimate_of_absurd_size_is_refused():
    with pytest.raises(InputError, match=r"far\.yaml: covers"):
        occupancy_errors(grid(np.ones((300, 300)), 1000.0, source="far.yaml"), random_grid(1, resolution=0.01))
