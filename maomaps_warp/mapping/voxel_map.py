"""Voxel maps from depth frames, frame by frame, on the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import CapacityError, InputError
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap, unpack_keys
from maomaps_warp.protocol import Arithmetic, ColorMean

#: The table grows before it is fuller than this share: linear probing slows down steeply above.
MAX_LOAD = 0.5
MAX_CAPACITY = 1 << 30
_FIRST_CAPACITY = 1 << 16


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


@dataclass(frozen=True, eq=False)
class MapBuild:
    """A map built from frames, with what became of them.

    Attributes:
        voxels: the map.
        frames: frames that were read.
        frames_without_pose: of these, how many the trajectory has no pose for; they are not in the map.
        frames_without_color: of those with a pose, how many have no colours although colours are wanted; they are not
            in the map.
        pixels: depth samples looked at in the other frames.
        pixels_used: of these, how many lie within the range limits and are in the map.
    """

    voxels: VoxelMap
    frames: int
    frames_without_pose: int
    frames_without_color: int
    pixels: int
    pixels_used: int

    @property
    def counts(self) -> dict[str, int]:
        """The counts by name, for the report; that of colours only where they were wanted."""
        colors = {} if self.voxels.colors is None else {"frames_without_color": self.frames_without_color}
        return {
            "frames": self.frames,
            "frames_without_pose": self.frames_without_pose,
            **colors,
            "pixels": self.pixels,
            "pixels_used": self.pixels_used,
        }


def build_voxel_map(
    stream: FrameStream,
    pose_of_frame: Callable[[Frame], NDArray[np.float64] | None],
    grid: VoxelGrid,
    limits: DepthLimits,
    *,
    colors: ColorMean | None = None,
    arithmetic: Arithmetic = "float32",
    device: str = "cpu",
    progress: Callable[[int, int | None], None] | None = None,
) -> MapBuild:
    """Back-project every frame through its pose into a voxel map; memory grows with the map, not with the frames.

    Args:
        stream: the frames.
        pose_of_frame: T_world_camera of a frame, (4, 4) float64, metres; None if it has none.
        grid: the lattice; its origin must lie near the map.
        limits: ranges and stride.
        colors: also average the colours, in this way; frames without colours are then left out. None: no colours.
        arithmetic: of the back-projection.
        device: Warp device.
        progress: called with (frames done, frames in all or None).

    Raises:
        InputError: a point beyond the reach of the grid.
        CapacityError: more voxels than the largest table holds.
    """
    table = _Table(device, with_colors=colors is not None)
    integrate = _integrate_exact if arithmetic == "float64" else _integrate
    frames = without_pose = without_color = pixels = 0
    for frame in stream.read(table.with_colors):
        frames += 1
        T_world_camera = pose_of_frame(frame)
        if T_world_camera is None:
            without_pose += 1
        elif table.with_colors and frame.colors is None:
            without_color += 1
        else:
            samples = _samples(frame, stream, limits.pixel_stride)
            table.reserve(samples)
            integrate(table, frame, stream.camera, T_world_camera, grid, limits)
            pixels += samples
        if progress is not None:
            progress(frames, stream.count)
    _check_nothing_rejected(table, grid, stream.source)
    voxels = _export(table, grid, colors)
    return MapBuild(voxels, frames, without_pose, without_color, pixels, int(voxels.counts.sum()))


class _Table:
    """A voxel hash that grows. State lives here and nowhere else."""

    def __init__(self, device: str, with_colors: bool) -> None:
        from maomaps_warp.kernels.voxel_hash import create_voxel_hash

        self.device, self.with_colors = device, with_colors
        self.hash = create_voxel_hash(_FIRST_CAPACITY, device, with_colors=with_colors)
        self.at_most = 0  # voxels in the table; an upper bound, so that the device is rarely asked

    def colors_of(self, frame: Frame) -> Any:
        """The colours of a frame on the device, (H, W, 3); None if the table keeps none."""
        import warp as wp

        return wp.array(frame.colors, dtype=wp.uint8, device=self.device) if self.with_colors else None

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


def _samples(frame: Frame, stream: FrameStream, stride: int) -> int:
    """How many pixels of a frame are looked at; refuses an image that is not of the camera's size."""
    camera = stream.camera
    if frame.depth.shape != (camera.height, camera.width):
        raise InputError(
            f"{stream.source}, frame {frame.index}",
            f"depth image of {frame.depth.shape[1]}x{frame.depth.shape[0]} pixels",
            f"the camera is {camera.width}x{camera.height}; give the right one with --camera",
        )
    rows, columns = (-(-n // stride) for n in frame.depth.shape)
    return rows * columns


def _integrate(
    table: _Table,
    frame: Frame,
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    grid: VoxelGrid,
    limits: DepthLimits,
) -> None:
    import warp as wp

    from maomaps_warp.kernels.back_projection import DepthSampling, Pinhole, integrate_depth
    from maomaps_warp.mapping.poses import transforms_relative_to

    pinhole, sampling = Pinhole(), DepthSampling()
    pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy = camera.fx, camera.fy, camera.cx, camera.cy
    sampling.min_range, sampling.max_range = limits.min_range, limits.max_range
    sampling.depth_scale, sampling.stride = limits.depth_scale, limits.pixel_stride
    sampling.inv_voxel_size, sampling.center_offset = 1.0 / grid.voxel_size, grid.center_offset
    T_map_camera = transforms_relative_to(grid.origin, T_world_camera[None])
    integrate_depth(
        wp.array(frame.depth, dtype=wp.float32, device=table.device),
        pinhole,
        wp.array(T_map_camera, dtype=wp.transformf, device=table.device),
        sampling,
        colors=table.colors_of(frame),
        out_table=table.hash,
    )


def _integrate_exact(
    table: _Table,
    frame: Frame,
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    grid: VoxelGrid,
    limits: DepthLimits,
) -> None:
    import warp as wp

    from maomaps_warp.kernels.back_projection_exact import ExactPinhole, ExactSampling, integrate_depth_exact

    pinhole, sampling = ExactPinhole(), ExactSampling()
    pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy = camera.fx, camera.fy, camera.cx, camera.cy
    sampling.min_range, sampling.max_range = limits.min_range, limits.max_range
    sampling.depth_scale, sampling.stride = limits.depth_scale, limits.pixel_stride
    sampling.voxel_size, sampling.center_offset = grid.voxel_size, grid.center_offset
    sampling.origin_ijk = wp.vec3l(*grid.origin_ijk.tolist())
    integrate_depth_exact(
        wp.array(frame.depth, dtype=wp.float32, device=table.device),
        pinhole,
        wp.array(T_world_camera[None], dtype=wp.mat44d, device=table.device),
        sampling,
        colors=table.colors_of(frame),
        out_table=table.hash,
    )


def _check_nothing_rejected(table: _Table, grid: VoxelGrid, source: str) -> None:
    full, outside = (int(n) for n in table.hash.rejected.numpy())
    if outside:
        raise InputError(
            source,
            f"{outside} points lie beyond the reach of voxels of {grid.voxel_size} m around {grid.origin.tolist()}",
            "look for a pose that jumps, or raise --voxel-size",
        )
    if full:
        raise CapacityError(f"{source}: the voxel table was full, {full} samples lost")


def _export(table: _Table, grid: VoxelGrid, color_mean: ColorMean | None) -> VoxelMap:
    keys = table.hash.keys.numpy()
    slots = np.nonzero(keys >= 0)[0]
    slots = slots[np.argsort(keys[slots])]
    counts = table.hash.counts.numpy()[slots]
    colors = None
    if color_mean is not None:
        sums, samples = table.hash.color_sums.numpy()[slots], counts[:, None]
        mean = sums // samples if color_mean == "truncated" else (2 * sums + samples) // (2 * samples)
        colors = mean.astype(np.uint8)
    return VoxelMap(grid, unpack_keys(keys[slots]), counts, colors)
