"""The scenes that are measured on: made from a seed, once, and kept on disk."""

from __future__ import annotations

import hashlib
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import rooms
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap, pack_keys, unpack_keys

VOXEL_SIZE = 0.05
#: A scored map ends this far below the ceiling, as in the original ground truth; metres.
BELOW_CEILING = 1.0
#: The estimate maps one frame of so many, up to this depth, with noise of this share of it.
EST_EVERY, EST_RANGE, EST_NOISE = 6, 8.0, 0.002
#: Voxels around a building that drift may move a map into.
MARGIN = 60
#: Metres, as in the original map creator.
NEAR, FAR = 0.01, 10.0


@dataclass(frozen=True)
class FlatSize:
    """Rooms along x and y, frames, and pixels of a frame."""

    columns: int
    rows: int
    frames: int
    width: int = 320
    height: int = 240


SIZES = {
    "tiny": FlatSize(1, 1, 12, 64, 48),
    "small": FlatSize(2, 2, 300),
    "apt": FlatSize(4, 3, 600),
    "big": FlatSize(7, 4, 1200),
}


@dataclass(frozen=True, eq=False)
class Flat:
    """One scene.

    Attributes:
        name: key of SIZES.
        camera: of every frame.
        gt, est: trajectories, one pose a frame; the estimate drifts.
        gt_map, est_map: the maps that are scored, without their upper metre, on one grid; no colours.
        depth: (F, H, W) float32, metres; on disk until it is read.
        colors: (F, H, W, 3) uint8.
    """

    name: str
    camera: Camera
    gt: Trajectory
    est: Trajectory
    gt_map: VoxelMap
    est_map: VoxelMap
    depth: NDArray[np.float32]
    colors: NDArray[np.uint8]

    def stream(self) -> FrameStream:
        """The frames as a stream from memory."""
        depth, colors = np.array(self.depth), np.array(self.colors)
        kept = tuple(Frame(i, None, d, c) for i, (d, c) in enumerate(zip(depth, colors, strict=True)))
        return FrameStream(self.camera, len(kept), lambda with_colors: iter(kept), self.name)


