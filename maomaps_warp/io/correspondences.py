"""Correspondences to files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.io.outputs import write_whole
from maomaps_warp.io.text_rows import text_rows
from maomaps_warp.model.correspondences import Correspondences, in_camera


def write_correspondences(
    path: Path,
    correspondences: Correspondences,
    T_world_camera_est: NDArray[np.float64],
    T_world_camera_gt: NDArray[np.float64],
) -> None:
    """Write correspondences: `.npz` with everything, any other name as the original's text.

    Text: `gx gy gz sx sy sz` a line, ground truth then estimate, metres, world. NPZ: `gt_points` and `est_points`
    (M, 3) float64, the same in their cameras' frames (optical) as `gt_points_camera` and `est_points_camera`,
    `element` (M,) and `pose` (M,) int32, `elements` (N, 3) float64, `classes` (N,) uint8 (see `class_names`),
    `T_world_camera_est` and `T_world_camera_gt` (P, 4, 4) float64 of the poses.

    Raises:
        InputError: the file cannot be written; an existing one is kept.
    """
    if path.suffix.lower() == ".npz":
        with write_whole(path, "wb") as file:
            np.savez_compressed(
                file,
                gt_points=correspondences.gt(),
                est_points=correspondences.est(),
                element=correspondences.element,
                pose=correspondences.pose,
                gt_points_camera=in_camera(T_world_camera_gt[correspondences.pose], correspondences.gt()),
                est_points_camera=in_camera(T_world_camera_est[correspondences.pose], correspondences.est()),
                elements=correspondences.elements,
                classes=correspondences.classes,
                class_names=np.array([name for name in correspondences.counts if name != "total"]),
                T_world_camera_est=T_world_camera_est,
                T_world_camera_gt=T_world_camera_gt,
            )
        return
    columns = [*correspondences.gt().T, *correspondences.est().T]
    with write_whole(path, "wb") as file:
        file.writelines(text_rows(columns, lambda number: f"{number:.9g}"))
