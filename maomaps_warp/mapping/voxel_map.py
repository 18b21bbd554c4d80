"""Voxel maps from depth frames, frame by frame, on the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.brick_map import BrickMap
from maomaps_warp.mapping.depth_samples import DepthLimits, sample_count
from maomaps_warp.mapping.hash_map import HashMap
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap
from maomaps_warp.protocol import Arithmetic, ColorMean
from maomaps_warp.threads import thread_count

__all__ = ["DepthLimits", "MapBuild", "build_voxel_map"]


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

    On a CPU in float32, `MAOMAPS_THREADS` threads fill bricks; float64 and CUDA take one hash, a kernel for each frame.
    In float32 the map is the same, bit for bit, whichever way it was made, and on any number of threads.

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
    with_colors = colors is not None
    target = _target(stream, grid, limits, with_colors, arithmetic, device)
    frames = without_pose = without_color = pixels = 0
    try:
        for frame in stream.read(with_colors):
            frames += 1
            T_world_camera = pose_of_frame(frame)
            if T_world_camera is None:
                without_pose += 1
            elif with_colors and frame.colors is None:
                without_color += 1
            else:
                pixels += sample_count(frame, stream, limits.pixel_stride)
                target.add(frame.depth, frame.colors if with_colors else None, T_world_camera)
            if progress is not None:
                progress(frames, stream.count)
        voxels = target.finish(stream.source, colors)
    finally:
        target.close()
    return MapBuild(voxels, frames, without_pose, without_color, pixels, int(voxels.counts.sum()))


def _target(
    stream: FrameStream, grid: VoxelGrid, limits: DepthLimits, with_colors: bool, arithmetic: Arithmetic, device: str
) -> BrickMap | HashMap:
    """What takes the frames: bricks for float32 on a CPU, else the hash."""
    import warp as wp

    if wp.get_device(device).is_cpu and arithmetic == "float32":
        return BrickMap(stream.camera, grid, limits, with_colors=with_colors, threads=thread_count(device))
    return HashMap(stream.camera, grid, limits, with_colors=with_colors, arithmetic=arithmetic, device=device)
