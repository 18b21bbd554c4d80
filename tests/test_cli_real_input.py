"""`maomaps-warp score` on real recordings, in every form that it takes."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import bags
import numpy as np
import pytest
from bags import BAG_KINDS, bag_path, storage_file
from command import assert_counts_add_up, score
from shared_data import shared_data, shared_reference

from maomaps_warp.io.rgbd_folders import read_rgbd_folder
from maomaps_warp.model.frame import Frame
from maomaps_warp.model.trajectory import Trajectory

#: Metres: sums of float64 in another order.
SUM_TOLERANCE_M = 1e-12
#: Metres: correspondences are written with 9 digits.
TEXT_TOLERANCE_M = 1e-7
#: Metres: coordinates of a few metres pass through float32 in PointCloud2.
FLOAT32_TOLERANCE_M = 1e-6
#: Metres and radians: agreement with evo that the project promises.
EVO_TOLERANCE = 1e-6
#: Metres: a run against itself. RPE multiplies rotations whose rows are unit only to 2e-16.
RPE_ROUNDING_M = 1e-15
#: Metres: a rigid transform is found and undone; coordinates of 10 m have an epsilon of 2e-15.
ALIGNMENT_TOLERANCE_M = 1e-9

GOLDEN = Path(__file__).parent / "golden"


@dataclass(frozen=True)
class Recording:
    """Frames, camera and poses of a real recording."""

    frames: list[Frame]
    camera: Any
    gt: Trajectory


@pytest.fixture(scope="module")
def tum() -> Path:
    return shared_data("rgbd_tum_fr1_rpy_a")


@pytest.fixture(scope="module")
def reference() -> Path:
    return shared_reference("tum_fr1_rpy_a")


def recording(tum: Path, every: int) -> Recording:
    """Every n-th frame, and the motion capture's poses from a second before to a second after."""
    folder = read_rgbd_folder(tum, layout="tum-rgbd", camera=None)
    frames = list(islice(folder.frames.read(True), 0, None, every))
    gt = folder.trajectory
    assert gt is not None and gt.stamps_ns is not None
    near = (gt.stamps_ns >= frames[0].stamp_ns - 10**9) & (gt.stamps_ns <= frames[-1].stamp_ns + 10**9)
    return Recording(frames, folder.frames.camera, gt.select(np.flatnonzero(near)))


