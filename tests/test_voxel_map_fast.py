"""Bricks on a CPU's threads make the same map, bit for bit, as the plain kernel that adds each pixel to a hash."""

from __future__ import annotations

import weakref

import numpy as np
import pytest
import warp as wp
from depth_recordings import CAMERA, USUAL, assert_same, fast, grid, plain, recording
from scenes import camera_pose

from maomaps_warp.errors import InputError
from maomaps_warp.kernels import voxel_bricks
from maomaps_warp.mapping import brick_map, brick_table
from maomaps_warp.mapping.brick_map import BrickMap
from maomaps_warp.mapping.depth_rows import DepthImages
from maomaps_warp.mapping.voxel_map import DepthLimits, build_voxel_map
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.threads import THREADS_VARIABLE


@pytest.mark.parametrize("mean", ["rounded", "truncated", None])
@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_the_map_is_that_of_the_plain_kernel(mean, offset, device):
    data = recording(7)
    lattice = grid(offset=offset)
    assert_same(fast(data, lattice, mean=mean), plain(data, lattice, mean=mean, device=device))


@pytest.mark.parametrize("width", [1, 15, 16, 17, 50, 80])
@pytest.mark.parametrize("stride", [1, 2, 5])
def test_images_of_any_width_and_stride_are_taken_whole(width, stride):
    camera = Camera(width, 48, 40.0, 42.0, 0.4 * width, 24.5)
    limits = DepthLimits(0.5, 7.0, stride)
    data = recording(9, camera)
    got = fast(data, grid(), limits, camera)
    want = plain(data, grid(), limits, camera)
    np.testing.assert_array_equal(got.ijk, want.ijk)
    np.testing.assert_array_equal(got.counts, want.counts)
    np.testing.assert_array_equal(got.colors, want.colors)


def test_images_that_are_views_are_read_as_what_they_show():
    depths, colors, poses = recording(3)
    flipped = (depths[:, ::-1, ::-1], colors[:, ::-1, ::-1], poses)
    copied = (depths[:, ::-1, ::-1].copy(), colors[:, ::-1, ::-1].copy(), poses)
    assert_same(fast(flipped, grid()), plain(copied, grid()))


@pytest.mark.parametrize("scale", [0.2, 1.7])
@pytest.mark.parametrize("voxel_size", [0.05, 0.0375, 0.3])
def test_scale_and_voxel_size_are_those_of_the_plain_kernel(scale, voxel_size):
    limits = DepthLimits(0.4, 8.0, 1, scale)
    data = recording(4, seed=1)
    assert_same(fast(data, grid(voxel_size), limits), plain(data, grid(voxel_size), limits))


def test_far_from_the_worlds_zero_nothing_changes():
    depths, colors, poses = recording(4, seed=2)
    far = np.array([458074.6, 5429380.15, 162.9])
    for pose in poses:
        pose[:3, 3] += far
    lattice = VoxelGrid.around(far[None], 0.05)
    assert_same(fast((depths, colors, poses), lattice), plain((depths, colors, poses), lattice))


def _samples_in_float32(depths, poses, voxel_size):
    """Cells of all samples by NumPy, in the order of operations that the kernels state."""
    f = np.float32
    u, v = np.arange(CAMERA.width, dtype=f), np.arange(CAMERA.height, dtype=f)
    a, b = (u - f(CAMERA.cx)) / f(CAMERA.fx), ((v - f(CAMERA.cy)) / f(CAMERA.fy))[:, None]
    for z, pose in zip(depths, poses, strict=True):
        with np.errstate(all="ignore"):
            squared = (z * z) * ((f(1) + b * b) + a * a)
            taken = (z > 0) & (squared > f(0.01) * f(0.01)) & (squared < f(10) * f(10))
            T = (pose[:3] / voxel_size).astype(f)
            axes = [T[i, 3] + z * ((T[i, 2] + T[i, 1] * b) + a * T[i, 0]) for i in range(3)]
        yield np.rint(np.stack([x[taken] for x in axes], axis=1)).astype(np.int64)


