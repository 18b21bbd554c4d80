"""Voxel maps through a hash on the device, frame by frame: the plain way, in float32 or float64, on CPU and CUDA."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import CapacityError, InputError
from maomaps_warp.mapping.depth_samples import DepthLimits, cells_from_camera
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap, unpack_keys
from maomaps_warp.protocol import Arithmetic, ColorMean

#: The table grows before it is fuller than this share: linear probing slows down steeply above.
MAX_LOAD = 0.5
MAX_CAPACITY = 1 << 30
_FIRST_CAPACITY = 1 << 16


class HashMap:
    """A voxel hash that grows with the frames that are added."""

    def __init__(
        self,
        camera: Camera,
        grid: VoxelGrid,
        limits: DepthLimits,
        *,
        with_colors: bool,
        arithmetic: Arithmetic = "float32",
        device: str = "cpu",
    ) -> None:
        from maomaps_warp.kernels.voxel_hash import create_voxel_hash

        self.camera, self.grid, self.limits = camera, grid, limits
        self.with_colors, self.device = with_colors, device
        self.integrate = _integrate_exact if arithmetic == "float64" else _integrate
        self.hash = create_voxel_hash(_FIRST_CAPACITY, device, with_colors=with_colors)
        self.at_most = 0  # voxels in the table; an upper bound, so that the device is rarely asked

    def add(
        self, depth: NDArray[np.float32], colors: NDArray[np.uint8] | None, T_world_camera: NDArray[np.float64]
    ) -> None:
        """Add a depth image, (H, W), with its colours, (H, W, 3), where they are kept."""
        import warp as wp

        rows, columns = (-(-n // self.limits.pixel_stride) for n in depth.shape)
        self.reserve(rows * columns)
        self.integrate(
            self,
            wp.array(depth, dtype=wp.float32, device=self.device),
            wp.array(colors, dtype=wp.uint8, device=self.device) if self.with_colors else None,
            T_world_camera,
        )

    def reserve(self, samples: int) -> None:
        """Make room for `samples` new voxels, so that no insertion can fail."""
        from maomaps_warp.kernels.voxel_hash import create_voxel_hash, rehash

        if (self.at_most + samples) / MAX_LOAD > self.hash.keys.shape[0]:
            self.at_most = int(self.hash.size.numpy()[0])
        self.at_most += samples
        needed = self.at_most / MAX_LOAD
        if needed <= self.hash.keys.shape[0]:
            return
        capacity = 1 << int(np.ceil(np.log2(needed)))
        if capacity > MAX_CAPACITY:
            raise CapacityError(
                f"the voxel map needs {capacity} slots, more than {MAX_CAPACITY}: raise --voxel-size or shorten the run"
            )
        larger = create_voxel_hash(capacity, self.device, with_colors=self.with_colors)
        rehash(self.hash, larger)
        self.hash = larger

    def finish(self, source: str, color_mean: ColorMean | None) -> VoxelMap:
        """The map of all frames.

        Raises:
            InputError, CapacityError: as `content`.
        """
        keys, sums = self.content(source)
        order = np.argsort(keys)
        return map_of_sums(self.grid, keys[order], sums[order], color_mean)

    def close(self) -> None:
        """Nothing to end."""

    def content(self, source: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Packed keys, (N,), and sums, (N, 4): red, green, blue, samples; (N, 1) without colours. In no order.

        Raises:
            InputError: samples beyond the reach of the grid.
            CapacityError: samples that found no room.
        """
        full, outside = (int(n) for n in self.hash.rejected.numpy())
        if outside:
            raise InputError(
                source,
                f"{outside} points lie beyond the reach of voxels of {self.grid.voxel_size} m around "
                f"{self.grid.origin.tolist()}",
                "look for a pose that jumps, or raise --voxel-size",
            )
        if full:
            raise CapacityError(f"{source}: the voxel table was full, {full} samples lost")
        keys = self.hash.keys.numpy()
        slots = np.nonzero(keys >= 0)[0]
        counts = self.hash.counts.numpy()[slots][:, None]
        if not self.with_colors:
            return keys[slots], counts
        return keys[slots], np.concatenate([self.hash.color_sums.numpy()[slots], counts], axis=1)


def _integrate(table: HashMap, depth: Any, colors: Any, T_world_camera: NDArray[np.float64]) -> None:
    import warp as wp

    from maomaps_warp.kernels.back_projection import DepthSampling, Pinhole, integrate_depth

    camera, grid, limits = table.camera, table.grid, table.limits
    pinhole, sampling = Pinhole(), DepthSampling()
    pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy = camera.fx, camera.fy, camera.cx, camera.cy
    sampling.min_range, sampling.max_range = limits.min_range, limits.max_range
    sampling.center_offset, sampling.stride = grid.center_offset, limits.pixel_stride
    T_cells_camera = cells_from_camera(T_world_camera[None], grid, limits.depth_scale)
    pose = wp.array(T_cells_camera, dtype=wp.mat44, device=table.device)
    integrate_depth(depth, pinhole, pose, sampling, colors=colors, out_table=table.hash)


def _integrate_exact(table: HashMap, depth: Any, colors: Any, T_world_camera: NDArray[np.float64]) -> None:
    import warp as wp

    from maomaps_warp.kernels.back_projection_exact import ExactPinhole, ExactSampling, integrate_depth_exact

    camera, grid, limits = table.camera, table.grid, table.limits
    pinhole, sampling = ExactPinhole(), ExactSampling()
    pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy = camera.fx, camera.fy, camera.cx, camera.cy
    sampling.min_range, sampling.max_range = limits.min_range, limits.max_range
    sampling.depth_scale, sampling.stride = limits.depth_scale, limits.pixel_stride
    sampling.voxel_size, sampling.center_offset = grid.voxel_size, grid.center_offset
    sampling.origin_ijk = wp.vec3l(*grid.origin_ijk.tolist())
    pose = wp.array(T_world_camera[None], dtype=wp.mat44d, device=table.device)
    integrate_depth_exact(depth, pinhole, pose, sampling, colors=colors, out_table=table.hash)


def map_of_sums(
    grid: VoxelGrid, keys: NDArray[np.int64], sums: NDArray[np.int64], color_mean: ColorMean | None
) -> VoxelMap:
    """The map of sorted keys, (N,), and sums, (N, 4): red, green, blue, samples; (N, 1) without colours."""
    counts, colors = np.ascontiguousarray(sums[:, -1]), None
    if color_mean is not None:
        of_colors, samples = sums[:, :3], counts[:, None]
        mean = of_colors // samples if color_mean == "truncated" else (2 * of_colors + samples) // (2 * samples)
        colors = mean.astype(np.uint8)
    return VoxelMap(grid, unpack_keys(keys), counts, colors)
