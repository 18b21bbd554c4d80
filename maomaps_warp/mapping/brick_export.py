"""The sorted cells of a map from the bricks of several threads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.brick_table import BrickTable
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap, pack_keys, unpack_keys
from maomaps_warp.protocol import ColorMean


def sorted_cells(tables: Sequence[BrickTable], grid: VoxelGrid, color_mean: ColorMean | None, threads: int) -> VoxelMap:
    """The map of what all tables hold; their sums together must fit into a cell. The tables are spent."""
    import warp as wp

    from maomaps_warp.kernels.voxel_bricks_export import merge_bricks, write_cells

    bricks, sources = _union(tables)
    with_colors = color_mean is not None
    if not len(bricks):
        no_colors = np.empty((0, 3), dtype=np.uint8) if with_colors else None
        return VoxelMap(grid, np.empty((0, 3), dtype=np.int32), np.empty(0, dtype=np.int64), no_colors)
    merged = wp.empty(len(bricks), dtype=wp.uint64, device="cpu")
    lines = wp.empty((len(bricks), 64), dtype=wp.uint8, device="cpu")
    occupied = np.empty((len(bricks), 8), dtype=np.int32)
    merge_bricks(
        wp.array(sources, dtype=wp.uint64, device="cpu", copy=False),
        tables[0].channels,
        out_merged=merged,
        out_lines=lines,
        out_occupied=wp.array(occupied, dtype=wp.int32, device="cpu", copy=False),
        threads=threads,
    )
    slabs = np.append(np.nonzero(np.diff(bricks[:, 0], prepend=np.iinfo(np.int32).min))[0], len(bricks))
    of_layers = np.add.reduceat(occupied, slabs[:-1], axis=0, dtype=np.int64).reshape(-1)
    ends = np.cumsum(of_layers)
    cells = int(ends[-1])
    ijk, counts = np.empty((cells, 3), dtype=np.int32), np.empty(cells, dtype=np.int64)
    colors = np.empty((cells if with_colors else 0, 3), dtype=np.uint8)
    if cells:
        write_cells(
            wp.array(bricks, dtype=wp.vec3i, device="cpu", copy=False),
            merged,
            lines,
            wp.array(slabs.astype(np.int32), device="cpu"),
            wp.array((ends - of_layers).astype(np.int32), device="cpu"),
            rounded=color_mean == "rounded",
            out_ijk=wp.array(ijk, dtype=wp.vec3i, device="cpu", copy=False),
            out_counts=wp.array(counts, device="cpu", copy=False),
            out_colors=wp.array(colors, device="cpu", copy=False),
            threads=threads,
        )
    return VoxelMap(grid, ijk, counts, colors if with_colors else None)


def _union(tables: Sequence[BrickTable]) -> tuple[NDArray[np.int32], NDArray[np.uint64]]:
    """Bricks that any table holds, sorted, (B, 3), and where each table holds them, (B, tables), 0 = nowhere."""
    located = [table.located() for table in tables]
    keys = [pack_keys(bricks) for bricks, _ in located]
    union = np.unique(np.concatenate(keys))
    sources = np.zeros((len(union), len(tables)), dtype=np.uint64)
    for column, (of_table, (_, addresses)) in enumerate(zip(keys, located, strict=True)):
        sources[np.searchsorted(union, of_table), column] = addresses
    return unpack_keys(union), sources
