"""Plain NumPy readers and poses for the trajectory tests; independent of the package."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def read_tum(path: Path, *, double_stamps: bool = False) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Poses (N, 4, 4) and stamps (N,) int64 ns of `t x y z qx qy qz qw` lines.

    With `double_stamps` a stamp is the double nearest to its text (some 0.2 us off), as evo holds it.
    """
    rows = [line.split() for line in path.read_text().splitlines() if line.strip() and line[0] != "#"]
    seconds = [Decimal(float(row[0])) if double_stamps else Decimal(row[0]) for row in rows]
    stamps = np.array([round(second * 10**9) for second in seconds], dtype=np.int64)
    numbers = np.array([[float(x) for x in row[1:8]] for row in rows])
    return _first_of_each(poses(numbers[:, :3], numbers[:, 3:7]), stamps)


def read_euroc(path: Path, *, double_stamps: bool = False) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Poses and stamps of `ns,x,y,z,qw,qx,qy,qz,...` lines; `double_stamps` as in `read_tum`."""
    rows = [line.split(",") for line in path.read_text().splitlines() if line.strip() and line[0] != "#"]
    stamps = np.array([int(row[0]) for row in rows], dtype=np.int64)
    if double_stamps:
        stamps = np.array([round(Decimal(ns / 1e9) * 10**9) for ns in stamps.tolist()], dtype=np.int64)
    numbers = np.array([[float(x) for x in row[1:8]] for row in rows])
    return _first_of_each(poses(numbers[:, :3], numbers[:, [4, 5, 6, 3]]), stamps)


def _first_of_each(T: NDArray[np.float64], stamps: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Without the poses that repeat a stamp; some of the real files hold such poses."""
    unique, first = np.unique(stamps, return_index=True)
    return T[first], unique


def read_kitti(path: Path) -> NDArray[np.float64]:
    """Poses of twelve numbers a line, row-major 3x4, exactly as printed."""
    T = np.tile(np.eye(4), (len(path.read_text().splitlines()), 1, 1))
    T[:, :3, :] = np.loadtxt(path).reshape(-1, 3, 4)
    return T


def poses(positions: NDArray[np.float64], quaternions_xyzw: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 4, 4) from (N, 3) positions and (N, 4) quaternions, which need not be unit."""
    x, y, z, w = (quaternions_xyzw / np.linalg.norm(quaternions_xyzw, axis=1, keepdims=True)).T
    T = np.tile(np.eye(4), (len(positions), 1, 1))
    T[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1)
    T[:, 1, :3] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1)
    T[:, 2, :3] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1)
    T[:, :3, 3] = positions
    return T


def random_poses(rng: np.random.Generator, count: int, spread: float = 3.0) -> NDArray[np.float64]:
    """Poses at normal positions (metres) with uniformly distributed orientations."""
    return poses(spread * rng.normal(size=(count, 3)), rng.normal(size=(count, 4)))


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> NDArray[np.float64]:
    """A (4, 4) pose: rotation about z by `yaw`, then the position."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])
