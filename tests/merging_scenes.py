"""Maps to merge: a furnished flat as voxels, cut into parts that are turned and shifted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from maomaps_warp.sim.scene import Scene, furnished_flat

F64 = NDArray[np.float64]
VOXEL = 0.05


def on_lattice(points: F64) -> F64:
    """Centres of the voxels that hold the points."""
    return np.unique(np.rint(points / VOXEL).astype(np.int64), axis=0) * VOXEL


def flat(seed: int) -> tuple[Scene, F64]:
    """A flat and the voxels of its surfaces below the ceiling: random points, 6 in each face of a voxel."""
    scene = furnished_flat(seed)
    rng = np.random.default_rng(seed)
    a, b, c = (scene.vertices.astype(np.float64)[scene.triangles[:, corner]] for corner in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    number = np.repeat(np.arange(len(area)), np.ceil(area * 6 / VOXEL**2).astype(np.int64))
    u, v = rng.random((2, len(number), 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    points = a[number] + u * (b - a)[number] + v * (c - a)[number]
    inside = (points[:, 2] > scene.floor_z - 0.02) & (points[:, 2] < scene.ceiling_z - 0.2)
    return scene, on_lattice(points[inside])


def pose(degrees: tuple[float, float, float], shift: tuple[float, float, float]) -> F64:
    """(4, 4) of yaw, pitch and roll, degrees, and a shift, metres."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", degrees, degrees=True).as_matrix()
    T[:3, 3] = shift
    return T


def seen_from(T_world_source: F64, points: F64) -> F64:
    """A map in its own frame, on the lattice there."""
    return on_lattice((points - T_world_source[:3, 3]) @ T_world_source[:3, :3])


def difference(T: F64 | None, expected: F64) -> tuple[float, float]:
    """How far a transform is off: degrees, and metres at its source's zero."""
    assert T is not None
    off = np.linalg.inv(expected) @ T
    return float(np.degrees(Rotation.from_matrix(off[:3, :3]).magnitude())), float(np.linalg.norm(off[:3, 3]))
