"""`maomaps-warp score` on real maps: forms, statistics, files, cameras, alignment, determinism."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cloud_files
import numpy as np
import pytest
from command import CLASSES, assert_counts_add_up, score
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from shared_data import shared_reference

#: Metres: sums of float64 in another order.
SUM_TOLERANCE_M = 1e-12
#: Metres: correspondences are written with 9 digits.
TEXT_TOLERANCE_M = 1e-7
#: Metres: a rigid transform is found and undone; coordinates of 10 m have an epsilon of 2e-15.
ALIGNMENT_TOLERANCE_M = 1e-9


@pytest.fixture(scope="module")
def reference() -> Path:
    return shared_reference("tum_fr1_rpy_a")


@pytest.fixture(scope="module")
def small(reference: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The real directory of the original program with every 4th point and every 5th pose."""
    folder = tmp_path_factory.mktemp("small")
    for name, step in (("gt_points", 4), ("slam_points", 4), ("gt_poses", 5), ("slam_poses", 5)):
        lines = (reference / f"{name}.txt").read_text().splitlines(keepends=True)
        (folder / f"{name}.txt").write_text("".join(lines[::step]))
    return folder


def test_nearest_neighbour_figures_are_those_of_a_kd_tree(reference: Path, tmp_path: Path) -> None:
    gt, est = (np.loadtxt(reference / f"{side}_points.txt") for side in ("gt", "slam"))
    metrics = score(
        tmp_path, "--gt-map", reference / "gt_points.txt", "--est-map", reference / "slam_points.txt"
    ).metrics
    nearest = metrics["ame_nn"]
    for distances, found in (
        (cKDTree(gt).query(est)[0], nearest),
        (cKDTree(est).query(gt)[0], nearest["completeness"]),
    ):
        expected = {
            "rmse": np.sqrt(np.mean(distances**2)),
            "mean": distances.mean(),
            "median": np.median(distances),
            "p90": np.percentile(distances, 90),
            "p95": np.percentile(distances, 95),
            "max": distances.max(),
        }
        assert {name: found[name] for name in expected} == pytest.approx(expected, abs=SUM_TOLERANCE_M)
    # The points lie on multiples of 0.05 m: shares are counted in whole voxels, where "below" is exact.
    gt_ijk, est_ijk = (np.rint(points / 0.05) for points in (gt, est))
    to_gt, to_est = (np.rint(cKDTree(a).query(b)[0] ** 2) for a, b in ((gt_ijk, est_ijk), (est_ijk, gt_ijk)))
    for voxels, name in ((1, "0.05"), (2, "0.1"), (4, "0.2")):
        precision, recall = (to_gt < voxels**2).mean(), (to_est < voxels**2).mean()
        assert nearest["precision"][name] == precision
        assert nearest["recall"][name] == recall
        assert nearest["f_score"][name] == pytest.approx(2 * precision * recall / (precision + recall))
    a, b = ({tuple(row) for row in ijk.astype(int).tolist()} for ijk in (gt_ijk, est_ijk))
    assert nearest["voxel_iou"] == pytest.approx(len(a & b) / len(a | b))
    assert (
        metrics["ate"]
        == metrics["rpe"]
        == metrics["ame_ray"]
        == {
            "value": None,
            "reason": "the ground truth has no trajectory",
        }
    )


def test_the_original_directory_options_and_parts_are_three_ways_to_say_the_same(small: Path, tmp_path: Path) -> None:
    parts = (
        *("--gt-map", small / "gt_points.txt", "--gt-trajectory", small / "gt_poses.txt"),
        *("--est-map", small / "slam_points.txt", "--est-trajectory", small / "slam_poses.txt"),
    )
    outcomes = [score(tmp_path, *form) for form in ((small,), ("--gt", small, "--est", small), parts)]
    assert_counts_add_up(outcomes[0].metrics)
    assert outcomes[0].metrics == outcomes[1].metrics == outcomes[2].metrics


@pytest.mark.parametrize("choice", ["nearest", "first", "last", "all"])
def test_written_correspondences_give_the_printed_statistics(choice: str, small: Path, tmp_path: Path) -> None:
    metrics = {}
    for name in ("pairs.txt", "pairs.npz"):
        metrics[name] = score(
            tmp_path,
            *(small, "--pose-choice", choice),
            *("--correspondences", tmp_path / name),
        ).metrics
    assert metrics["pairs.txt"] == metrics["pairs.npz"]
    ray = metrics["pairs.txt"]["ame_ray"]
    assert_counts_add_up(metrics["pairs.txt"])
    rows = np.loadtxt(tmp_path / "pairs.txt")
    assert rows.shape == (ray["counts"]["correspondences"], 6)
    errors = np.linalg.norm(rows[:, :3] - rows[:, 3:], axis=1)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(ray["rmse"], abs=TEXT_TOLERANCE_M)
    assert errors.mean() == pytest.approx(ray["mean"], abs=TEXT_TOLERANCE_M)
    assert np.median(errors) == pytest.approx(ray["median"], abs=TEXT_TOLERANCE_M)
    with np.load(tmp_path / "pairs.npz") as full:
        np.testing.assert_allclose(
            np.hstack([full["gt_points"], full["est_points"]]), rows, rtol=0, atol=TEXT_TOLERANCE_M
        )
        in_camera = []
        for side in ("est", "gt"):
            T = np.linalg.inv(full[f"T_world_camera_{side}"])[full["pose"]]
            in_camera.append(np.einsum("nij,nj->ni", T[:, :3, :3], full[f"{side}_points"]) + T[:, :3, 3])
        relative = np.linalg.norm(in_camera[0] - in_camera[1], axis=1)
        assert np.sqrt(np.mean(relative**2)) == pytest.approx(ray["relative"]["rmse"], abs=TEXT_TOLERANCE_M)
        counted = np.bincount(full["classes"], minlength=len(full["class_names"]))
        assert {str(n): int(c) for n, c in zip(full["class_names"], counted, strict=True)} == {
            name: ray["counts"][name] for name in CLASSES
        }
        assert len(np.unique(full["element"])) == ray["counts"]["associated"]


