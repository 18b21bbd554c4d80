"""Maps of a real recording with full 6-DoF poses at another rate, against the NumPy twin, and as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command import score
from oracle_gt_map import samples
from scipy.spatial.transform import Rotation, Slerp
from tum_sample import RUNS, SMALL, read_tum, write_run

from maomaps_warp.io.sample_writing import write_run as write_map
from maomaps_warp.io.sources import SourceOptions
from maomaps_warp.jobs.ground_truth import GroundTruth, build_ground_truth, open_recording
from maomaps_warp.map_protocol import MAP_PRESETS
from maomaps_warp.protocol_files import with_overrides

#: Metres: float32 may put a sample that lies nearer to a voxel's face into either voxel.
FACE_BAND = 2e-5
#: Metres: a relative pose times its own inverse is the identity but for float64.
RPE_ROUNDING = 1e-15
VOXEL = 0.05


@pytest.fixture(scope="module")
def frames():
    return read_tum()


@pytest.fixture(scope="module")
def bag(frames, tmp_path_factory) -> Path:
    return write_run(tmp_path_factory.mktemp("tum") / "first.bag", "ros1", frames, "first")


@pytest.fixture(scope="module")
def points(frames) -> np.ndarray:
    """World points of every sample of the run: lerp and slerp of the motion capture at the images' stamps."""
    chosen = slice(*RUNS["first"])
    start = frames.pose_stamps_ns[0]
    t, at = (frames.pose_stamps_ns - start) * 1e-9, (frames.stamps_ns[chosen] - start) * 1e-9
    T = np.tile(np.eye(4), (len(at), 1, 1))
    T[:, :3, :3] = Slerp(t, Rotation.from_matrix(frames.T_world_camera[:, :3, :3]))(at).as_matrix()
    T[:, :3, 3] = np.stack([np.interp(at, t, frames.T_world_camera[:, i, 3]) for i in range(3)], axis=1)
    K = (SMALL.fx, SMALL.fy, SMALL.cx, SMALL.cy)
    return np.concatenate([samples(image, K, pose) for image, pose in zip(frames.depth[chosen], T, strict=True)])


def make(bag: Path, **changes) -> GroundTruth:
    protocol = with_overrides(MAP_PRESETS["maomaps"], changes, "test")
    return build_ground_truth(open_recording(bag, protocol, SourceOptions(pose_frame="optical")), protocol)


def cells(truth: GroundTruth) -> set:
    return set(map(tuple, (truth.voxels.ijk + truth.voxels.grid.origin_ijk).tolist()))


def rounded(points: np.ndarray) -> set:
    return set(map(tuple, np.rint(points / VOXEL).astype(int).tolist()))


def test_in_double_precision_the_voxels_are_those_of_the_twin(bag, points):
    truth = make(bag, arithmetic="float64")
    assert cells(truth) == rounded(points)
    assert truth.counts["pixels_used"] == truth.voxels.counts.sum() == len(points)


def test_in_single_precision_they_differ_at_most_at_faces(bag, points):
    got = cells(make(bag))
    from_face = np.abs(points / VOXEL - np.floor(points / VOXEL) - 0.5).min(axis=1) * VOXEL
    certain = rounded(points[from_face > FACE_BAND])
    near = points[from_face <= FACE_BAND]
    shifts = FACE_BAND * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    possible = certain.union(*(rounded(near + shift) for shift in shifts))
    assert certain <= got <= possible
    assert len(near) < 0.01 * len(points) and len(certain) > 40_000


def test_a_stride_takes_every_second_pixel(bag):
    whole, coarse = make(bag), make(bag, pixel_stride=2)
    assert coarse.counts["pixels"] == whole.counts["pixels"] // 4
    assert cells(coarse) < cells(whole)


def test_readers_as_simple_as_the_originals_read_what_was_written(bag, tmp_path):
    truth = make(bag, ceiling="layer")
    write_map(tmp_path, "first", truth.voxels, truth.trajectory)
    points, colors = (np.loadtxt(tmp_path / f"gt_{name}_first.txt") for name in ("points", "colors"))
    assert points.shape == colors.shape == (truth.counts["voxels"], 3)
    assert rounded(points) == cells(truth)
    np.testing.assert_array_equal(colors, truth.voxels.colors)
    poses, stamps = np.loadtxt(tmp_path / "gt_poses_first.txt"), np.loadtxt(tmp_path / "gt_poses_first_timestamps.txt")
    assert (poses.shape, stamps.shape) == ((len(truth.trajectory), 6), (len(truth.trajectory),))
    start = (tmp_path / "start_pose_first.txt").read_text().split("\n")
    assert [len(line.split()) for line in start] == [3, 1, 0]
    assert np.loadtxt([start[0]]).tolist() == poses[0, :3].tolist()
    header, _, body = (tmp_path / "gt_points_first.pcd").read_bytes().partition(b"\nDATA binary\n")
    fields = dict(line.split(" ", 1) for line in header.decode().splitlines() if line[:1] != "#")
    assert (fields["FIELDS"], fields["POINTS"]) == ("x y z rgb", str(len(points)))
    pcd = np.frombuffer(body, "<f4").reshape(-1, 4)[:, :3]
    np.testing.assert_array_equal(pcd, points.astype(np.float32))


def test_a_written_run_scored_against_itself_is_exactly_zero(bag, tmp_path):
    truth = make(bag)
    write_map(tmp_path / "sample", "first", truth.voxels, truth.trajectory)
    place = tmp_path / "sample"
    metrics = score(tmp_path, "--gt", place, "--est", place, "--run", "first").metrics
    for name in ("ate", "ame_nn", "ame_ray"):
        assert metrics[name]["max"] == 0.0
    assert metrics["rpe"]["max"] < RPE_ROUNDING
    assert metrics["ame_nn"]["voxel_iou"] == 1.0
