"""Depth frames as rows of packets: what `kernels.voxel_bricks` reads, without copying an image that need not be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.depth_samples import DepthLimits, cells_from_camera
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.voxels import VoxelGrid

#: Share added to a bound, against rounding.
_SLACK = 1.01


@dataclass(frozen=True, eq=False)
class PreparedImage:
    """A frame's images as rows of packets, depth, (H, W) float32, and colours, (H, W, 3) uint8, and as they came."""

    depth: NDArray[np.float32]
    colors: NDArray[np.uint8] | None
    given_depth: NDArray[np.float32]
    given_colors: NDArray[np.uint8] | None


@dataclass(frozen=True, eq=False)
class Batch:
    """Frames that are added together.

    Attributes:
        images: of the frames; kept alive here.
        addresses: (N, 2) uint64, of their memory.
        T_world_camera: (N, 4, 4) float64.
        T_cells_camera: (N, 4, 4) float32.
        scale: (N,) float64, cells of a metre, at least.
        low, high: (3,) int64, bricks within which all samples lie, inclusive.
        pixels: of all frames.
    """

    images: tuple[PreparedImage, ...]
    addresses: NDArray[np.uint64]
    T_world_camera: NDArray[np.float64]
    T_cells_camera: NDArray[np.float32]
    scale: NDArray[np.float64]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    pixels: int

    def __len__(self) -> int:
        return len(self.images)


@dataclass(frozen=True, eq=False)
class RowBand:
    """Rows of every image.

    Attributes:
        first, count: its rows, of those that are sampled.
        offset: (2,) uint64, bytes from the start of an image's depth and of its colours to the band's.
        rows: `kernels.voxel_bricks.DepthRows`.
    """

    first: int
    count: int
    offset: NDArray[np.uint64]
    rows: Any


