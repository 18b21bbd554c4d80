"""Which pixels of depth frames become samples of a map, and where the grid has them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.voxels import VoxelGrid


@dataclass(frozen=True)
class DepthLimits:
    """Which depth samples become map points.

    Attributes:
        min_range, max_range: metres, distance to the camera, exclusive.
        pixel_stride: take every n-th pixel of each row and column, from pixel 0.
        depth_scale: multiplies camera-frame points after the range test; 1 unless a Sim(3) alignment scales the map.
    """

    min_range: float = 0.01
    max_range: float = 10.0
    pixel_stride: int = 1
    depth_scale: float = 1.0


def sample_count(frame: Frame, stream: FrameStream, stride: int) -> int:
    """How many pixels of a frame are looked at.

    Raises:
        InputError: an image that is not of the camera's size.
    """
    camera = stream.camera
    if frame.depth.shape != (camera.height, camera.width):
        raise InputError(
            f"{stream.source}, frame {frame.index}",
            f"depth image of {frame.depth.shape[1]}x{frame.depth.shape[0]} pixels",
            f"the camera is {camera.width}x{camera.height}; give the right one with --camera",
        )
    rows, columns = (-(-n // stride) for n in frame.depth.shape)
    return rows * columns


def cells_from_camera(
    T_world_camera: NDArray[np.float64], grid: VoxelGrid, depth_scale: float = 1.0
) -> NDArray[np.float32]:
    """Poses that take camera-frame metres to cells relative to the grid's origin.

    Computed in float64: float32 would lose millimetres far from the world's zero.

    Args:
        T_world_camera: (N, 4, 4) float64, metres.
        grid: the lattice.
        depth_scale: multiplies camera-frame points.

    Returns:
        (N, 4, 4) float32.
    """
    cells = np.array(T_world_camera, dtype=np.float64)
    cells[:, :3, :3] *= depth_scale
    cells[:, :3, 3] -= grid.origin
    cells[:, :3] /= grid.voxel_size
    with np.errstate(over="ignore"):  # what is too far becomes inf, and is refused as beyond the grid's reach
        return cells.astype(np.float32)
