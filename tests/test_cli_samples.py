"""`maomaps-warp score` on MAOMaps sample directories, and on estimates that come as bags."""

from __future__ import annotations

from pathlib import Path

import bags
import cloud_files
import numpy as np
import pytest
from command import assert_counts_add_up, score
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from shared_data import shared_reference

#: Metres: coordinates of a few metres pass through float32 in PointCloud2.
FLOAT32_TOLERANCE_M = 1e-6
#: Metres: a rigid transform is found and undone; coordinates of 10 m have an epsilon of 2e-15.
ALIGNMENT_TOLERANCE_M = 1e-9


@pytest.fixture(scope="module")
def reference() -> Path:
    return shared_reference("tum_fr1_rpy_a")


@pytest.fixture(scope="module")
def sample(reference: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory in the layout of the data set, of real maps and poses; the estimate lies in `est`.

    The estimate is that of the reference, moved to where a robot at start has its origin: the inverse of the rule of
    MAOMaps with a yaw correction of -0.45.
    """
    folder = tmp_path_factory.mktemp("sample_01")
    gt_points, est_points, gt_poses, est_poses = (
        np.loadtxt(reference / f"{name}.txt") for name in ("gt_points", "slam_points", "gt_poses", "slam_poses")
    )
    gt_points = gt_points[::4]
    stamps = 1_305_031_229 + 0.1 * np.arange(len(gt_poses))
    start, yaw = gt_poses[0, :3], gt_poses[0, 5]
    colors = np.random.default_rng(0).integers(0, 256, gt_points.shape)
    for run in ("first", "second", "merged"):
        np.savetxt(folder / f"gt_points_{run}.txt", gt_points, fmt="%.6g")
        np.savetxt(folder / f"gt_colors_{run}.txt", colors, fmt="%d")
        content = cloud_files.pcd("x y z", "4 4 4", "F F F", gt_points.astype("<f4").tobytes(), points=len(gt_points))
        cloud_files.written(folder, content, f"gt_points_{run}.pcd")
    for run in ("first", "second"):
        (folder / f"{run}.bag").write_bytes(b"")
        np.savetxt(folder / f"gt_poses_{run}.txt", gt_poses, fmt="%.12g")
        np.savetxt(folder / f"gt_poses_{run}_timestamps.txt", stamps, fmt="%.9f")
        (folder / f"start_pose_{run}.txt").write_text("{} {} {}\n{}\n".format(*start, yaw))
    R = Rotation.from_euler("z", yaw + np.pi - 0.45)
    orientations = R.inv() * Rotation.from_euler("ZYX", est_poses[:, [5, 4, 3]])
    positions, points = R.inv().apply(est_poses[:, :3] - start), R.inv().apply(est_points[::4] - start)
    est = folder / "est"
    est.mkdir()
    ypr = orientations.as_euler("ZYX")
    np.savetxt(est / "slam_poses.txt", np.hstack([positions, ypr[:, ::-1]]), fmt="%.12g")
    np.savetxt(est / "slam_poses_timestamps.txt", stamps, fmt="%.9f")
    text = "".join(f"{x:.7g} {y:.7g} {z:.7g}\n" for x, y, z in points)
    content = cloud_files.pcd(
        "x y z", "4 4 4", "F F F", text.encode(), "ascii", points=len(points), version=".5", viewpoint=False
    )
    cloud_files.written(est, content, "slam_points.txt")
    stamps_ns = np.rint(stamps * 1e9).astype(np.int64).tolist()
    cloud = bags.cloud_message(
        "ros1",
        stamps_ns[-1],
        [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)],
        points.astype("<f4").tobytes(),
        width=len(points),
        point_step=12,
    )
    optical = (orientations * Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])).as_quat()
    poses = [bags.pose_stamped("ros1", s, p, q) for s, p, q in zip(stamps_ns, positions, optical, strict=True)]
    path = ("/path", stamps_ns[-1], bags.path_message("ros1", stamps_ns[-1], poses))
    odometry = [
        ("/odom", s, bags.odometry("ros1", s, p, q))
        for s, p, q in zip(stamps_ns, positions, orientations.as_quat(), strict=True)
    ]
    bags.write_bag(est / "path.bag", "ros1", [path, ("/cloud_map", stamps_ns[-1], cloud)])
    bags.write_bag(est / "odometry.bag", "ros1", [*odometry, ("/cloud_map", stamps_ns[-1], cloud)])
    return folder


START_POSE = ("--align", "start-pose", "--yaw-correction", "-0.45")


def test_a_sample_directory_needs_a_run_and_its_start_pose_brings_the_estimate_home(
    sample: Path, reference: Path, tmp_path: Path
) -> None:
    est = ("--est-map", sample / "est/slam_points.txt", "--est-trajectory", sample / "est/slam_poses.txt")
    refused = score(tmp_path, "--gt", sample, *est)
    assert refused.exit_code == 2 and "--run first or --run second" in refused.stderr
    found = [score(tmp_path, "--gt", sample, "--run", run, *est, *START_POSE).metrics for run in ("first", "second")]
    assert found[0] == found[1]
    assert_counts_add_up(found[0])
    gt_poses, est_poses = (np.loadtxt(reference / f"{side}_poses.txt")[:, :3] for side in ("gt", "slam"))
    expected = np.sqrt(np.mean(((gt_poses - est_poses) ** 2).sum(axis=1)))
    assert found[0]["ate"]["rmse"] == pytest.approx(expected, abs=ALIGNMENT_TOLERANCE_M)
    gt, points = (np.loadtxt(reference / f"{side}_points.txt")[::4] for side in ("gt", "slam"))
    distances = cKDTree(gt).query(points)[0]
    assert found[0]["ame_nn"]["mean"] == pytest.approx(distances.mean(), abs=FLOAT32_TOLERANCE_M)


def test_a_start_pose_aligns_maps_that_come_without_any_trajectory(sample: Path, tmp_path: Path) -> None:
    gt = ("--gt", sample, "--run", "first")
    alone = score(tmp_path, *gt, "--est-map", sample / "est/slam_points.txt", *START_POSE).metrics
    poses = ("--est-trajectory", sample / "est/slam_poses.txt")
    whole = score(tmp_path, *gt, "--est-map", sample / "est/slam_points.txt", *poses, *START_POSE).metrics
    assert alone["ame_nn"] == whole["ame_nn"]
    assert alone["ate"]["value"] is None


@pytest.mark.parametrize("name", ["path.bag", "odometry.bag"])
def test_an_estimate_in_a_bag_scores_as_its_files_do(name: str, sample: Path, tmp_path: Path) -> None:
    gt = ("--gt", sample, "--run", "second", *START_POSE)
    in_bag = score(tmp_path, *gt, "--est", sample / "est" / name).metrics
    est = ("--est-map", sample / "est/slam_points.txt", "--est-trajectory", sample / "est/slam_poses.txt")
    in_files = score(tmp_path, *gt, *est).metrics
    # The points lie in the middle of their voxels, far from where float32 could move them into another one.
    assert in_bag["ame_ray"]["counts"] == in_files["ame_ray"]["counts"]
    for metric in ("ate", "rpe", "ame_nn", "ame_ray"):
        assert in_bag[metric]["mean"] == pytest.approx(in_files[metric]["mean"], abs=FLOAT32_TOLERANCE_M)