class DepthImages:
    """How the images of a camera are sampled."""

    def __init__(self, camera: Camera, grid: VoxelGrid, limits: DepthLimits, with_colors: bool) -> None:
        from maomaps_warp.kernels.voxel_bricks import LANES

        self.camera, self.grid, self.limits, self.with_colors = camera, grid, limits, with_colors
        self.stride = limits.pixel_stride
        self.height = -(-camera.height // self.stride)
        sampled_columns = -(-camera.width // self.stride)
        self.packets = -(-sampled_columns // LANES)
        self.width = self.packets * LANES
        self.slopes_u = _slopes(self.width, self.stride, camera.cx, camera.fx)
        self.slopes_v = _slopes(self.height, self.stride, camera.cy, camera.fy)
        # Pixels that a metre across a ray spans at most, one metre away.
        self.steepest_focal = [
            focal * float(np.sqrt(1.0 + np.square(slopes.astype(np.float64)).max()))
            for focal, slopes in ((camera.fx, self.slopes_u), (camera.fy, self.slopes_v))
        ]

    def bands(self, count: int) -> tuple[RowBand, ...]:
        """The rows of an image in `count` bands of about the same size, fewer where there are not so many rows."""
        count = min(count, self.height)
        edges = [self.height * k // count for k in range(count + 1)]
        return tuple(
            RowBand(
                first,
                end - first,
                np.array([first * self.width * 4, first * self.width * 3], dtype=np.uint64),
                self._device_rows(self.slopes_v[first:end]),
            )
            for first, end in pairwise(edges)
        )

    def prepare(self, depth: NDArray[np.float32], colors: NDArray[np.uint8] | None) -> PreparedImage:
        """A frame's images as rows of packets; themselves, if they are."""
        if self.with_colors and (colors is None or colors.shape != (*depth.shape, 3)):
            shape = None if colors is None else colors.shape
            raise ValueError(f"colors: expected shape {(*depth.shape, 3)}, got {shape}")
        kept_colors = self._rows_of(colors, np.uint8) if self.with_colors else None
        return PreparedImage(self._rows_of(depth, np.float32), kept_colors, depth, colors)

    def batch(self, images: Sequence[PreparedImage], T_world_camera: NDArray[np.float64]) -> Batch:
        """Frames with their poses, (N, 4, 4) float64."""
        T_cells_camera = cells_from_camera(T_world_camera, self.grid, self.limits.depth_scale)
        exact = T_cells_camera.astype(np.float64)
        low, high = self._reach(exact)
        addresses = [(_address(image.depth), 0 if image.colors is None else _address(image.colors)) for image in images]
        return Batch(
            tuple(images),
            np.array(addresses, dtype=np.uint64),
            T_world_camera,
            T_cells_camera,
            _least_stretch(exact[:, :3, :3]),
            low,
            high,
            len(images) * self.height * self.width,
        )

    def most_in_a_cell(self, nearest: NDArray[np.float64], scale: NDArray[np.float64]) -> int:
        """A bound of the samples that one cell takes of all frames together.

        Two samples of a cell lie within d, the cell's diagonal, of each other. If one has depth z1 and slope a1 and the
        other z2 and a2, then |a1 - a2| z1 <= |a1 z1 - a2 z2| + |a2| |z1 - z2| <= d sqrt(1 + a2^2), by Cauchy and
        Schwarz; so the pixels of a cell span at most f d sqrt(1 + a^2) / z columns, or rows.

        Args:
            nearest: (N,) least depth of each frame's samples, in shares of the maximal range.
            scale: (N,) of the batch.
        """
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            diagonal_in_depths = np.sqrt(3.0) / (scale * nearest * self.limits.max_range)
            columns, rows = (_SLACK * focal * diagonal_in_depths + 2.0 for focal in self.steepest_focal)
            bound = columns * rows
        return int(np.fmin(np.ceil(bound), self.height * self.width).sum())

    def _reach(self, T_cells_camera: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Bricks that hold everything frames can see: the pyramid of the view, within the sphere of the range."""
        from maomaps_warp.mapping.brick_table import EDGE

        with np.errstate(over="ignore", invalid="ignore"):  # no limit to the range, or no number in a pose
            a, b = self.slopes_u[[0, -1, 0, -1]], self.slopes_v[[0, 0, -1, -1]]
            corners = np.stack([a, b, np.ones(4)], axis=1).astype(np.float64) * self.limits.max_range
            rotation, origin = T_cells_camera[:, :3, :3], T_cells_camera[:, :3, 3]
            ends = np.einsum("nij,cj->nci", rotation, corners)
            radius = np.linalg.norm(rotation, axis=2) * self.limits.max_range
            low = origin + np.maximum(np.minimum(ends.min(axis=1), 0.0), -radius)
            high = origin + np.minimum(np.maximum(ends.max(axis=1), 0.0), radius)
        # 3 cells of slack for rounding. No farther than int64 holds; NaN to where it fits nowhere.
        far = 2.0**40
        low = np.minimum(np.fmax(low - 3.0, -far), far).min(axis=0)
        high = np.maximum(np.fmin(high + 3.0, far), -far).max(axis=0)
        low, high = np.floor(low / EDGE), np.floor(high / EDGE)
        return low.astype(np.int64), high.astype(np.int64)

    def _rows_of(self, image: NDArray[Any] | None, dtype: Any) -> NDArray[Any]:
        assert image is not None
        image = image[:: self.stride, :: self.stride]
        if image.shape[1] == self.width:
            return np.ascontiguousarray(image, dtype=dtype)
        padded = np.zeros((self.height, self.width, *image.shape[2:]), dtype=dtype)
        padded[:, : image.shape[1]] = image
        return padded

    def _device_rows(self, slopes_v: NDArray[np.float32]) -> Any:
        import warp as wp

        from maomaps_warp.kernels.voxel_bricks import DepthRows, vec16

        rows = DepthRows()
        rows.columns = wp.array(self.slopes_u.reshape(self.packets, -1), dtype=vec16, device="cpu")
        rows.rows = wp.array(slopes_v, dtype=wp.float32, device="cpu")
        least, most = np.float32(self.limits.min_range), np.float32(self.limits.max_range)
        rows.least_squared, rows.most_squared, rows.max_range = float(least * least), float(most * most), float(most)
        rows.floor_step = 0.0 if self.grid.center_offset == 0.0 else 1.0
        rows.with_colors = int(self.with_colors)
        return rows


def _slopes(count: int, stride: int, principal: float, focal: float) -> NDArray[np.float32]:
    """(u - cx) / fx of pixels 0, stride, ...: in float32, and rounded where the plain kernel rounds."""
    pixels = (np.arange(count) * stride).astype(np.float32)
    return np.asarray((pixels - np.float32(principal)) / np.float32(focal), dtype=np.float32)


def _least_stretch(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """A lower bound of how much each matrix, (N, 3, 3), stretches any vector; of a scaled rotation, its scale."""
    with np.errstate(over="ignore", invalid="ignore"):  # no number in a pose
        products = matrices.transpose(0, 2, 1) @ matrices
        own = np.diagonal(products, axis1=1, axis2=2)
        # Gershgorin: no eigenvalue lies farther from the diagonal than the sum of its row's other elements.
        least = (2.0 * own - np.abs(products).sum(axis=2)).min(axis=1)
    return np.asarray(np.sqrt(np.maximum(least, 0.0)))


def _address(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])
