"""Doubled walls: where a merged map shows a surface twice that the ground truth has once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.chunks import slices
from maomaps_warp.model.merge_results import DoubledWalls
from maomaps_warp.model.voxels import KEY_BIAS, VoxelMap, pack_keys
from maomaps_warp.scoring.nearest import nearest_neighbours

#: Radius of the ball of ground-truth voxels whose plane gives the normal, voxels: 0.15 m at 0.05 m.
NORMAL_RADIUS = 3
#: Fewer voxels in the ball give no plane.
MIN_NEIGHBOURS = 6
#: Largest share of the smallest of the three variances (surface variation: M. Pauly et al., "Efficient simplification
#: of point-sampled surfaces", VIS 2002). A voxelised plane has up to 0.02, one two voxels thick 0.06, a corner of
#: three walls 0.2.
MAX_VARIATION = 0.1
#: Smallest ratio of the middle to the largest variance: 1 for a disc, 0.28 at the rim of a plane, 0 for a rod.
MIN_SPREAD = 0.15
#: Samples along the line are this far apart, voxels.
STEP = 0.5
#: Two surfaces have at least this much empty space between them, voxels; less is one thick surface.
GAP = 2.0
#: Cells looked up in one go.
_CHUNK_SAMPLES = 1 << 20


def find_doubled_walls(
    predicted: VoxelMap, gt: VoxelMap, is_shared: NDArray[np.bool_], distance: float, *, device: str = "cpu"
) -> DoubledWalls:
    """Count the predicted voxels of the overlap that have a second predicted surface near where the truth has one.

    For each predicted voxel whose nearest ground-truth voxel g is shared: n is the normal at g, the direction of the
    smallest variance of the ground-truth voxels within NORMAL_RADIUS of g; where they form no plane (MIN_NEIGHBOURS,
    MAX_VARIATION, MIN_SPREAD) the voxel is undecided. The line through the predicted voxel's centre along n is sampled
    every STEP from -distance to +distance in both maps. A surface is a run of samples in occupied cells; runs with
    less than GAP of empty samples between them are one. Where the ground truth has exactly one surface on the line the
    voxel is decided, and doubled if the prediction has two or more there.

    Args:
        predicted: the merged map in the ground truth's world.
        gt: the merged ground truth, on the same grid, not empty.
        is_shared: (V,) bool: ground-truth voxels that at least two runs have seen.
        distance: metres to both sides.
        device: Warp device of the search for nearest voxels.
    """
    same_origin = np.array_equal(predicted.grid.origin_ijk, gt.grid.origin_ijk)
    if not same_origin or predicted.grid.voxel_size != gt.grid.voxel_size:
        raise ValueError("both maps must lie on one grid")
    nearest = nearest_neighbours(predicted.points, gt.points, device)[0]
    inside = is_shared[nearest]
    cells, nearest = predicted.ijk[inside], nearest[inside]
    used, place = np.unique(nearest, return_inverse=True)
    gt_keys, predicted_keys = pack_keys(gt.ijk), pack_keys(predicted.ijk)
    normals, is_planar = normals_at(gt.ijk[used], gt_keys)
    has_normal = is_planar[place]
    steps = round(distance / (STEP * gt.grid.voxel_size))
    lines = cells[has_normal], normals[place[has_normal]]
    in_gt = surfaces_on_lines(*lines, gt_keys, steps)
    is_decided = in_gt == 1
    in_prediction = surfaces_on_lines(lines[0][is_decided], lines[1][is_decided], predicted_keys, steps)
    return DoubledWalls(
        distance=distance,
        in_overlap=len(cells),
        decided=int(is_decided.sum()),
        doubled=int((in_prediction >= 2).sum()),
        undecided=int((~has_normal).sum()),
        gt_has_more=int((in_gt > 1).sum()),
        gt_has_none=int((in_gt == 0).sum()),
    )


def normals_at(cells: NDArray[np.int32], keys: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Normals of a map at some cells, and whether it is planar there.

    Args:
        cells: (N, 3) int32.
        keys: (V,) int64, sorted: the packed keys of the map.

    Returns:
        (N, 3) float64 of length 1, of either sign; (N,) bool.
    """
    ball = _ball(NORMAL_RADIUS)
    # Sums of 1, x, y, z and of their products over the occupied cells of the ball give mean and covariance.
    ones = np.concatenate([np.ones((len(ball), 1)), ball], axis=1).astype(np.float64)
    terms = np.einsum("bi,bj->bij", ones, ones).reshape(len(ball), 16)
    normals = np.zeros((len(cells), 3))
    is_planar = np.zeros(len(cells), dtype=bool)
    for rows in slices(len(cells), _CHUNK_SAMPLES // len(ball)):
        present = np.stack([occupied(cells[rows] + offset, keys) for offset in ball], axis=1)
        sums = (present.astype(np.float64) @ terms).reshape(-1, 4, 4)
        count = np.maximum(sums[:, 0, 0], 1.0)
        mean = sums[:, 0, 1:] / count[:, None]
        covariance = sums[:, 1:, 1:] / count[:, None, None] - np.einsum("ni,nj->nij", mean, mean)
        variances, axes = np.linalg.eigh(covariance)
        normals[rows] = axes[:, :, 0]
        is_planar[rows] = (
            (sums[:, 0, 0] >= MIN_NEIGHBOURS)
            & (variances[:, 0] <= MAX_VARIATION * variances.sum(axis=1))
            & (variances[:, 1] >= MIN_SPREAD * variances[:, 2])
        )
    return normals, is_planar


def surfaces_on_lines(
    cells: NDArray[np.int32], directions: NDArray[np.float64], keys: NDArray[np.int64], steps: int
) -> NDArray[np.int64]:
    """How many surfaces of a map the line through each cell's centre crosses.

    Args:
        cells: (N, 3) int32: where the lines are centred.
        directions: (N, 3) float64 of length 1.
        keys: (V,) int64, sorted: the packed keys of the map.
        steps: samples to each side, STEP of a voxel apart.

    Returns:
        (N,) int64.
    """
    offsets = STEP * np.arange(-steps, steps + 1)
    least_empty = round(GAP / STEP)
    found = np.zeros(len(cells), dtype=np.int64)
    for rows in slices(len(cells), max(1, _CHUNK_SAMPLES // len(offsets))):
        # In voxels: a face then rounds alike on the whole line.
        on_line = cells[rows, None, :] + offsets[None, :, None] * directions[rows, None, :]
        is_hit = occupied(np.rint(on_line).astype(np.int64).reshape(-1, 3), keys).reshape(-1, len(offsets))
        empty_so_far = np.full(len(is_hit), least_empty)
        for hit in is_hit.T:
            found[rows] += hit & (empty_so_far >= least_empty)
            empty_so_far = np.where(hit, 0, empty_so_far + 1)
    return found


def occupied(cells: NDArray[np.integer], keys: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether each of `cells`, (N, 3) integer, is in a map of sorted packed `keys`, (V,) int64; (N,) bool."""
    if not len(keys):
        return np.zeros(len(cells), dtype=bool)
    wanted = pack_keys(np.clip(cells, -KEY_BIAS, KEY_BIAS - 1))
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.asarray(keys[place] == wanted)


def _ball(radius: int) -> NDArray[np.int64]:
    """Offsets of length up to `radius`, (B, 3) int64."""
    axis = np.arange(-radius, radius + 1)
    offsets = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(offsets[(offsets**2).sum(axis=1) <= radius * radius])
