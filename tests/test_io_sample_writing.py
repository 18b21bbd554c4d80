"""Sample directories that we write: read back, by our readers and by plain NumPy as the original's readers do."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scenes import camera_pose, cluttered_room

from maomaps_warp.errors import InputError
from maomaps_warp.io.clouds import read_cloud
from maomaps_warp.io.file_sets import write_file_set
from maomaps_warp.io.sample_directories import RUN_NAMES, read_sample, runs_of
from maomaps_warp.io.sample_writing import (
    SamplePlace,
    SampleRun,
    check_run_writable,
    check_sample_writable,
    heading_notes,
    point_lines,
    write_run,
    write_sample,
)
from maomaps_warp.mapping.cloud_map import voxelise
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap
from maomaps_warp.scoring.alignment import align

#: Poses pass through three angles: a few roundings of float64 (metres and entries of rotation matrices).
POSE_TOLERANCE = 1e-12
#: Metres: a rigid transform of coordinates of some metres, undone by angles from a text file.
ALIGNMENT_TOLERANCE_M = 1e-12
NO_POSES = np.zeros((0, 4, 4))


def _map(seed: int = 1, voxel_size: float = 0.05, *, colored: bool = True, shift: int = -30) -> VoxelMap:
    points = (np.rint(cluttered_room(seed) / 0.05) + shift) * voxel_size
    colors = np.random.default_rng(seed).integers(0, 256, points.shape).astype(np.uint8)
    return voxelise(points, VoxelGrid.around(points, voxel_size), colors if colored else None)


def _trajectory(poses: int = 40) -> Trajectory:
    """A camera that turns through all headings, looking up and down, with stamps that float64 seconds cannot hold."""
    T = [camera_pose((0.1 * i, np.sin(i), 0.9), 0.3 * i - 2.0, 0.4 * np.sin(i)) for i in range(poses)]
    stamps = 1_305_031_229_564_400_001 + 33_333_333 * np.arange(poses, dtype=np.int64)
    return Trajectory(np.stack(T), stamps)


def _world_cells(voxels: VoxelMap) -> np.ndarray:
    return voxels.ijk + voxels.grid.origin_ijk


def test_a_written_run_reads_back_as_the_same_voxels_colours_poses_and_stamps(tmp_path: Path) -> None:
    voxels, trajectory = _map(), _trajectory()
    written = write_run(tmp_path / "sample", "first", voxels, trajectory)
    assert {path.name for path in written} == {path.name for path in (tmp_path / "sample").iterdir()}
    assert len(written) == 7
    run = read_sample(tmp_path / "sample", "first")
    assert run.cloud is not None and run.trajectory is not None and run.cloud.colors is not None
    world = VoxelGrid(0.05, np.zeros(3, np.int64))
    np.testing.assert_array_equal(world.ijk_of(run.cloud.points), _world_cells(voxels))
    np.testing.assert_array_equal(run.cloud.colors, voxels.colors)
    np.testing.assert_allclose(run.trajectory.T_world_camera, trajectory.T_world_camera, rtol=0, atol=POSE_TOLERANCE)
    np.testing.assert_array_equal(run.trajectory.stamps_ns, trajectory.stamps_ns)
    assert not run.notes


def test_the_original_readers_find_tables_of_the_same_length(tmp_path: Path) -> None:
    voxels, trajectory = _map(), _trajectory()
    write_run(tmp_path, "second", voxels, trajectory)
    points = np.loadtxt(tmp_path / "gt_points_second.txt")
    colors = np.loadtxt(tmp_path / "gt_colors_second.txt", dtype=int)
    poses = np.loadtxt(tmp_path / "gt_poses_second.txt")
    stamps = np.loadtxt(tmp_path / "gt_poses_second_timestamps.txt")
    assert points.shape == colors.shape == (len(voxels), 3)
    assert poses.shape == (len(trajectory), 6) and stamps.shape == (len(trajectory),)
    np.testing.assert_array_equal(colors, voxels.colors)
    np.testing.assert_array_equal(np.rint(points / 0.05), _world_cells(voxels))
    # roll, pitch and yaw of the body: the yaw is the heading, and looking up is a negative pitch
    np.testing.assert_allclose(np.unwrap(poses[:, 5]), 0.3 * np.arange(40) - 2.0, rtol=0, atol=POSE_TOLERANCE)
    np.testing.assert_allclose(poses[:, 4], -0.4 * np.sin(np.arange(40)), rtol=0, atol=POSE_TOLERANCE)
    start = (tmp_path / "start_pose_second.txt").read_text().split("\n")
    assert [len(line.split()) for line in start] == [3, 1, 0]


def test_the_pcd_holds_the_points_of_the_text_and_the_colours(tmp_path: Path) -> None:
    voxels = _map()
    write_run(tmp_path, "first", voxels, _trajectory())
    cloud = read_cloud(tmp_path / "gt_points_first.pcd")
    np.testing.assert_array_equal(np.rint(cloud.points / 0.05), _world_cells(voxels))
    np.testing.assert_array_equal(cloud.colors, voxels.colors)


@pytest.mark.parametrize("voxel_size", [0.05, 0.1, 0.02, 0.0333, 1 / 3, 0.25, 2.0])
def test_points_in_text_are_the_exact_multiples_of_the_voxel_size(voxel_size: float) -> None:
    from decimal import Decimal

    cells = np.random.default_rng(5).integers(-200_000, 200_000, (500, 3))
    grid = VoxelGrid(voxel_size, np.array([4, -400, 1000]))
    voxels = VoxelMap(grid, (cells - grid.origin_ijk).astype(np.int32), np.ones(500, np.int64))
    rows = [line.split() for line in b"".join(point_lines(voxels)).decode().splitlines()]
    expected = [[index * Decimal(repr(voxel_size)) for index in row] for row in cells.tolist()]
    assert [[Decimal(word) for word in row] for row in rows] == expected
    assert not [word for row in rows for word in row if "E" in word.upper() or word == "-0"]
    np.testing.assert_array_equal(np.rint(np.array(rows, float) / voxel_size), cells)


def test_points_in_text_look_as_people_write_them() -> None:
    cells = np.array([[7, -7, 0], [20, 200, -3]], np.int32)
    voxels = VoxelMap(VoxelGrid(0.05, np.zeros(3, np.int64)), cells, np.ones(2, np.int64))
    assert b"".join(point_lines(voxels)) == b"0.35 -0.35 0\n1 10 -0.15\n"


def test_the_start_pose_brings_a_map_of_the_first_camera_back_where_it_was(tmp_path: Path) -> None:
    for i, yaw in enumerate((0.0, 0.7, np.pi / 2, 3.1, np.pi, -np.pi, -0.2, -3.0)):
        T = np.stack([camera_pose((1.5, -2.0, 0.8), yaw, 0.3), camera_pose((5.0, 1.0, 0.9), -yaw)])
        folder = tmp_path / str(i)
        write_run(folder, "first", _map(), Trajectory(T, np.array([1, 2])))
        source = read_sample(folder, "first")
        assert source.start_pose is not None and -np.pi < source.start_pose[3] <= np.pi
        # A robot that starts here calls its place zero and its heading x.
        c, s = np.cos(yaw), np.sin(yaw)
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        points = _map().points
        at_start = (points - [1.5, -2.0, 0.8]) @ R
        alignment = align("start-pose", NO_POSES, NO_POSES, start_pose=source.start_pose)
        np.testing.assert_allclose(alignment.apply_points(at_start), points, rtol=0, atol=ALIGNMENT_TOLERANCE_M)
        goal = np.array((folder / "goal_pose_first.txt").read_text().split(), float)
        np.testing.assert_allclose(goal[:3], [5.0, 1.0, 0.9], rtol=0, atol=0)
        np.testing.assert_allclose(np.exp(1j * (goal[3] + np.pi)), np.exp(-1j * yaw), rtol=0, atol=POSE_TOLERANCE)


def test_a_camera_that_looks_straight_down_starts_where_it_would_look_when_raised(tmp_path: Path) -> None:
    for name, pitch in (("down", -np.pi / 2), ("up", np.pi / 2)):
        T = np.stack([camera_pose((0, 0, 1), 0.7, pitch), camera_pose((0, 0, 1), 0.7)])
        trajectory = Trajectory(T, np.array([1, 2]))
        write_run(tmp_path / name, "first", _map(), trajectory)
        start = read_sample(tmp_path / name, "first").start_pose
        assert start is not None and start[3] + np.pi == pytest.approx(0.7, abs=POSE_TOLERANCE)
        (note,) = heading_notes(trajectory)
        assert note.startswith("start pose: the camera looks straight up or down")
    assert not heading_notes(_trajectory())


def test_maps_without_colours_and_poses_without_stamps_leave_their_files_out(tmp_path: Path) -> None:
    unstamped = Trajectory(_trajectory().T_world_camera)
    written = write_run(tmp_path, "first", _map(colored=False), unstamped)
    assert [path.name for path in written if "colors" in path.name or "timestamps" in path.name] == []
    assert len(written) == len(list(tmp_path.iterdir())) == 5


def test_an_existing_run_is_only_replaced_when_that_is_said(tmp_path: Path) -> None:
    write_run(tmp_path, "first", _map(1), _trajectory())
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for write in (
        lambda: write_run(tmp_path, "first", _map(2), _trajectory(3)),
        lambda: check_run_writable(tmp_path, "first"),
    ):
        with pytest.raises(InputError, match="already.*--overwrite"):
            write()
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    check_run_writable(tmp_path, "first", overwrite=True)
    write_run(tmp_path, "second", _map(2), _trajectory(3))
    assert runs_of(tmp_path) == ("first", "second")


def test_stamps_and_colours_of_an_older_run_do_not_stay_beside_new_files(tmp_path: Path) -> None:
    write_run(tmp_path, "first", _map(1), _trajectory())
    (tmp_path / "notes.md").write_text("mine")
    unstamped = Trajectory(_trajectory(3).T_world_camera)
    written = write_run(tmp_path, "first", _map(2, colored=False), unstamped, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == {*(path.name for path in written), "notes.md"}
    assert not (tmp_path / "gt_colors_first.txt").exists()
    assert not (tmp_path / "gt_poses_first_timestamps.txt").exists()


def test_a_single_file_of_an_older_run_is_enough_to_be_refused(tmp_path: Path) -> None:
    (tmp_path / "gt_poses_first_timestamps.txt").write_text("1\n")
    with pytest.raises(InputError, match="gt_poses_first_timestamps.txt"):
        write_run(tmp_path, "first", _map(), _trajectory())
    assert [path.name for path in tmp_path.iterdir()] == ["gt_poses_first_timestamps.txt"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["full", "Ctrl-C"])
def test_when_a_file_cannot_take_its_place_all_former_files_come_back(
    tmp_path: Path, monkeypatch, error: BaseException
) -> None:
    write_run(tmp_path, "first", _map(1), _trajectory())
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    rename = Path.rename

    def failing(self: Path, target: Path) -> Path:
        if self.name == "gt_poses_first.txt" and self.parent.name.endswith(".part"):
            raise error
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises((InputError, KeyboardInterrupt), match="No space left on device|^$"):
        write_run(tmp_path, "first", _map(2), _trajectory(3), overwrite=True)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_what_can_come_back_does_though_another_file_cannot(tmp_path: Path, monkeypatch) -> None:
    write_run(tmp_path, "first", _map(1), _trajectory())
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    rename = Path.rename

    def failing(self: Path, target: Path) -> Path:
        if self.name == "gt_poses_first.txt" and self.parent.suffix in (".part", ".former"):
            raise OSError(28, "No space left on device")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(InputError, match=r"No space left on device \(not all that stood there.*\.former"):
        write_run(tmp_path, "first", _map(2), _trajectory(3), overwrite=True)
    (former,) = tmp_path.glob(".*.former")
    assert [path.name for path in former.iterdir()] == ["gt_poses_first.txt"]
    kept = {path.name: path.read_bytes() for path in [*tmp_path.iterdir(), *former.iterdir()] if path.is_file()}
    assert kept == before


def test_new_parents_go_again_and_errors_of_other_files_are_their_own(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="elsewhere"), write_file_set(tmp_path / "a" / "b" / "c", ["x"]):
        (tmp_path / "elsewhere").read_bytes()
    assert not list(tmp_path.iterdir())


def test_a_failure_while_writing_leaves_no_folder_and_names_no_hidden_one(tmp_path: Path, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("maomaps_warp.io.sample_writing.write_maomaps_poses", full)
    with pytest.raises(InputError, match="No space left") as caught:
        write_run(tmp_path / "new", "first", _map(), _trajectory())
    assert ".part" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_places_that_cannot_be_written_are_told_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        check_run_writable(tmp_path / "file" / "sample", "first")
    check_run_writable(tmp_path / "a" / "b", "first")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_told_before_the_work(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(InputError, match="permission denied"):
            check_run_writable(tmp_path, "first")
    finally:
        tmp_path.chmod(0o700)


# Whole samples


def _runs(*names: str) -> dict[str, SampleRun]:
    return {name: SampleRun(_map(i + 1), _trajectory()) for i, name in enumerate(names)}


def test_a_whole_sample_holds_the_recordings_as_copies_or_links(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"one")
    (tmp_path / "b.mcap").write_bytes(b"two")
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "metadata.yaml").write_text("three")
    bags = {"first": tmp_path / "a.bag", "second": tmp_path / "b.mcap", "third": tmp_path / "c"}
    for mode in ("copy", "link", "none"):
        folder = tmp_path / f"sample {mode}"
        write_sample(SamplePlace(folder, bags, mode), _runs(*bags), _map())
        assert runs_of(folder) == ("first", "second", "third")
        names = {path.name for path in folder.iterdir()} & {"first.bag", "second.mcap", "third"}
        assert names == (set() if mode == "none" else {"first.bag", "second.mcap", "third"})
        if mode != "none":
            assert (folder / "second.mcap").read_bytes() == b"two"
            assert (folder / "third" / "metadata.yaml").read_text() == "three"
            assert (folder / "first.bag").is_symlink() == (mode == "link")


def test_recordings_that_lie_in_the_sample_already_stay_as_they_are(tmp_path: Path) -> None:
    bags = {"first": tmp_path / "first.bag", "second": tmp_path / "second.bag"}
    for path in bags.values():
        path.write_bytes(path.name.encode())
    for overwrite in (False, True):
        write_sample(SamplePlace(tmp_path, bags, "copy", overwrite), _runs(*bags), _map())
        assert (tmp_path / "second.bag").read_bytes() == b"second.bag"
    exchanged = {"first": bags["second"], "second": bags["first"]}
    with pytest.raises(InputError, match="is an input"):
        check_sample_writable(SamplePlace(tmp_path, exchanged, "copy", True))


def test_a_third_run_of_an_older_sample_does_not_stay_beside_a_new_merged_map(tmp_path: Path) -> None:
    write_sample(SamplePlace(tmp_path, {}), _runs("first", "second", "third"), _map())
    with pytest.raises(InputError, match="already"):
        write_sample(SamplePlace(tmp_path, {}), _runs("first", "second"), _map())
    write_sample(SamplePlace(tmp_path, {}, overwrite=True), _runs("first", "second"), _map())
    assert runs_of(tmp_path) == ("first", "second")


def test_a_run_that_no_sample_has_is_a_mistake(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="first, second"):
        write_run(tmp_path, "merged", _map(), _trajectory())
    assert len(RUN_NAMES) == 10


def test_a_closed_folder_is_refused_by_the_name_that_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def closed(self: Path, *_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "open", closed)
    with pytest.raises(InputError, match="permission denied") as caught:
        check_run_writable(tmp_path / "sample", "first")
    assert caught.value.where == str(tmp_path / "sample")