def default_folder() -> Path:
    """Where flats are kept unless --scenes says otherwise: the user's cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "maomaps-warp" / "bench"


def load_flat(name: str, folder: Path) -> Flat:
    """A flat, made first if `folder` does not hold it."""
    path = folder / f"{name}-{_recipe()}"
    if not path.is_dir():
        make_flat(SIZES[name], path)
    size, arrays = SIZES[name], np.load(path / "sets.npz")
    gt, est = (Trajectory(arrays[side], arrays["stamps_ns"], side, "world") for side in ("gt", "est"))
    grid = VoxelGrid.around(gt.positions, VOXEL_SIZE)
    maps = [_map_of(arrays[key], grid) for key in ("gt_ijk", "est_ijk")]
    depth, colors = (np.load(path / f"{kind}.npy", mmap_mode="r") for kind in ("depth", "colors"))
    return Flat(name, Camera.from_fov(size.width, size.height, 90.0), gt, est, maps[0], maps[1], depth, colors)


def _recipe() -> str:
    """Changes with the text of what makes flats, so that old ones are not taken for new ones."""
    text = b"".join(Path(file).read_bytes() for file in (__file__, rooms.__file__))
    return hashlib.sha256(text).hexdigest()[:12]


def _map_of(world_ijk: NDArray[np.int32], grid: VoxelGrid) -> VoxelMap:
    ijk = unpack_keys(np.sort(pack_keys(world_ijk - grid.origin_ijk)))
    return VoxelMap(grid, ijk, np.ones(len(ijk), dtype=np.int64))


def make_flat(size: FlatSize, path: Path) -> None:
    """Render a flat and write it to the new folder `path`, whole or not at all."""
    from maomaps_warp.sim.slam import SlamDisturbance, disturbed_trajectory

    building = rooms.furnished_building(size.columns, size.rows, seed=7)
    gt = rooms.walk(building.way, size.frames)
    drift = SlamDisturbance(
        seed=3, scale_error=0.01, yaw_drift=0.005, position_drift=0.03, position_jitter=0.003, rotation_jitter=0.003
    )
    est = disturbed_trajectory(gt, drift)
    camera = Camera.from_fov(size.width, size.height, 90.0)
    unfinished = path.with_name(f"{path.name}.{os.getpid()}")
    unfinished.mkdir(parents=True)
    try:
        _render(building, camera, gt, unfinished)
        depth = np.load(unfinished / "depth.npy", mmap_mode="r")
        gt_ijk = _voxels(size, depth, camera, gt, None)
        est_ijk = _voxels(size, depth, camera, est, np.random.default_rng(5))
        np.savez(
            unfinished / "sets.npz",
            gt=gt.T_world_camera,
            est=est.T_world_camera,
            stamps_ns=np.asarray(gt.stamps_ns),
            gt_ijk=gt_ijk,
            est_ijk=est_ijk,
        )
        unfinished.rename(path)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _render(building: rooms.Building, camera: Camera, gt: Trajectory, folder: Path) -> None:
    """Depth and colours of every pose into `depth.npy` and `colors.npy`, the surfaces roughened."""
    from maomaps_warp.sim.render import render_frames
    from maomaps_warp.sim.scene import GRAIN
    from maomaps_warp.sim.world import plain_world

    world = plain_world(building.vertices, building.triangles, building.face_colors, grain=GRAIN)
    image = (len(gt), camera.height, camera.width)
    depth = np.lib.format.open_memmap(folder / "depth.npy", mode="w+", dtype=np.float32, shape=image)
    colors = np.lib.format.open_memmap(folder / "colors.npy", mode="w+", dtype=np.uint8, shape=(*image, 3))
    directions = _pixel_directions(camera)
    for frame in render_frames(world, camera, gt).read(True):
        T = gt.T_world_camera[frame.index].astype(np.float32)
        points = (directions * frame.depth.reshape(-1, 1)) @ T[:3, :3].T + T[:3, 3]
        depth[frame.index] = frame.depth + _roughness(points).reshape(frame.depth.shape)
        assert frame.colors is not None
        colors[frame.index] = frame.colors


def _pixel_directions(camera: Camera) -> NDArray[np.float32]:
    """Of every pixel, (H * W, 3) float32, optical frame, scaled to z = 1."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3).astype(np.float32)


def _roughness(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unevenness of real walls and of what scans them, up to 2 cm: without it, maps are thinner than real ones."""
    x, y, z = points.T
    return np.asarray(
        0.012 * np.sin(17.0 * x + 13.0 * y) * np.sin(19.0 * y - 11.0 * z) + 0.008 * np.sin(23.0 * z + 29.0 * x)
    )


def _voxels(
    size: FlatSize, depth: NDArray[np.float32], camera: Camera, poses: Trajectory, noise: np.random.Generator | None
) -> NDArray[np.int32]:
    """Voxels of the lower part of a map, (N, 3) int32, in plain NumPy; with noise: of the estimate."""
    directions = _pixel_directions(camera).astype(np.float64)
    every, reach = (1, FAR) if noise is None else (EST_EVERY, EST_RANGE)
    top = round((rooms.CEILING - BELOW_CEILING) / VOXEL_SIZE)
    low = np.array([-MARGIN, -MARGIN, -MARGIN])
    extent = (size.columns * rooms.ROOM, size.rows * rooms.ROOM, rooms.CEILING)
    occupied = np.zeros([2 * MARGIN + round(length / VOXEL_SIZE) for length in extent], dtype=bool)
    for index in range(0, len(depth), every):
        z = depth[index].reshape(-1).astype(np.float64)
        if noise is not None:
            z = z * (1.0 + EST_NOISE * noise.standard_normal(len(z)))
        points = directions * z[:, None]
        distance = np.sqrt(np.einsum("ij,ij->i", points, points))
        T = poses.T_world_camera[index]
        world = points[(distance > NEAR) & (distance < reach)] @ T[:3, :3].T + T[:3, 3]
        i, j, k = (np.rint(world / VOXEL_SIZE).astype(np.int64) - low).T
        occupied[i, j, k] = True
    ijk = np.argwhere(occupied) + low
    return np.asarray(ijk[ijk[:, 2] <= top], dtype=np.int32)
