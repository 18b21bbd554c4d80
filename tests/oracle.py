"""A plain NumPy twin of the stages in float64. It imports nothing of the package."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def back_project(depth: NDArray[np.float32], camera: tuple[float, float, float, float], T: F64) -> F64:
    """World points of the pixels with 0.01 m < |p| < 10 m; camera = (fx, fy, cx, cy)."""
    fx, fy, cx, cy = camera
    v, u = np.nonzero(depth > 0)
    z = depth[v, u].astype(np.float64)
    p = np.stack([z * (u - cx) / fx, z * (v - cy) / fy, z], axis=1)
    distance = np.linalg.norm(p, axis=1)
    p = p[(distance > 0.01) & (distance < 10.0)]
    return p @ T[:3, :3].T + T[:3, 3]


def voxels_of(points: F64, voxel_size: float = 0.05) -> set[tuple[int, int, int]]:
    return {tuple(int(c) for c in cell) for cell in np.rint(points / voxel_size)}


def first_voxel(
    occupied: set[tuple[int, int, int]], origin: F64, direction: F64, voxel_size: float, steps: int = 2000
) -> tuple[int, int, int] | None:
    """First occupied cell (centred on k * voxel_size) on a ray, by Amanatides and Woo's walk, 1987."""
    o = origin / voxel_size + 0.5
    cell = np.floor(o).astype(int)
    step = np.sign(direction).astype(int)
    with np.errstate(divide="ignore"):
        inverse = 1.0 / direction
    border = cell + (step > 0)
    t_next = np.where(step != 0, (border - o) * inverse, np.inf)
    t_step = np.where(step != 0, np.abs(inverse), np.inf)
    for _ in range(steps):
        key = (int(cell[0]), int(cell[1]), int(cell[2]))
        if key in occupied:
            return key
        axis = int(np.argmin(t_next))
        cell[axis] += step[axis]
        t_next[axis] += t_step[axis]
    return None


def robust_first_voxel(
    occupied: set[tuple[int, int, int]], origin: F64, direction: F64, voxel_size: float, band: float
) -> tuple[tuple[int, int, int] | None, bool]:
    """The hit, and whether shifting the ray by `band` metres to either side along each axis leaves it the same."""
    hit = first_voxel(occupied, origin, direction, voxel_size)
    shifts = [sign * band * np.eye(3)[axis] for axis in range(3) for sign in (-1, 1)]
    return hit, all(first_voxel(occupied, origin + s, direction, voxel_size) == hit for s in shifts)


def nearest_distances(queries: F64, points: F64) -> F64:
    """Brute force."""
    return np.array([np.sqrt(((points - q) ** 2).sum(axis=1).min()) for q in queries])


def associate(
    elements: F64,
    est: set[tuple[int, int, int]],
    gt: set[tuple[int, int, int]],
    T_est: F64,
    T_gt: F64,
    half_width: float,
    half_height: float,
    tolerance: float,
    voxel_size: float,
    choice: str,
    band: float,
) -> list[tuple[str, int, tuple | None, tuple | None, bool]]:
    """Class, pose, estimate's voxel, ground-truth voxel, and whether the answer is safe from rounding.

    half_width and half_height are the slopes of the image's borders (a symmetric view).
    """
    answers = []
    for c in elements:
        seen: list[tuple[float, int, tuple]] = []
        in_view, safe = False, True
        for t in range(len(T_est)):
            q = T_est[t, :3, :3].T @ (c - T_est[t, :3, 3])
            if q[2] <= 0.01 or abs(q[0]) >= half_width * q[2] or abs(q[1]) >= half_height * q[2]:
                safe &= abs(abs(q[0]) - half_width * q[2]) > band and abs(abs(q[1]) - half_height * q[2]) > band
                continue
            in_view = True
            hit, sure = robust_first_voxel(
                est, T_est[t, :3, 3], T_est[t, :3, :3] @ (q / np.linalg.norm(q)), voxel_size, band
            )
            safe &= sure
            if hit is None:
                continue
            gap = np.linalg.norm(np.array(hit) * voxel_size - c)
            safe &= abs(gap - tolerance) > band
            if gap < tolerance:
                seen.append((float(np.linalg.norm(q)), t, hit))
        if not seen:
            answers.append(("occluded" if in_view else "out_of_view", -1, None, None, safe))
            continue
        ranked = {"nearest": sorted(seen), "first": seen, "last": seen[::-1]}[choice]
        _, t, est_hit = ranked[0]
        q = T_est[t, :3, :3].T @ (c - T_est[t, :3, 3])
        gt_hit, sure = robust_first_voxel(
            gt, T_gt[t, :3, 3], T_gt[t, :3, :3] @ (q / np.linalg.norm(q)), voxel_size, band
        )
        kind = "associated" if gt_hit else "no_ground_truth"
        answers.append((kind, t, est_hit, gt_hit, safe and sure))
    return answers
