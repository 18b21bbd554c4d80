"""Association along transferred rays, from maps and poses in memory to correspondences."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks import ours
from benchmarks.rows import Row, Skipped, WrongResult, check_share
from benchmarks.setting import Setting, with_threads
from benchmarks.timing import interleaved
from maomaps_warp.model.correspondences import Correspondences
from maomaps_warp.protocol import PoseChoice

#: Share of correspondences that may differ between casting into voxels and into their mesh: rays that graze an edge.
GRAZING_SHARE = 5e-4
#: With all poses the plain kernels get one element of so many, and their time is scaled;
#: building meshes is left out of it, which is in their favour.
PLAIN_EVERY = 100
PEER = "plain kernels, mesh"


def nearest_pose(setting: Setting) -> Iterator[Row]:
    """Each element with the nearest pose that sees it."""
    timed = interleaved(
        {
            "ours": lambda: ours.build_and_associate(setting.flat, "nearest", setting.device),
            "plain": lambda: ours.build_and_associate(setting.flat, "nearest", setting.device, plain=True),
        },
        setting.repeats,
    )
    found = timed["ours"].result
    row = setting.row("associate", _sizes(setting, found), timed["ours"], PEER, timed["plain"])
    yield replace(row, agreement=compare(found, timed["plain"].result))


def every_pose(setting: Setting) -> Iterator[Row]:
    """Each element with all poses that see it; the plain kernels on a part of the elements."""
    flat, device = setting.flat, setting.device
    some, meshes = flat.est_map.points[::PLAIN_EVERY], ours.structures(flat, device, plain=True)
    timed = interleaved(
        {
            "ours": lambda: ours.build_and_associate(flat, "all", device),
            "plain": lambda: ours.associate(flat, "all", meshes, some),
        },
        setting.repeats,
    )
    found, part = timed["ours"].result, timed["plain"].result
    scale = len(flat.est_map) / len(some)
    scaled = replace(timed["plain"], seconds=tuple(s * scale for s in timed["plain"].seconds))
    sizes = f"{_sizes(setting, found)}; the plain kernels on {len(some)} elements, scaled"
    row = setting.row("associate-all", sizes, timed["ours"], PEER, scaled)
    yield replace(row, agreement=compare(_of_every(found, PLAIN_EVERY), part))


def threads_nearest(setting: Setting) -> Iterator[Row | Skipped]:
    """Two threads against one, nearest pose."""
    return _threads(setting, "threads", "nearest")


def threads_all(setting: Setting) -> Iterator[Row | Skipped]:
    """Two threads against one, all poses."""
    return _threads(setting, "threads-all", "all")


def _threads(setting: Setting, work: str, choice: PoseChoice) -> Iterator[Row | Skipped]:
    if setting.device != "cpu" or setting.threads < 2:
        yield Skipped(work, "needs two threads of a CPU")
        return

    def on(threads: int) -> Callable[[], Correspondences]:
        def run() -> Correspondences:
            with with_threads(threads):
                return ours.build_and_associate(setting.flat, choice, setting.device)

        return run

    timed = interleaved({"two": on(2), "one": on(1)}, setting.repeats)
    two, one = timed["two"].result, timed["one"].result
    for name in ("classes", "element", "pose", "est_index", "gt_index"):
        if not np.array_equal(getattr(two, name), getattr(one, name)):
            raise WrongResult(f"{work}: `{name}` of two threads differs from that of one")
    row = setting.row(work, _sizes(setting, two), timed["two"], "ours, 1 thread", timed["one"])
    yield replace(row, threads=2, agreement="the same, bit for bit")


def _sizes(setting: Setting, found: Correspondences) -> str:
    flat = setting.flat
    maps = f"{len(flat.gt_map)} / {len(flat.est_map)} voxels, {len(flat.gt)} poses"
    return f"{maps}, {len(found)} correspondences"


def compare(found: Correspondences, other: Correspondences) -> str:
    """The same classes, and the same voxels for each element and pose, but for grazing rays."""
    classes = check_share("classes", int((found.classes != other.classes).sum()), len(found.classes), GRAZING_SHARE)
    keys, others = _pairs(found), _pairs(other)
    _, mine, theirs = np.intersect1d(keys, others, assume_unique=True, return_indices=True)
    same = (found.est_index[mine] == other.est_index[theirs]) & (found.gt_index[mine] == other.gt_index[theirs])
    most = max(len(keys), len(others))
    return f"{classes}; {check_share('correspondences', most - int(same.sum()), most, GRAZING_SHARE)}"


def _pairs(found: Correspondences) -> NDArray[np.int64]:
    return (found.element.astype(np.int64) << 32) | found.pose


def _of_every(found: Correspondences, every: int) -> Correspondences:
    """The correspondences of one element of `every`, as if these had been all."""
    kept = found.element % every == 0
    return replace(
        found,
        classes=found.classes[::every],
        element=found.element[kept] // every,
        pose=found.pose[kept],
        est_index=found.est_index[kept],
        gt_index=found.gt_index[kept],
    )
