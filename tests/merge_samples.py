"""Small sample directories with maps to merge, written as plain text: a corridor that its runs see in part."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

VOXEL = 0.05
NAMES = ("first", "second", "third")
#: Where the runs begin: x, y, z (metres) and the heading (radians).
STARTS = ((0.5, 1.0, 0.4, 0.3), (2.5, 0.75, 0.4, -2.0), (3.6, 1.2, 0.4, 1.2))
#: What each run sees of the corridor, from and to, in voxels along x.
SEEN = ((0, 50), (30, 80), (60, 100))


def corridor(first: int, end: int) -> NDArray[np.int64]:
    """Cells of a part of a corridor along x: a floor, two walls with pilasters, a slab across each second metre."""
    x, y, z = np.meshgrid(np.arange(0, 100), np.arange(0, 40), np.arange(0, 24), indexing="ij")
    floor = z == 0
    walls = (y == 0) | (y == 39)
    pilasters = (x % 20 == 0) & (y < 8)
    slabs = (x % 40 == 15) & (z < 12) & (y > 25)
    cells = np.argwhere(floor | walls | pilasters | slabs)
    return cells[(cells[:, 0] >= first) & (cells[:, 0] < end)]


def pose(x: float, y: float, z: float, yaw: float) -> NDArray[np.float64]:
    """(4, 4) of a turn about z and a shift."""
    T = np.eye(4)
    T[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    T[:3, 3] = x, y, z
    return T


def move(T: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points @ T[:3, :3].T + T[:3, 3]


@dataclass(frozen=True)
class MergeCase:
    """A sample with its sources.

    Attributes:
        folder: the sample directory.
        worlds: the map of each run in the world, metres.
        merged: the merged ground truth.
        sources: files of the runs' own maps.
        T_world_source: where they lie.
    """

    folder: Path
    worlds: tuple[NDArray[np.float64], ...]
    merged: NDArray[np.float64]
    sources: tuple[Path, ...]
    T_world_source: tuple[NDArray[np.float64], ...]

    @property
    def T_first_source(self) -> list[NDArray[np.float64]]:
        """A perfect merge in the first source's frame."""
        return [np.linalg.inv(self.T_world_source[0]) @ T for T in self.T_world_source]

    @property
    def source_options(self) -> list[str]:
        return [word for path in self.sources for word in ("--source", str(path))]


def write_case(folder: Path, cells: Sequence[NDArray[np.int64]] | None = None, runs: int = 2) -> MergeCase:
    """Write a sample of `runs` runs, of the corridor or of the given cells, and the maps of its sources beside it."""
    cells = [corridor(*SEEN[i]) for i in range(runs)] if cells is None else cells
    sample = folder / "sample7"
    sample.mkdir()
    worlds = tuple(np.round(c * VOXEL, 6) for c in cells)
    merged = np.round(np.unique(np.concatenate(cells), axis=0) * VOXEL, 6)
    write_points(sample / "gt_points_merged.txt", merged)
    T_world_source, sources = [], []
    for name, points, (x, y, z, heading) in zip(NAMES, worlds, STARTS, strict=False):
        write_points(sample / f"gt_points_{name}.txt", points)
        # The data set writes the heading less pi.
        (sample / f"start_pose_{name}.txt").write_text(f"{x} {y} {z}\n{heading - math.pi!r}\n")
        T = pose(x, y, z, heading)
        T_world_source.append(T)
        sources.append(write_points(folder / f"map_{name}.xyz", move(np.linalg.inv(T), points)))
    return MergeCase(sample, worlds, merged, tuple(sources), tuple(T_world_source))


def write_points(path: Path, points: NDArray[np.float64]) -> Path:
    path.write_text("".join(f"{x:.12g} {y:.12g} {z:.12g}\n" for x, y, z in points.tolist()))
    return path


def write_matrices(path: Path, matrices: Sequence[NDArray[np.float64] | None]) -> Path:
    """4x4 matrices a file; zeros for None."""
    blocks = [np.zeros((4, 4)) if T is None else T for T in matrices]
    path.write_text("\n\n".join("\n".join(" ".join(map(repr, row)) for row in T.tolist()) for T in blocks) + "\n")
    return path