def test_every_sample_is_where_numpy_puts_it_in_single_precision():
    data = recording(5, seed=3)
    cells, counts = np.unique(
        np.concatenate(list(_samples_in_float32(data[0], data[2], 0.05))), axis=0, return_counts=True
    )
    got = fast(data, grid())
    np.testing.assert_array_equal(got.ijk, cells)
    np.testing.assert_array_equal(got.counts, counts)


@pytest.mark.parametrize("threads", [1, 2, 3, 5])
def test_threads_and_batches_do_not_change_the_map(threads, monkeypatch):
    data = recording(23, seed=4)
    want = plain(data, grid())
    monkeypatch.setenv(THREADS_VARIABLE, str(threads))
    for frames in (1, 2, 7):
        monkeypatch.setattr(brick_map, "BATCH_FRAMES", frames)
        assert_same(fast(data, grid()), want)


def test_a_pool_that_runs_out_in_the_middle_of_a_frame_loses_nothing(monkeypatch):
    monkeypatch.setattr(brick_table, "CHUNK_BRICKS", 1)
    chunks = []
    add_chunk = brick_table.BrickTable._add_chunk
    monkeypatch.setattr(brick_table.BrickTable, "_add_chunk", lambda table: (chunks.append(1), add_chunk(table)))
    data = recording(6, seed=5)
    assert_same(fast(data, grid()), plain(data, grid()))
    assert len(chunks) > 10


@pytest.mark.parametrize("threads", [1, 2])
def test_a_window_follows_a_camera_that_travels_and_comes_back(threads, monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, str(threads))
    monkeypatch.setattr(brick_map, "BATCH_FRAMES", 3)
    monkeypatch.setattr(voxel_bricks, "MAX_DIRECTORY", 1 << 17)
    laid = []
    lay = brick_table.BrickTable._lay_window
    monkeypatch.setattr(brick_table.BrickTable, "_lay_window", lambda *a: (laid.append(1), lay(*a)))
    depths, colors, poses = recording(20, seed=6, step=9.0)
    data = (np.concatenate([depths, depths]), np.concatenate([colors, colors]), poses + poses[::-1])
    assert_same(fast(data, grid()), plain(data, grid()))
    assert len(laid) > 8


@pytest.mark.parametrize("max_range", [5000.0, np.inf])
def test_frames_whose_range_fills_more_than_a_window_take_the_hash(max_range):
    data = recording(3, seed=7)
    data[0][~(data[0] < 100.0)] = 0.0
    limits = DepthLimits(0.01, max_range)
    data[0][0, 10, 10] = 4000.0
    assert_same(fast(data, grid(), limits), plain(data, grid(), limits))


def test_some_frames_in_bricks_and_some_in_the_hash_make_one_map(monkeypatch):
    monkeypatch.setattr(brick_map, "BATCH_FRAMES", 1)
    asked = []
    fits = brick_map.fits
    monkeypatch.setattr(brick_map, "fits", lambda *box: (asked.append(fits(*box)), asked[-1])[1])
    data = recording(16, seed=8)
    for i, pose in enumerate(data[2]):
        pose[:] = camera_pose((0.1 * i, 0, 1), 0.05 * i * np.pi)
    batches = [DepthImages(CAMERA, grid(), USUAL, True).batch([], pose[None]) for pose in data[2]]
    sizes = [np.prod(batch.high - batch.low + 1) for batch in batches]
    monkeypatch.setattr(voxel_bricks, "MAX_DIRECTORY", int(np.median(sizes)) + 1)
    assert_same(fast(data, grid()), plain(data, grid()))
    assert 2 <= sum(asked) <= len(asked) - 2


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("mean", ["rounded", None])
def test_sums_are_moved_to_64_bits_before_they_overflow(threads, mean, monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, str(threads))
    monkeypatch.setattr(brick_map, "BATCH_FRAMES", 2)
    monkeypatch.setattr(brick_table, "SAMPLE_LIMIT", 2 * 48 * 64 + 2)
    emptied = []
    empty = brick_table.BrickTable.empty
    monkeypatch.setattr(brick_table.BrickTable, "empty", lambda table: (emptied.append(1), empty(table)))
    depths = np.full((24, 48, 64), 0.05, np.float32)  # near: hundreds of samples in each cell
    depths[::3] = recording(8, seed=9)[0]
    colors = np.full((24, 48, 64, 3), 255, np.uint8)
    data = (depths, colors, [np.eye(4)] * 24)
    assert_same(fast(data, grid(), mean=mean), plain(data, grid(), mean=mean))
    assert len(emptied) >= 4