def test_one_map_in_every_format_gives_the_same_metrics(tmp_path: Path) -> None:
    # Multiples of 1/16 m: exact in float32 and in text of few digits.
    points = np.unique(np.random.default_rng(0).integers(-40, 40, (500, 3)), axis=0) / 16.0
    floats = points.astype("<f4")
    text = "".join(f"{x} {y} {z}\n" for x, y, z in points)
    size = len(points)
    fields = ("x y z", "4 4 4", "F F F")
    vertex = ("float x", "float y", "float z")
    files = {
        "ascii.pcd": cloud_files.pcd(*fields, text.encode(), "ascii", points=size),
        "binary.pcd": cloud_files.pcd(*fields, floats.tobytes(), points=size),
        "compressed.pcd": cloud_files.pcd(
            *fields,
            cloud_files.compressed([floats[:, i].tobytes() for i in range(3)], cloud_files.lzf_greedy),
            "binary_compressed",
            points=size,
        ),
        "original.pcd": cloud_files.pcd(*fields, text.encode(), "ascii", points=size, version=".5", viewpoint=False),
        "ascii.ply": cloud_files.ply("ascii", vertex, text.encode(), size),
        "binary.ply": cloud_files.ply("binary_little_endian", vertex, floats.tobytes(), size),
        "text.xyz": text.encode(),
    }
    np.savez(tmp_path / "map.npz", points=points)
    paths = [cloud_files.written(tmp_path, content, name) for name, content in files.items()]
    np.savetxt(tmp_path / "gt.xyz", points + [0.25, 0, 0])
    found = [
        score(tmp_path, "--gt", tmp_path / "gt.xyz", "--est", path).metrics for path in (*paths, tmp_path / "map.npz")
    ]
    assert all(metrics == found[0] for metrics in found)
    assert 0 < found[0]["ame_nn"]["max"] <= 0.25


def test_a_camera_in_every_spelling_sees_the_same(small: Path, tmp_path: Path) -> None:
    (tmp_path / "camera.yaml").write_text(
        "image_width: 320\nimage_height: 240\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [160.0, 0.0, 159.5, 0.0, 160.0, 119.5, 0.0, 0.0, 1.0]\n"
    )
    plain = score(tmp_path, small).metrics
    for spelling in ("320x240@90", "320x240:160,160,159.5,119.5", tmp_path / "camera.yaml"):
        assert score(tmp_path, small, "--camera", spelling).metrics == plain
    narrow = score(tmp_path, small, "--camera", "320x240@20").metrics
    assert narrow["ame_ray"]["counts"]["out_of_view"] > plain["ame_ray"]["counts"]["out_of_view"]


@pytest.mark.parametrize("align", ["origin", "yaw", "se3", "sim3"])
def test_a_moved_copy_of_a_real_run_is_brought_back_trajectory_and_map_alike(
    align: str, reference: Path, tmp_path: Path
) -> None:
    axis = "z" if align == "yaw" else "zyx"
    R = Rotation.from_euler(axis, 0.7 if align == "yaw" else [0.7, -0.3, 0.2])
    scale = 2.5 if align == "sim3" else 1.0
    points, poses = np.loadtxt(reference / "gt_points.txt")[::10], np.loadtxt(reference / "gt_poses.txt")
    ypr = (R * Rotation.from_euler("ZYX", poses[:, [5, 4, 3]])).as_euler("ZYX")
    np.savetxt(tmp_path / "est_points.txt", scale * R.apply(points) + [3, -4, 5], fmt="%.17g")
    moved = np.hstack([scale * R.apply(poses[:, :3]) + [3, -4, 5], ypr[:, ::-1]])
    np.savetxt(tmp_path / "est_poses.txt", moved, fmt="%.17g")
    np.savetxt(tmp_path / "gt_points.txt", points)
    metrics = score(
        tmp_path,
        *("--gt-map", tmp_path / "gt_points.txt", "--gt-trajectory", reference / "gt_poses.txt"),
        *("--est-map", tmp_path / "est_points.txt", "--est-trajectory", tmp_path / "est_poses.txt"),
        *("--align", align, "--voxel-size", "0.1"),
    ).metrics
    assert metrics["ate"]["max"] < ALIGNMENT_TOLERANCE_M
    assert metrics["ame_nn"]["max"] < ALIGNMENT_TOLERANCE_M


@pytest.mark.slow
def test_two_runs_of_the_command_write_the_same_but_for_the_times(small: Path, tmp_path: Path) -> None:
    documents, pairs = [], []
    for i in range(2):
        subprocess.run(
            [
                *(sys.executable, "-m", "maomaps_warp", "score", small),
                *("--json", tmp_path / f"{i}.json", "--correspondences", tmp_path / f"{i}.txt"),
            ],
            check=True,
            capture_output=True,
        )
        document = json.loads((tmp_path / f"{i}.json").read_text())
        assert document.pop("milliseconds")
        documents.append(document)
        pairs.append((tmp_path / f"{i}.txt").read_bytes())
    assert documents[0] == documents[1]
    assert pairs[0] == pairs[1]