@pytest.fixture(scope="module")
def real_bags(tum: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every 30th frame of the recording in every kind of bag, and the file inside each folder."""
    folder = tmp_path_factory.mktemp("bags")
    run = recording(tum, 30)
    paths: dict[str, Path] = {}
    for kind in BAG_KINDS:
        path = bags.write_rgbd_bag(bag_path(folder, kind), kind, run.frames, run.gt, run.camera)
        paths[kind] = path
        if path.is_dir():
            paths[f"{kind}-file"] = storage_file(path)
    return paths


def assert_zero(metrics: dict[str, Any]) -> None:
    """A run against itself."""
    assert metrics["ate"]["max"] == metrics["ate"]["rotation_rad"]["max"] == 0
    assert metrics["rpe"]["max"] <= RPE_ROUNDING_M
    assert metrics["ame_nn"]["max"] == metrics["ame_nn"]["completeness"]["max"] == 0
    assert set(metrics["ame_nn"]["f_score"].values()) == {1.0}
    assert metrics["ame_nn"]["voxel_iou"] == 1
    assert metrics["ame_ray"]["max"] == metrics["ame_ray"]["relative"]["max"] == 0
    assert metrics["ame_ray"]["counts"]["no_ground_truth"] == 0


def test_every_kind_of_bag_of_a_real_recording_gives_the_same_metrics(
    real_bags: dict[str, Path], tum: Path, tmp_path: Path
) -> None:
    found = {}
    for kind, path in real_bags.items():
        outcome = score(
            tmp_path, "--gt", path, "--est", path, "--est-trajectory", tum / "estimated_dvo.txt", "--align", "origin"
        )
        assert_counts_add_up(outcome.metrics)
        assert outcome.document is not None
        assert outcome.document["inputs"]["gt"]["facts"]["frames"] == 4
        found[kind] = outcome.metrics
    assert all(metrics == found["ros1"] for metrics in found.values())
    # The odometry's own error over these 3 s, as evo measures it for the same alignment: centimetres.
    assert 0.01 < found["ros1"]["ate"]["rmse"] < 0.1


@pytest.mark.slow
def test_a_recording_scored_against_itself_gives_zero_and_other_protocols_say_what_they_are(
    real_bags: dict[str, Path], tmp_path: Path
) -> None:
    both = ("--gt", real_bags["ros1"], "--est", real_bags["mcap-ros1"])
    plain = score(tmp_path, *both)
    assert_counts_add_up(plain.metrics)
    assert_zero(plain.metrics)
    for name in ("paper", "slam_comparison"):
        other = score(tmp_path, *both, "--protocol", name)
        assert other.document is not None and other.document["protocol"]["name"] == name
        assert other.metrics["ame_nn"]["max"] == 0
        # With the element itself as m*, a perfect map does not score 0: the reason for the default.
        assert other.metrics["ame_ray"]["value"] > 0.05


def test_the_camera_of_a_bag_decides_what_is_in_view_and_is_named(real_bags: dict[str, Path], tmp_path: Path) -> None:
    outcome = score(tmp_path, "--gt", real_bags["ros1"], "--est", real_bags["ros1"])
    assert outcome.document is not None
    assert outcome.document["camera"].startswith("640x480 fx=525 fy=525 cx=319.5 cy=239.5")
    assert str(real_bags["ros1"]) in outcome.document["camera"]


@pytest.mark.parametrize("name", ["rgbd_nvblox_3dmatch", "rgbd_open3d_sample"])
def test_a_real_folder_of_frames_scored_against_itself_gives_zero(name: str, tmp_path: Path) -> None:
    path = shared_data(name)
    outcome = score(tmp_path, "--gt", path, "--est", path)
    assert_counts_add_up(outcome.metrics)
    assert_zero(outcome.metrics)
    assert outcome.metrics["ate"]["counts"]["matched"] == 5


@pytest.mark.slow
def test_the_whole_real_folder_a_ros1_bag_and_an_mcap_of_it_give_the_same_metrics(tum: Path, tmp_path: Path) -> None:
    run = recording(tum, 1)
    estimate = ("--est-trajectory", tum / "estimated_dvo.txt", "--align", "origin")
    gt_file = ("--gt-trajectory", tum / "groundtruth.txt")
    paths = [
        bags.write_rgbd_bag(bag_path(tmp_path, kind), kind, run.frames, run.gt, run.camera)
        for kind in ("ros1", "ros2-mcap")
    ]
    outcomes = [score(tmp_path, "--gt", path, *gt_file, "--est", path, *estimate) for path in (tum, *paths)]
    assert_counts_add_up(outcomes[0].metrics)
    assert outcomes[0].metrics == outcomes[1].metrics == outcomes[2].metrics
    assert outcomes[0].metrics["ate"]["counts"]["matched"] == 100
    for outcome in outcomes:
        assert outcome.document is not None
        assert outcome.document["inputs"]["gt"]["facts"]["frames_without_pose"] == 0


def without_repeated_stamps(path: Path, folder: Path) -> Path:
    """A copy of a trajectory, as the golden values were made from; files without stamps stay as they are."""
    lines = path.read_text().splitlines(keepends=True)
    if path.name.startswith("KITTI"):
        return path
    first = {line.replace(",", " ").split()[0]: line for line in reversed(lines)}
    copy = folder / path.name
    copy.write_text("".join(reversed(first.values())))
    return copy


@pytest.mark.parametrize("golden", sorted(GOLDEN.glob("evo_*.json")), ids=lambda path: path.stem)
def test_errors_of_real_trajectories_are_those_of_evo(golden: Path, tmp_path: Path) -> None:
    expected = json.loads(golden.read_text())
    shared_data(expected["gt"].partition("/")[0])
    paths = [without_repeated_stamps(shared_data(expected[side]), tmp_path) for side in ("gt", "est")]
    compared = 0
    for align in ("none", "se3", "sim3"):
        of_align = [r for r in expected["results"] if r["align"] == align]
        metrics = score(tmp_path, "--gt", paths[0], "--est", paths[1], "--align", align, "--match", "nearest").metrics
        for result in of_align:
            is_consecutive = (result.get("delta"), result.get("unit")) == (1, "frames")
            if result["metric"] == "rpe" and (not is_consecutive or result["all_pairs"]):
                continue
            if result["errors"] != "translation":
                continue
            found = metrics["ate" if result["metric"] == "ape" else "rpe"]
            assert {name: found[name] for name in result["stats"] if name != "sse"} == pytest.approx(
                {name: value for name, value in result["stats"].items() if name != "sse"}, abs=EVO_TOLERANCE
            )
            assert found["count"] == result["pairs"]
            compared += 1
    assert compared >= 3


def test_repeated_stamps_of_a_real_run_are_kept_noted_and_scored_as_evo_scores_them(tmp_path: Path) -> None:
    folder = shared_data("traj_evo")
    both = ("--gt", folder / "V102_groundtruth.csv", "--est", folder / "V102.txt", "--match", "nearest")
    outcome = score(tmp_path, *both)
    # evo 1.38 prints: compared 798 absolute pose pairs, rmse 2.554174 (six decimals).
    assert outcome.metrics["ate"]["count"] == 798
    assert outcome.metrics["ate"]["rmse"] == pytest.approx(2.554174, abs=EVO_TOLERANCE)
    assert "4 of 807 poses have the stamp of the pose before" in outcome.stdout


def test_kitti_poses_pair_by_index_without_times_and_by_stamp_with_them(tmp_path: Path) -> None:
    folder = shared_data("traj_evo")
    gt, est = folder / "KITTI_00_gt.txt", folder / "KITTI_00_SPTAM.txt"
    by_index = score(tmp_path, "--gt", gt, "--est", est)
    for name, poses in (("gt", gt), ("est", est)):
        shutil.copyfile(poses, tmp_path / f"{name}.txt")
        shutil.copyfile(folder / "KITTI_00_gt_times.txt", tmp_path / f"{name}_times.txt")
    by_stamp = score(tmp_path, "--gt", tmp_path / "gt.txt", "--est", tmp_path / "est.txt")
    assert by_stamp.metrics["ate"] == by_index.metrics["ate"]
    assert (
        "translation_m" in by_stamp.metrics["rpe"]["steps"]["seconds"]
        and by_index.metrics["rpe"]["steps"]["seconds"]["value"] is None
    )


def test_topics_of_a_real_bag_are_chosen_by_name(tmp_path: Path) -> None:
    bag = shared_data("bags_evo") / "ROS_example.bag"
    both = ("--gt", bag, "--est", bag)
    refused = score(tmp_path, *both)
    assert refused.exit_code == 2
    assert all(name in refused.stderr for name in ("groundtruth", "S-PTAM", "ORB-SLAM", "--gt-topic"))
    metrics = score(tmp_path, *both, "--gt-topic", "groundtruth", "--est-topic", "S-PTAM", "--align", "se3").metrics
    assert (metrics["ate"]["counts"]["poses"], metrics["ate"]["counts"]["matched"]) == (5439, 5041)
    # The figure of evo's own documentation is of this order for a drive of 3.7 km.
    assert 1 < metrics["ate"]["rmse"] < 10


def test_an_offset_of_the_stamps_is_undone_by_its_option_and_proposed_without_it(tum: Path, tmp_path: Path) -> None:
    gt, est = tum / "groundtruth.txt", tum / "estimated_dvo.txt"
    late = tmp_path / "late.txt"
    lines = [line.split(" ", 1) for line in est.read_text().splitlines() if not line.startswith("#")]
    late.write_text("".join(f"{float(stamp) + 64:.6f} {rest}\n" for stamp, rest in lines))
    refused = score(tmp_path, "--gt", gt, "--est", late)
    assert refused.exit_code == 3 and "--t-offset -6" in refused.stderr
    shifted = score(tmp_path, "--gt", gt, "--est", late, "--t-offset", "-64").metrics
    plain = score(tmp_path, "--gt", gt, "--est", est).metrics
    assert shifted["ate"]["counts"] == plain["ate"]["counts"]
    # Stamps were printed with microseconds, the camera moves at less than 1 m/s.
    assert shifted["ate"]["rmse"] == pytest.approx(plain["ate"]["rmse"], abs=1e-6)


def test_trajectories_alone_are_scored_without_loading_warp() -> None:
    folder = shared_data("traj_evo")
    code = (
        "import sys; from typer.testing import CliRunner; from maomaps_warp.cli.app import app;"
        "r = CliRunner().invoke(app, sys.argv[1:]); assert r.exit_code == 0, r.output; assert 'warp' not in sys.modules"
    )
    paths = [folder / name for name in ("fr2_desk_groundtruth.txt", "fr2_desk_ORB_kf_mono.txt")]
    arguments = ["score", "--gt", str(paths[0]), "--est", str(paths[1]), "--align", "sim3"]
    subprocess.run([sys.executable, "-c", code, *arguments], check=True)
