"""How time grows with voxels, poses and frames, over two decades each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks import ours
from benchmarks.flats import Flat
from benchmarks.setting import Setting
from benchmarks.timing import interleaved
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.voxels import VoxelMap
from maomaps_warp.protocol import PoseChoice

CHOICES: tuple[PoseChoice, ...] = ("nearest", "all")
#: Shares of the whole, a third of a decade apart.
SHARES = (0.01, 0.0215, 0.0464, 0.1, 0.215, 0.464, 1.0)


@dataclass(frozen=True)
class Growth:
    """One curve.

    Attributes:
        what: is timed.
        over: what grows.
        sizes: how far, ascending.
        seconds: medians.
        exponent: of the power law that fits best: slope of log(seconds) over log(sizes), least squares.
        exponent_above: the same over the upper decade, where fixed costs no longer count.
    """

    what: str
    over: str
    sizes: tuple[int, ...]
    seconds: tuple[float, ...]
    exponent: float
    exponent_above: float


def curves(setting: Setting) -> Iterator[Growth]:
    """Every curve, on the whole of the setting's flat and parts of it."""
    flat, device = setting.flat, setting.device
    parts = [_part(flat, share) for share in SHARES]
    voxels = [len(part.gt_map) for part in parts]
    yield _curve(setting, "ray field", "voxels", voxels, [partial(ours.ray_field, p.gt_map, device) for p in parts])
    yield _curve(
        setting,
        "nearest, lattice",
        "queries and points",
        [len(part.est_map) + len(part.gt_map) for part in parts],
        [partial(_distances, p, device) for p in parts],
    )
    elements = [len(part.est_map) for part in parts]
    for choice in CHOICES:
        runs = [partial(ours.build_and_associate, part, choice, device) for part in parts]
        yield _curve(setting, f"association, {choice}", "elements", elements, runs)
    rows = [_spread(len(flat.gt), share) for share in SHARES]
    seen = [replace(flat, gt=flat.gt.select(index), est=flat.est.select(index)) for index in rows]
    for choice in CHOICES:
        runs = [partial(ours.build_and_associate, part, choice, device) for part in seen]
        yield _curve(setting, f"association, {choice}", "poses", [len(index) for index in rows], runs)
    frames = list(flat.stream().read(True))
    mapped = [partial(ours.map_of_frames, _stream(flat, [frames[i] for i in index]), flat, device) for index in rows]
    yield _curve(setting, "voxel map", "frames", [len(index) for index in rows], mapped)


def _curve(setting: Setting, what: str, over: str, sizes: list[int], runs: Sequence[Callable[[], object]]) -> Growth:
    timed = interleaved({str(place): run for place, run in enumerate(runs)}, setting.repeats)
    seconds = tuple(float(np.median(part.seconds)) for part in timed.values())
    upper = [place for place, size in enumerate(sizes) if size >= 0.09 * sizes[-1]]
    above = exponent([sizes[p] for p in upper], [seconds[p] for p in upper])
    return Growth(what, over, tuple(sizes), seconds, exponent(sizes, seconds), above)


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Slope of log(seconds) over log(sizes)."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def _distances(part: Flat, device: str) -> NDArray[np.float64]:
    return ours.distances(part.est_map.points, part.gt_map.points, device, part.gt_map.grid.voxel_size)


def _stream(flat: Flat, frames: Sequence[Frame]) -> FrameStream:
    return FrameStream(flat.camera, len(frames), lambda with_colors: iter(frames), flat.name)


def _spread(count: int, share: float) -> NDArray[np.int64]:
    """So many indices of range(count), evenly spread."""
    return np.unique(np.linspace(0, count - 1, max(2, round(share * count))).astype(np.int64))


def _part(flat: Flat, share: float) -> Flat:
    """A corner of a flat: both maps within a square from the lower corner that holds about `share` of them."""
    gt, est = (np.maximum(m.points[:, 0], m.points[:, 1]) for m in (flat.gt_map, flat.est_map))
    edge = float(np.quantile(gt, share))
    return replace(flat, gt_map=_where(flat.gt_map, gt <= edge), est_map=_where(flat.est_map, est <= edge))


def _where(voxels: VoxelMap, kept: NDArray[np.bool_]) -> VoxelMap:
    return VoxelMap(voxels.grid, voxels.ijk[kept], voxels.counts[kept])


def growth_table(found: Sequence[Growth]) -> str:
    """All curves in Markdown."""
    lines = ["| what | over | from | to | seconds | exponent | upper decade |", "|---|---|---|---|---|---|---|"]
    for curve in found:
        times = ", ".join(f"{s:.3g}" for s in curve.seconds)
        lines.append(
            f"| {curve.what} | {curve.over} | {curve.sizes[0]} | {curve.sizes[-1]} | {times} "
            f"| {curve.exponent:.2f} | {curve.exponent_above:.2f} |"
        )
    return "\n".join(lines)
