"""The height of the ground in a map, for its projection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.model.voxels import KEY_BIAS, KEY_BITS, VoxelGrid, pack_keys

#: Rules by name; a number given as text is a height, metres.
GROUND_RULES = ("robust", "original")

#: A surface that one can stand on has this much free space above it, metres. It tells a floor from a slab's underside.
HEADROOM_M = 0.5
#: Surfaces are looked at in columns at least this wide, metres, so that a sparsely seen floor has no holes.
COLUMN_M = 0.1
#: A surface is level where it goes on for this far in all four directions, metres; tops of walls do not.
LEVEL_REACH_M = 0.2
#: Floors are not ideally flat: layers this near count for one another, with falling weight, metres.
SMOOTHING_M = 0.05
#: Layers this near to a fuller one belong to it, metres.
SEPARATION_M = 0.1
#: A layer stands out from this many level columns on (0.25 square metres of columns of 0.1 m) ...
MIN_LEVEL_COLUMNS = 25
#: ... if they are this share of the largest layer's: a floor half hidden by furniture still is the floor.
MIN_SHARE = 0.3
#: Where a camera may be above its floor, metres.
CAMERA_ABOVE_FLOOR_M = (0.1, 2.5)
#: Share of the voxels that lie below the height which stands in for a ground that was not found.
FALLBACK_SHARE = 0.01


@dataclass(frozen=True)
class Ground:
    """A level ground.

    Attributes:
        z: its height, metres, world.
        is_found: False: no layer stands out, `z` is only the lower end of the map.
        rule: "robust", "original", or "given".
        note: how it was chosen, or why it was not found; empty where there is nothing to say.
    """

    z: float
    is_found: bool
    rule: str
    note: str = ""


def ground_height(rule: str) -> float | None:
    """The height that a rule fixes, metres; None for a rule that looks at the map.

    Raises:
        InputError: neither a rule nor a finite number.
    """
    if rule in GROUND_RULES:
        return None
    try:
        height = float(rule)
    except ValueError:
        height = np.nan
    if not np.isfinite(height):
        hint = f"{', '.join(GROUND_RULES)}, or a height in metres"
        raise InputError(f"--ground {rule}", "is no rule for the ground", hint)
    return height


def find_ground(
    points: NDArray[np.float64],
    voxel_size: float,
    rule: str = "robust",
    camera_heights: NDArray[np.float64] | None = None,
) -> Ground:
    """The ground that a map is projected on.

    "original" is the original program's rule: the fullest layer at or below the middle of the range of z (of equally
    full ones the lowest).

    "robust" counts level columns with free space above: the top of what is there, where it goes on in all directions.
    Layers of many such columns are floors, tables, and ceilings seen from below. The ground is the lowest layer with
    at least 30 % of the largest one's columns. With camera heights only the layers from 2.5 m to 0.1 m below the
    cameras' median height count, which picks the storey that the camera spent most time on, and no ceiling.

    Args:
        points: (N, 3) float64, metres, world with z up: voxel centres.
        voxel_size: edge of a voxel, metres.
        rule: "robust", "original", or a height in metres as text.
        camera_heights: (M,) float64, z of the cameras, metres; None or none of them: not known.

    Raises:
        InputError: `rule` is none.
    """
    height = ground_height(rule)
    if height is not None:
        return Ground(height, True, "given")
    if not len(points):
        return Ground(0.0, False, rule, "no ground found: the map has no points")
    if rule == "original":
        return Ground(_fullest_below_middle(points, voxel_size), True, rule)
    layers, areas = _level_layers(points, voxel_size)
    peaks = _peaks(areas, max(1, round(SEPARATION_M / voxel_size)))
    # Plus 0.0: a height of -0.0 would read oddly.
    heights = np.asarray(layers[peaks] * voxel_size + 0.0, dtype=np.float64)
    if camera_heights is not None and len(camera_heights):
        return _below_cameras(points, voxel_size, heights, areas[peaks], camera_heights)
    if not len(heights):
        return _not_found(points, voxel_size, "no level layer stands out")
    return _lowest(heights, areas[peaks], "")


def _fullest_below_middle(points: NDArray[np.float64], voxel_size: float) -> float:
    layers, counts = np.unique(np.rint(points[:, 2] / voxel_size), return_counts=True)
    low = 2.0 * layers <= layers[0] + layers[-1]
    return float(layers[low][counts[low].argmax()] * voxel_size + 0.0)


def _below_cameras(
    points: NDArray[np.float64],
    voxel_size: float,
    heights: NDArray[np.float64],
    areas: NDArray[np.float64],
    camera_heights: NDArray[np.float64],
) -> Ground:
    camera = float(np.median(camera_heights))
    nearest, farthest = CAMERA_ABOVE_FLOOR_M
    # To a micrometre: a layer at the very end of the range is inside.
    below = np.round(camera - heights, 6)
    inside = (below >= nearest) & (below <= farthest)
    if inside.any():
        return _lowest(heights[inside], areas[inside], f" below the cameras at {camera:.2f} m")
    reason = f"no level layer stands out from {farthest:g} to {nearest:g} m below the cameras at {camera:.2f} m"
    if len(heights):
        reason += f" (there are some at {_listed(heights)} m)"
    return _not_found(points, voxel_size, reason)


def _lowest(heights: NDArray[np.float64], areas: NDArray[np.float64], place: str) -> Ground:
    heights = heights[areas >= MIN_SHARE * areas.max()]
    note = f"ground: the lowest of the level layers{place}, {_listed(heights)} m" if len(heights) > 1 else ""
    return Ground(float(heights[0]), True, "robust", note)


def _not_found(points: NDArray[np.float64], voxel_size: float, reason: str) -> Ground:
    z = float(np.rint(np.quantile(points[:, 2], FALLBACK_SHARE) / voxel_size) * voxel_size)
    note = f"no ground found: {reason}; {z:.2f} m is used, {FALLBACK_SHARE:.0%} of the voxels lie below"
    return Ground(z, False, "robust", note)


def _listed(heights: NDArray[np.float64]) -> str:
    shown = ", ".join(f"{z:.2f}" for z in heights[:6])
    return shown + (f" and {len(heights) - 6} more" if len(heights) > 6 else "")


def _level_layers(points: NDArray[np.float64], voxel_size: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Every layer from the lowest to the highest voxel, (L,) int64 multiples of the voxel size, and how many level
    columns with free space above it has, (L,) float64, smoothed over neighbouring layers."""
    grid = VoxelGrid.around(points, voxel_size)
    ijk = grid.ijk_of(points)
    width = max(1, round(COLUMN_M / voxel_size))
    columns = np.column_stack([ijk[:, :2] // width, ijk[:, 2]])
    keys = np.unique(pack_keys(columns))
    # Keys run up each column: the next key is the next voxel above.
    room = np.diff(keys, append=np.iinfo(np.int64).max)
    tops = keys[room > max(1, round(HEADROOM_M / voxel_size))]
    half = max(1, round(SMOOTHING_M / voxel_size))
    reach = max(1, round(LEVEL_REACH_M / (width * voxel_size)))
    level = np.ones(len(tops), dtype=bool)
    for step in ((reach, 0), (-reach, 0), (0, reach), (0, -reach)):
        neighbour = tops + (step[0] << (2 * KEY_BITS)) + (step[1] << KEY_BITS)
        level &= np.isin(neighbour[:, None] + np.arange(-half, half + 1), tops).any(axis=1)
    lowest, highest = int(ijk[:, 2].min()), int(ijk[:, 2].max())
    of_layer = (tops[level] & ((1 << KEY_BITS) - 1)) - KEY_BIAS - lowest
    counts = np.bincount(of_layer, minlength=highest - lowest + 1).astype(np.float64)
    weights = 1.0 - np.abs(np.arange(-half, half + 1)) / (half + 1)
    smooth = np.convolve(counts, weights)[half : half + len(counts)]
    return np.arange(lowest, highest + 1) + grid.origin_ijk[2], smooth


def _peaks(areas: NDArray[np.float64], separation: int) -> NDArray[np.int64]:
    """Layers that are large enough and the largest within `separation` layers; of equals the lowest."""
    padded = np.pad(areas, separation, constant_values=-1.0)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * separation + 1)
    is_peak = (windows.argmax(axis=1) == separation) & (areas >= MIN_LEVEL_COLUMNS)
    return np.flatnonzero(is_peak)
