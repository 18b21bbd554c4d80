"""The bricks of a band of rows: a window of the grid over them, memory from chunks, sums that never overflow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.depth_rows import Batch, DepthImages, RowBand
from maomaps_warp.model.voxels import pack_keys

#: Edge of a brick, cells.
EDGE = 8
#: Bricks of a chunk of memory: 16 MB with colours. The pages of bricks that are never touched stay unused.
CHUNK_BRICKS = 2048
#: Samples that a cell may take before it is emptied into 64-bit sums; None: what the kernels allow.
SAMPLE_LIMIT: int | None = None
#: A window is laid around what is needed with so many bricks to spare on every side.
_SPARE_BRICKS = 16

_CELLS = EDGE**3


@dataclass(eq=False)
class _Chunk:
    """Memory of some bricks.

    Attributes:
        cells: (bricks * 512, channels) int32.
        places: (bricks,) int32, directory entries, of the window in which a brick was taken.
        used: (1,) int32, bricks in use.
        bricks: (used, 3) int32, indices of bricks, as far as they have been worked out.
    """

    cells: NDArray[np.int32]
    places: NDArray[np.int32]
    used: NDArray[np.int32]
    bricks: NDArray[np.int32]

    @property
    def addresses(self) -> NDArray[np.uint64]:
        """Of the bricks that have been worked out."""
        step = self.cells.shape[1] * _CELLS * self.cells.itemsize
        return np.asarray(self.cells.ctypes.data + step * np.arange(len(self.bricks)), dtype=np.uint64)

    @property
    def filled(self) -> NDArray[np.int32]:
        """The cells of bricks in use."""
        return self.cells[: int(self.used[0]) * _CELLS]


class _Launch:
    """Arrays of a launch, shared between NumPy and Warp."""

    def __init__(self, frames: int, height: int) -> None:
        import warp as wp

        self.addresses = np.zeros((frames, 2), dtype=np.uint64)
        self.T_cells_camera = np.zeros((frames, 4, 4), dtype=np.float32)
        self.pending = np.zeros(frames * height, dtype=np.int32)
        self.nearest = np.zeros(frames * height, dtype=np.int32)
        self.arrays = {
            "addresses": wp.array(self.addresses, dtype=wp.uint64, device="cpu", copy=False),
            "T_cells_camera": wp.array(self.T_cells_camera, dtype=wp.mat44, device="cpu", copy=False),
            "out_pending": wp.array(self.pending, dtype=wp.int32, device="cpu", copy=False),
            "out_nearest": wp.array(self.nearest, dtype=wp.int32, device="cpu", copy=False),
        }


class BrickTable:
    """Accumulators of a band of rows, which one thread fills at a time. State lives here and nowhere else."""

    def __init__(self, images: DepthImages, band: RowBand) -> None:
        import warp as wp

        from maomaps_warp.kernels import voxel_bricks

        self.images, self.band = images, band
        self.channels = 4 if images.with_colors else 1
        self.low = self.size = np.zeros(3, dtype=np.int64)  # the window, bricks
        self.chunks: list[_Chunk] = []
        self.sample_bound = 0  # no cell has taken more samples
        self.archive: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []  # emptied cells: keys, sums
        self.trash = np.zeros((_CELLS, self.channels), dtype=np.int32)
        self.words = wp.empty(images.packets, dtype=voxel_bricks.ints16, device="cpu")
        self.launch: _Launch | None = None
        self.device_table: Any = None  # made anew after every change of window or chunk
        self._lay_window(self.low, self.size)
        self._add_chunk()

    def add(self, batch: Batch) -> NDArray[np.bool_]:
        """Add the band of frames; (frames, rows) bool: of which nothing was added, because they may reach too far.

        The frames together must fit into one window (`fits`).
        """
        from maomaps_warp.kernels import voxel_bricks as kernels

        self._cover(batch.low, batch.high)
        self._make_room(batch.pixels)
        launch = self._launch_of(len(batch))
        launch.addresses[:], launch.T_cells_camera[:] = batch.addresses + self.band.offset, batch.T_cells_camera
        launch.pending[:], launch.nearest[:] = kernels.PENDING, kernels.FULL_SHARE
        while True:
            if self.device_table is None:
                self.device_table = self._device_table()
            kernels.accumulate_rows(
                self.band.rows,
                window=self.window,
                out_table=self.device_table,
                out_words=self.words,
                **launch.arrays,
            )
            if not (launch.pending == kernels.PENDING).any():
                break
            self._add_chunk()
        outside = launch.pending == kernels.OUTSIDE
        shares = launch.nearest.reshape(len(batch), -1).min(axis=1)
        self.sample_bound += self.images.most_in_a_cell(shares / kernels.FULL_SHARE, batch.scale)
        return np.asarray(outside.reshape(len(batch), -1))

    def _launch_of(self, frames: int) -> _Launch:
        """Arrays for a launch over so many frames; those of the last one, if it had as many."""
        if self.launch is None or len(self.launch.addresses) != frames:
            self.launch = _Launch(frames, self.band.count)
        return self.launch

    def located(self) -> tuple[NDArray[np.int32], NDArray[np.uint64]]:
        """Indices, (B, 3), and addresses, (B,), of all bricks in use."""
        self._locate()
        return (
            np.concatenate([chunk.bricks for chunk in self.chunks]),
            np.concatenate([chunk.addresses for chunk in self.chunks]),
        )

    def tighten(self) -> None:
        """Look up what `sample_bound` really is."""
        self.sample_bound = max(int(chunk.filled[:, -1].max(initial=0)) for chunk in self.chunks)

    def empty(self) -> None:
        """Move all sums to the archive, in 64 bits; the bricks stay, with zeros."""
        self._locate()
        for chunk in self.chunks:
            taken = np.nonzero(chunk.filled[:, -1])[0]
            inside = np.stack(np.unravel_index(taken % _CELLS, (EDGE, EDGE, EDGE)), axis=1)
            keys = pack_keys(chunk.bricks[taken // _CELLS] * EDGE + inside)
            self.archive.append((keys, chunk.filled[taken].astype(np.int64)))
            chunk.filled[...] = 0
        self.archive = [merged_sums(self.archive)]
        self.sample_bound = 0

    def _device_table(self) -> Any:
        import warp as wp

        from maomaps_warp.kernels import voxel_bricks

        chunk = self.chunks[-1]
        table = voxel_bricks.BrickTable()
        table.directory = wp.array(self.directory, dtype=wp.uint64, device="cpu", copy=False)
        table.pool = chunk.cells.ctypes.data
        table.places = wp.array(chunk.places, dtype=wp.int32, device="cpu", copy=False)
        table.used = wp.array(chunk.used, dtype=wp.int32, device="cpu", copy=False)
        return table

    def _make_room(self, pixels: int) -> None:
        """See to it that no cell can overflow, whatever `pixels` samples do."""
        limit = sample_limit()
        if self.sample_bound + pixels > limit:
            self.tighten()
        if self.sample_bound + pixels > limit:
            self.empty()

    def _add_chunk(self) -> None:
        self.device_table = None
        # A row is begun only if every pixel of it may find a new brick.
        bricks = max(CHUNK_BRICKS, 4 * self.images.width)
        self.chunks.append(
            _Chunk(
                np.zeros((bricks * _CELLS, self.channels), dtype=np.int32),
                np.zeros(bricks, dtype=np.int32),
                np.zeros(1, dtype=np.int32),
                np.empty((0, 3), dtype=np.int32),
            )
        )

    def _cover(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        """Move the window so that it holds bricks `low` to `high`, both inclusive."""
        end = self.low + self.size
        if (low >= self.low).all() and (high < end).all():
            return
        self._locate()
        both = (low, high) if not self.size.all() else (np.minimum(low, self.low), np.maximum(high, end - 1))
        for (first, last), spare in [(both, _SPARE_BRICKS), (both, 0), ((low, high), _SPARE_BRICKS), ((low, high), 0)]:
            if fits(first - spare, last + spare):
                self._lay_window(first - spare, last - first + 1 + 2 * spare)
                return
        raise ValueError(f"bricks {low} to {high} do not fit into one window")

    def _locate(self) -> None:
        """Work out the indices of bricks that were taken in the window as it lies."""
        for chunk in self.chunks:
            new = chunk.places[len(chunk.bricks) : int(chunk.used[0])]
            if len(new):
                index = np.stack(np.unravel_index(new - 1, tuple(self.size.tolist())), axis=1) + self.low
                chunk.bricks = np.concatenate([chunk.bricks, index.astype(np.int32)])

    def _lay_window(self, low: NDArray[np.int64], size: NDArray[np.int64]) -> None:
        import warp as wp

        from maomaps_warp.kernels.voxel_bricks import BrickWindow

        self.low, self.size, self.device_table = low, size, None
        self.window = BrickWindow()
        self.window.low, self.window.size = (wp.vec3i(*(EDGE * n).tolist()) for n in (low, size))
        self.directory = np.zeros(int(size.prod()) + 1, dtype=np.uint64)
        self.directory[0] = self.trash.ctypes.data
        for chunk in self.chunks:
            place = chunk.bricks - low
            inside = ((place >= 0) & (place < size)).all(axis=1)
            i, j, k = place[inside].T
            self.directory[(i * size[1] + j) * size[2] + k + 1] = chunk.addresses[inside]


def sample_limit() -> int:
    """Samples that a cell may take: `SAMPLE_LIMIT`, else what the kernels allow."""
    from maomaps_warp.kernels.voxel_bricks import MAX_SAMPLES

    return MAX_SAMPLES if SAMPLE_LIMIT is None else SAMPLE_LIMIT


def fits(low: NDArray[np.int64], high: NDArray[np.int64]) -> bool:
    """Whether a window can hold bricks `low` to `high`, both inclusive, and keys their cells."""
    from maomaps_warp.kernels.voxel_bricks import MAX_DIRECTORY
    from maomaps_warp.kernels.voxel_keys import KEY_BIAS

    within_keys = (low >= -KEY_BIAS // EDGE).all() and (high < KEY_BIAS // EDGE).all()
    return bool(within_keys and float((high - low + 1).astype(np.float64).prod()) < MAX_DIRECTORY)


def merged_sums(
    parts: list[tuple[NDArray[np.int64], NDArray[np.int64]]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sorted unique keys, (N,), and their sums, (N, C), of parts that may share keys."""
    keys, place = np.unique(np.concatenate([part[0] for part in parts]), return_inverse=True)
    sums = np.zeros((len(keys), parts[0][1].shape[1]), dtype=np.int64)
    np.add.at(sums, place.reshape(-1), np.concatenate([part[1] for part in parts]))
    return keys, sums
