"""Each thread takes a band of rows of every image; no row is lost, taken twice or taken for another."""

from __future__ import annotations

import numpy as np
import pytest
from depth_recordings import CAMERA, USUAL, assert_same, fast, grid, plain, recording

from maomaps_warp.mapping import brick_map
from maomaps_warp.mapping.brick_map import BrickMap
from maomaps_warp.mapping.brick_table import BrickTable
from maomaps_warp.mapping.depth_rows import DepthImages
from maomaps_warp.mapping.voxel_map import DepthLimits
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.scene import furnished_flat
from maomaps_warp.threads import THREADS_VARIABLE


@pytest.mark.parametrize("count", [1, 2, 3, 7, 48, 100])
def test_bands_follow_one_another_and_hold_every_row_once(count):
    bands = DepthImages(CAMERA, grid(), USUAL, True).bands(count)
    rows = np.concatenate([band.first + np.arange(band.count) for band in bands])
    np.testing.assert_array_equal(rows, np.arange(CAMERA.height))
    sizes = [band.count for band in bands]
    assert len(bands) == min(count, CAMERA.height) and max(sizes) - min(sizes) <= 1
    for band in bands:
        np.testing.assert_array_equal(
            band.rows.rows.numpy(),
            (np.arange(48, dtype="f4") - np.float32(24.5))[rows][band.first : band.first + band.count]
            / np.float32(42.0),
        )


@pytest.mark.parametrize("height", [1, 2, 7, 9])
def test_images_of_fewer_rows_than_threads_or_than_a_block_are_taken_whole(height, monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, "4")
    camera = Camera(64, height, 40.0, 42.0, 31.0, 0.5 * height)
    data = recording(9, camera)
    assert_same(fast(data, grid(), camera=camera), plain(data, grid(), camera=camera))


@pytest.mark.parametrize("stride", [1, 3])
def test_rows_that_a_band_leaves_out_go_into_the_hash_as_the_rows_they_are(stride, monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, "3")
    add = BrickTable.add

    def add_even_bands(table, batch):
        if table.band.first == 0:
            return add(table, batch)
        return np.ones((len(batch), table.band.count), dtype=np.bool_)

    monkeypatch.setattr(BrickTable, "add", add_even_bands)
    data, limits = recording(5, seed=21), DepthLimits(pixel_stride=stride)
    assert_same(fast(data, grid(), limits), plain(data, grid(), limits))


def test_an_error_in_a_band_comes_through(monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, "2")
    monkeypatch.setattr(brick_map, "BATCH_FRAMES", 1)

    def fail(table, batch):
        raise MemoryError("no room for bricks")

    monkeypatch.setattr(BrickTable, "add", fail)
    with pytest.raises(MemoryError, match="no room for bricks"):
        fast(recording(6), grid())


def test_bands_of_a_level_camera_share_few_bricks():
    from maomaps_warp.sim.agent import drive
    from maomaps_warp.sim.render import render_frames

    scene, camera = furnished_flat(0), Camera.from_fov(64, 48, 90.0)
    whole = drive(scene, frames=220, seed=0)
    assert whole.stamps_ns is not None
    way = Trajectory(whole.T_world_camera[::8], whole.stamps_ns[::8])
    table = BrickMap(camera, grid(), USUAL, with_colors=False, threads=2)
    for frame in render_frames(scene.world, camera, way).read(False):
        table.add(frame.depth, None, way.T_world_camera[frame.index])
    table.finish("test", None)
    table.close()
    upper, lower = ({tuple(brick) for brick in each.located()[0]} for each in table.tables)
    # Each thread would hold nearly all of them if threads took frames in turn.
    assert len(upper & lower) < 0.4 * len(upper | lower)
