"""Recordings of depth and colours, and their maps by the fast and by the plain way."""

from __future__ import annotations

import numpy as np
from scenes import camera_pose

from maomaps_warp.mapping.hash_map import HashMap
from maomaps_warp.mapping.voxel_map import DepthLimits, build_voxel_map
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.voxels import VoxelGrid

CAMERA = Camera(64, 48, 40.0, 42.0, 31.0, 24.5)
USUAL = DepthLimits()


def grid(voxel_size=0.05, origin=(0, 0, 0), offset=0.0):
    return VoxelGrid(voxel_size, np.array(origin, dtype=np.int64), offset)


def recording(frames, camera=CAMERA, seed=0, step=0.3):
    """Depths with every kind of missing value in them, colours, and poses along a turning path."""
    rng = np.random.default_rng(seed)
    shape = (frames, camera.height, camera.width)
    depths = (rng.uniform(0.3, 4.0, size=shape) + rng.uniform(0, 9.0, size=(frames, 1, 1))).astype(np.float32)
    for value in (0.0, np.nan, np.inf, -np.inf, -1.0, 1e-30, 3e38):
        depths[rng.random(shape) < 0.03] = value
    colors = rng.integers(0, 256, size=(*shape, 3), dtype=np.uint8)
    poses = [camera_pose((step * i, 0.1 * i, 1.0), 0.4 * i, 0.1 * np.sin(i)) for i in range(frames)]
    return depths, colors, poses


def stream(depths, colors=None, camera=CAMERA):
    def read(with_colors):
        for i, depth in enumerate(depths):
            yield Frame(i, None, depth, colors[i] if with_colors else None)

    return FrameStream(camera, len(depths), read, "test frames")


def fast(data, lattice, limits=USUAL, camera=CAMERA, mean="rounded"):
    depths, colors, poses = data
    return build_voxel_map(
        stream(depths, colors, camera), lambda f: poses[f.index], lattice, limits, colors=mean, device="cpu"
    ).voxels


def plain(data, lattice, limits=USUAL, camera=CAMERA, mean="rounded", device="cpu"):
    table = HashMap(camera, lattice, limits, with_colors=mean is not None, device=device)
    for depth, color, pose in zip(*data, strict=True):
        table.add(depth, color if mean else None, pose)
    return table.finish("test frames", mean)


def assert_same(a, b):
    assert len(a) > 100
    np.testing.assert_array_equal(a.ijk, b.ijk)
    np.testing.assert_array_equal(a.counts, b.counts)
    assert (a.ijk.dtype, a.counts.dtype) == (b.ijk.dtype, b.counts.dtype)
    if a.colors is not None or b.colors is not None:
        np.testing.assert_array_equal(a.colors, b.colors)
