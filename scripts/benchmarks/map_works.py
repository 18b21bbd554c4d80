"""Voxel maps from frames in memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks import ours, peers_loop, peers_numba
from benchmarks.flats import FAR, NEAR, Flat
from benchmarks.rows import Row, check_share
from benchmarks.setting import Setting
from benchmarks.timing import interleaved
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.voxels import VoxelMap, pack_keys

I64 = NDArray[np.int64]
#: Frames that the loop in Python maps; its time is scaled by points.
LOOP_FRAMES, QUICK_LOOP_FRAMES = 8, 3
#: Share of points that may lie so near to a voxel's face that float32 and float64 choose different sides.
FACE_SHARE = 1e-3


def against_loop(setting: Setting) -> Iterator[Row]:
    """Ours on all frames against the original's loop on a few."""
    flat, stream = setting.flat, setting.flat.stream()
    frames = list(stream.read(True))
    few = frames[:: max(1, len(frames) // (LOOP_FRAMES if setting.long else QUICK_LOOP_FRAMES))]
    inputs = [(f.depth, f.colors, flat.gt.T_world_camera[f.index]) for f in few if f.colors is not None]
    size = flat.gt_map.grid.voxel_size
    timed = interleaved(
        {
            "ours": lambda: ours.map_of_frames(stream, flat, setting.device),
            "loop": lambda: peers_loop.map_of_frames(inputs, flat.camera, size, NEAR, FAR),
        },
        setting.repeats,
    )
    whole, counts = timed["ours"].result, timed["loop"].result
    points, few_points = int(whole.counts.sum()), sum(counts.values())
    scaled = replace(timed["loop"], seconds=tuple(s * points / few_points for s in timed["loop"].seconds))
    agreement = _compare_with_loop(ours.map_of_frames(_stream_of(few, flat), flat, setting.device), counts)
    sizes = f"{_sizes(flat, frames, whole)}; the loop on {len(few)} frames, {few_points} points, scaled by points"
    yield replace(setting.row("map", sizes, timed["ours"], "loop and dict", scaled), agreement=agreement)


def against_numba(setting: Setting) -> Iterator[Row]:
    """Ours against numba, both on all frames."""
    flat, stream = setting.flat, setting.flat.stream()
    frames = list(stream.read(True))
    depth, colors = np.array(flat.depth), np.array(flat.colors)
    grid, integrate = flat.gt_map.grid, peers_numba.compiled()
    poses = flat.gt.T_world_camera.copy()
    poses[:, :3, 3] -= grid.origin
    voxels = len(ours.map_of_frames(stream, flat, setting.device))
    timed = interleaved(
        {
            "ours": lambda: ours.map_of_frames(stream, flat, setting.device),
            "numba": lambda: peers_numba.map_of_frames(
                integrate, depth, colors, poses, flat.camera, grid, (NEAR, FAR), voxels
            ),
        },
        setting.repeats,
    )
    agreement = _compare_with_numba(timed["ours"].result, *timed["numba"].result)
    row = setting.row("map-1", _sizes(flat, frames, timed["ours"].result), timed["ours"], "numba", timed["numba"])
    yield replace(row, agreement=agreement)


def _sizes(flat: Flat, frames: list[Frame], voxels: VoxelMap) -> str:
    image = f"{flat.camera.width}x{flat.camera.height}"
    return f"{len(frames)} frames of {image}, {int(voxels.counts.sum())} points, {len(voxels)} voxels"


def _stream_of(frames: list[Frame], flat: Flat) -> FrameStream:
    return FrameStream(flat.camera, len(frames), lambda with_colors: iter(frames), flat.name)


def _compare_with_loop(voxels: VoxelMap, counts: peers_loop.Counts) -> str:
    """Every point in the same voxel, but for those near a face."""
    cells = np.array(list(counts), dtype=np.int64) - voxels.grid.origin_ijk
    return _compare_counts(voxels, pack_keys(cells), np.fromiter(counts.values(), np.int64, len(counts)))


def _compare_counts(voxels: VoxelMap, keys: I64, counts: I64) -> str:
    both, place = np.unique(np.concatenate([pack_keys(voxels.ijk), keys]), return_inverse=True)
    difference = np.bincount(place, np.concatenate([voxels.counts, -counts]), len(both))
    # A point that moved to another voxel is missing from one and too many in the other.
    moved = int(max(difference[difference > 0].sum(), -difference[difference < 0].sum()))
    only_one = 2 * len(both) - len(voxels) - len(keys)
    text = check_share("points by voxel", moved, int(counts.sum()), FACE_SHARE)
    return f"{text}; {only_one} voxels are in one map only"


def _compare_with_numba(voxels: VoxelMap, keys: I64, counts: I64, colors: NDArray[np.uint8]) -> str:
    agreement = _compare_counts(voxels, keys, counts)
    assert voxels.colors is not None
    _, mine, other = np.intersect1d(pack_keys(voxels.ijk), keys, assume_unique=True, return_indices=True)
    apart = np.abs(voxels.colors[mine].astype(int) - colors[other].astype(int)).max(axis=1)
    return f"{agreement}; {check_share('mean colours to one level', int((apart > 1).sum()), len(mine), FACE_SHARE)}"