def test_what_threads_hold_of_a_cell_is_added_in_64_bits_where_it_must_be(monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, "3")
    monkeypatch.setattr(brick_map, "BATCH_FRAMES", 1)
    monkeypatch.setattr(brick_table, "SAMPLE_LIMIT", 48 * 64 + 1000)
    depths = np.full((3, 48, 64), 0.04, np.float32)
    depths[:, :10] = recording(3, seed=10)[0][:, :10]
    data = (depths, np.full((3, 48, 64, 3), 7, np.uint8), [np.eye(4)] * 3)
    assert_same(fast(data, grid()), plain(data, grid()))


@pytest.mark.parametrize("nearest", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("stride", [1, 2])
def test_no_cell_takes_more_samples_than_the_bound_says(nearest, stride):
    rng = np.random.default_rng(11)
    limits = DepthLimits(0.01, 10.0, stride, 1.3)
    camera = Camera(160, 120, 100.0, 110.0, 80.0, 60.0)
    images = DepthImages(camera, grid(), limits, False)
    slope = np.linspace(0, 1, 160, dtype=np.float32)
    for depth in (np.full((120, 160), nearest), nearest * (1 + slope + np.zeros((120, 1)))):
        pose = camera_pose((0.013, 0.02, 0.01), rng.uniform(0, 6), 0.7)
        table = BrickMap(camera, grid(), limits, with_colors=False)
        table.add(depth.astype(np.float32), None, pose)
        most = table.finish("test", None).counts.max()
        bound = table.tables[0].sample_bound
        assert most <= bound < images.height * images.width or bound == images.height * images.width
    assert nearest < 2.0 or bound < 0.2 * images.height * images.width


def test_only_frames_of_the_batches_at_work_are_kept(monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, "2")
    monkeypatch.setattr(brick_map, "BATCH_FRAMES", 4)
    alive, most = [], 0

    def read(with_colors):
        nonlocal most
        for i in range(80):
            depth = np.full((48, 64), 1.0 + 0.01 * i, np.float32)
            alive.append(weakref.ref(depth))
            yield Frame(i, None, depth)
            del depth
            most = max(most, sum(frame() is not None for frame in alive))

    build_voxel_map(FrameStream(CAMERA, None, read, "endless"), lambda f: np.eye(4), grid(), USUAL, device="cpu")
    assert most <= 4 * (2 + 2)


def test_memory_is_that_of_the_bricks_and_not_of_the_frames():
    def chunks(repeats):
        depths, colors, poses = recording(4, seed=12)
        table = BrickMap(CAMERA, grid(), USUAL, with_colors=True)
        for _ in range(repeats):
            for depth, color, pose in zip(depths, colors, poses, strict=True):
                table.add(depth, color, pose)
        table.finish("test", "rounded")
        return [int(chunk.used[0]) for chunk in table.tables[0].chunks]

    assert chunks(2) == chunks(40)


def test_samples_beyond_the_reach_of_the_keys_are_refused_with_their_number():
    depths, colors, poses = recording(3)
    beyond = (np.ones_like(depths), colors, [poses[0], camera_pose((1e6, 0, 0), 0.0), poses[2]])
    with pytest.raises(InputError, match=f"{48 * 64} points lie beyond the reach"):
        fast(beyond, grid())


@pytest.mark.parametrize("number", [np.nan, np.inf, -1e300])
def test_a_pose_that_is_no_number_is_refused_and_not_written_anywhere(number):
    depths, colors, poses = recording(2)
    poses[1] = np.full((4, 4), number)
    with pytest.raises(InputError, match="beyond the reach"):
        fast((np.ones_like(depths), colors, poses), grid())


def test_an_error_of_the_reader_comes_through_and_ends_the_threads(monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, "2")
    monkeypatch.setattr(brick_map, "BATCH_FRAMES", 1)

    def read(with_colors):
        for i in range(5):
            yield Frame(i, None, np.ones((48, 64), np.float32))
        raise InputError("run.bag", "ends in the middle of frame 5", "record it again")

    with pytest.raises(InputError, match="frame 5"):
        build_voxel_map(FrameStream(CAMERA, None, read, "run.bag"), lambda f: np.eye(4), grid(), USUAL, device="cpu")


def test_no_frames_make_an_empty_map():
    assert len(fast((np.empty((0, 48, 64), np.float32), np.empty((0, 48, 64, 3), np.uint8), []), grid())) == 0
    nothing = (np.zeros((2, 48, 64), np.float32), np.zeros((2, 48, 64, 3), np.uint8), [np.eye(4)] * 2)
    assert len(fast(nothing, grid())) == 0


def test_colours_of_another_size_than_the_depth_are_refused():
    table = BrickMap(CAMERA, grid(), USUAL, with_colors=True)
    with pytest.raises(ValueError, match=r"colors: expected shape \(48, 64, 3\)"):
        table.add(np.ones((48, 64), np.float32), np.zeros((48, 60, 3), np.uint8), np.eye(4))


def _launch(table, batch, **changes):
    launch = table._launch_of(len(batch))
    launch.addresses[:], launch.T_cells_camera[:] = batch.addresses, batch.T_cells_camera
    launch.pending[:] = voxel_bricks.PENDING
    arguments = {"window": table.window, "out_table": table._device_table(), "out_words": table.words}
    voxel_bricks.accumulate_rows(table.band.rows, **(launch.arrays | arguments | changes))
    return launch.pending


def test_rows_that_may_leave_the_window_are_left_out_whole_and_named():
    images = DepthImages(CAMERA, grid(), USUAL, False)
    table = brick_table.BrickTable(images, images.bands(1)[0])
    depth = np.ones((48, 64), np.float32)
    batch = images.batch([images.prepare(depth, None)], np.eye(4)[None])
    table._cover(batch.low, batch.high)
    low, size = table.low.copy(), table.size.copy()
    low[1] += 20  # of what lies above the camera, only a part
    table._lay_window(low, size)
    pending = _launch(table, batch)
    assert set(pending) == {voxel_bricks.DONE, voxel_bricks.OUTSIDE}
    done = np.count_nonzero(pending == voxel_bricks.DONE)
    assert sum(int(chunk.filled.sum()) for chunk in table.chunks) == 64 * done


def test_a_wrong_array_is_named():
    images = DepthImages(CAMERA, grid(), USUAL, False)
    table = brick_table.BrickTable(images, images.bands(1)[0])
    batch = images.batch([images.prepare(np.ones((48, 64), np.float32), None)], np.eye(4)[None])
    table._cover(batch.low, batch.high)
    with pytest.raises(ValueError, match="out_pending: expected shape"):
        _launch(table, batch, out_pending=wp.zeros(3, dtype=wp.int32, device="cpu"))
    with pytest.raises(TypeError, match="out_words: expected dtype"):
        _launch(table, batch, out_words=wp.zeros(4, dtype=wp.int32, device="cpu"))
