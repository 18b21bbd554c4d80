"""Voxel maps on the cores of a CPU: frames in small batches, a table of bricks for each thread, one sorted map.

Idea: each thread takes a band of rows of every image, always the same one. The upper rows see other voxels than the
lower ones, mostly: so the tables of the threads share few bricks, which would cost memory and merging, and each fills
less of its core's cache.
Cost: the bricks at the bands' borders are held twice; threads wait for the slowest, BATCHES_AHEAD at most.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.brick_table import BrickTable, fits, merged_sums, sample_limit
from maomaps_warp.mapping.depth_rows import Batch, DepthImages, PreparedImage
from maomaps_warp.mapping.depth_samples import DepthLimits
from maomaps_warp.mapping.hash_map import HashMap, map_of_sums
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap
from maomaps_warp.protocol import ColorMean

#: A batch is handed to the threads when it has so many frames, or so many pixels.
BATCH_FRAMES = 32
BATCH_PIXELS = 1 << 21
#: Batches that may be in work or wait for it.
BATCHES_AHEAD = 2


class BrickMap:
    """Frames on their way into bricks. Each thread adds a band of rows of every frame to a table of its own.

    All sums are integers, so neither the number of threads nor the order of frames changes the map. What does not fit
    into bricks (a range of so many voxels that one frame fills no window, images of millions of pixels, samples beyond
    the reach of keys) goes into a hash, whose kernel computes the same cells.
    """

    def __init__(
        self, camera: Camera, grid: VoxelGrid, limits: DepthLimits, *, with_colors: bool, threads: int = 1
    ) -> None:
        self.images = DepthImages(camera, grid, limits, with_colors)
        self.grid, self.threads = grid, threads
        self.tables = [BrickTable(self.images, band) for band in self.images.bands(threads)]
        self.rest: HashMap | None = None
        self.rest_lock = threading.Lock()
        self.waiting: list[tuple[PreparedImage, NDArray[np.float64]]] = []
        self.running: deque[list[Future[None]]] = deque()  # of each batch in work, its bands
        # A thread for each table, which takes the batches in order.
        self.workers = [ThreadPoolExecutor(1) for _ in self.tables] if threads > 1 else []
        if self.workers:
            _load_kernels()

    def add(
        self, depth: NDArray[np.float32], colors: NDArray[np.uint8] | None, T_world_camera: NDArray[np.float64]
    ) -> None:
        """Add a depth image, (H, W), with its colours, (H, W, 3), where they are kept; both are kept for a while."""
        self.waiting.append((self.images.prepare(depth, colors), np.asarray(T_world_camera, dtype=np.float64)))
        pixels = len(self.waiting) * self.images.height * self.images.width
        if len(self.waiting) == BATCH_FRAMES or pixels >= BATCH_PIXELS:
            self._hand_out()

    def close(self) -> None:
        """End the threads; also after an error."""
        for worker in self.workers:
            worker.shutdown(cancel_futures=True)

    def finish(self, source: str, color_mean: ColorMean | None) -> VoxelMap:
        """The map of all frames.

        Raises:
            InputError: samples beyond the reach of the grid.
        """
        from maomaps_warp.mapping.brick_export import sorted_cells

        if self.waiting:
            self._hand_out()
        while self.running:
            self._wait()
        parts = [] if self.rest is None else [self.rest.content(source)]
        if not (parts or any(table.archive for table in self.tables)):
            if not self._fit_together():
                self._on_all_tables(BrickTable.tighten)
                while self.running:
                    self._wait()
            if self._fit_together():
                return sorted_cells(self.tables, self.grid, color_mean, self.threads)
        for table in self.tables:
            table.empty()
            parts += table.archive
        return map_of_sums(self.grid, *merged_sums(parts), color_mean)

    def _fit_together(self) -> bool:
        """Whether no cell can overflow when the tables are added up."""
        return sum(table.sample_bound for table in self.tables) <= sample_limit()

    def _hand_out(self) -> None:
        images, poses = zip(*self.waiting, strict=True)
        self.waiting = []
        batch = self.images.batch(images, np.stack(poses))
        if len(self.running) == BATCHES_AHEAD:
            self._wait()
        self._on_all_tables(lambda table: self._work(table, batch))

    def _on_all_tables(self, work: Callable[[BrickTable], None]) -> None:
        """Have every table worked on by its thread; here and now where there is but one."""
        if self.workers:
            pairs = zip(self.workers, self.tables, strict=True)
            self.running.append([worker.submit(work, table) for worker, table in pairs])
        else:
            work(self.tables[0])

    def _wait(self) -> None:
        """Until the oldest batch is done."""
        for done in self.running.popleft():
            done.result()

    def _work(self, table: BrickTable, batch: Batch) -> None:
        """Add the table's band of a batch."""
        if len(batch) > 1 and not (fits(batch.low, batch.high) and batch.pixels <= sample_limit()):
            middle = len(batch) // 2
            for part in (slice(0, middle), slice(middle, None)):
                self._work(table, self.images.batch(batch.images[part], batch.T_world_camera[part]))
        elif fits(batch.low, batch.high) and batch.pixels <= sample_limit():
            outside = table.add(batch)
            for frame in np.nonzero(outside.any(axis=1))[0]:
                self._add_to_rest(batch, int(frame), table.band.first + np.nonzero(outside[frame])[0])
        else:
            self._add_to_rest(batch, 0, table.band.first + np.arange(table.band.count))

    def _add_to_rest(self, batch: Batch, frame: int, rows: NDArray[np.intp]) -> None:
        """Add rows of a frame to the hash."""
        image = batch.images[frame]
        of_image = rows * self.images.stride
        depth = np.zeros_like(image.given_depth)
        depth[of_image] = image.given_depth[of_image]
        with self.rest_lock:
            if self.rest is None:
                how = self.images
                self.rest = HashMap(how.camera, how.grid, how.limits, with_colors=how.with_colors)
            self.rest.add(depth, image.given_colors, batch.T_world_camera[frame])


def _load_kernels() -> None:
    """Before threads launch them: loading is not for several at once."""
    import warp as wp

    from maomaps_warp.kernels.modules import MAP, import_kernels

    import_kernels(MAP)
    wp.load_module(MAP, device="cpu")
