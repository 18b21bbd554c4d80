"""What real recordings, trajectories and bags are recognised as, and whether their poses fit their depth."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from shared_data import shared_data, shared_reference

from maomaps_warp.errors import InputError
from maomaps_warp.io.original_directory import is_original_directory
from maomaps_warp.io.rgbd_folders import read_rgbd_folder, recognise_rgbd_folder
from maomaps_warp.io.sources import Source, SourceOptions, open_original_directory, open_source
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame

AUTO = SourceOptions()
#: With the inverse of the right poses, real recordings disagree by at least so many times more.
WRONG_POSES_FACTOR = 5.0


def reprojection_error(folder: Source, pair: tuple[Frame, Frame], *, inverse: bool = False) -> float:
    """Median |depth of the first frame seen from the second - depth of the second|, metres."""
    assert folder.trajectory is not None
    T = []
    for frame in pair:
        stamps = folder.trajectory.stamps_ns
        known = stamps is not None and frame.stamp_ns is not None
        nearest = int(np.abs(stamps - frame.stamp_ns).argmin()) if known else frame.index
        pose = folder.trajectory.T_world_camera[nearest]
        T.append(np.linalg.inv(pose) if inverse else pose)
    camera = folder.frames.camera
    v, u = np.mgrid[0 : camera.height : 4, 0 : camera.width : 4].reshape(2, -1)
    z = pair[0].depth[v, u].astype(np.float64)
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z, np.ones_like(z)])
    x, y, z_seen, _ = (np.linalg.inv(T[1]) @ T[0] @ points)[:, z > 0]
    front = z_seen > 0.1
    u2 = np.rint(x[front] / z_seen[front] * camera.fx + camera.cx).astype(int)
    v2 = np.rint(y[front] / z_seen[front] * camera.fy + camera.cy).astype(int)
    inside = (u2 >= 0) & (u2 < camera.width) & (v2 >= 0) & (v2 < camera.height)
    measured = pair[1].depth[v2[inside], u2[inside]]
    errors = np.abs(measured - z_seen[front][inside])[measured > 0]
    assert len(errors) > 2000, "too little overlap to tell"
    return float(np.median(errors))


@pytest.mark.parametrize(
    ("name", "frames", "poses", "pair", "tolerance_m"),
    [
        # Tolerances: noise of the sensors and errors of the recordings' own poses, rounded up.
        ("rgbd_tum_fr1_rpy_a", 100, 2742, (20, 29), 0.02),
        ("rgbd_nvblox_3dmatch", 5, 5, (3, 4), 0.08),
        ("rgbd_nvblox_3dmatch/seq-01", 5, 5, (3, 4), 0.08),
        ("rgbd_open3d_sample", 5, 5, (0, 4), 0.01),
        ("rgbd_slambook2_ch5", 5, 5, (3, 4), 0.05),
    ],
)
def test_poses_and_depth_of_a_real_recording_agree(
    name: str, frames: int, poses: int, pair: tuple[int, int], tolerance_m: float
) -> None:
    stated_elsewhere = Camera(640, 480, 518.0, 519.0, 325.5, 253.5) if "slambook" in name else None
    path = shared_data(name)
    layout = recognise_rgbd_folder(path)
    assert layout is not None
    folder = read_rgbd_folder(path, layout=layout, camera=stated_elsewhere)
    assert folder.frames.count == frames
    assert folder.trajectory is not None and len(folder.trajectory) == poses
    read = list(itertools.islice(folder.frames.read(False), pair[1] + 1))
    images = (read[pair[0]], read[pair[1]])
    right = reprojection_error(folder, images)
    assert right < tolerance_m
    assert reprojection_error(folder, images, inverse=True) > WRONG_POSES_FACTOR * right


def test_the_real_original_directory_opens_as_two_sides() -> None:
    path = shared_reference("tum_fr1_rpy_a")
    assert is_original_directory(path)
    gt, est = open_original_directory(path, AUTO)
    assert gt.cloud is not None and est.cloud is not None and gt.trajectory is not None
    assert (len(gt.cloud), len(est.cloud), len(gt.trajectory)) == (56112, 50354, 100)
    assert gt.trajectory.stamps_ns is None


@pytest.mark.parametrize(
    ("name", "options", "kind", "poses"),
    [
        ("traj_evo/KITTI_00_gt.txt", AUTO, "KITTI trajectory", 4541),
        ("traj_evo/KITTI_00_ORB.txt", AUTO, "KITTI trajectory", 4541),
        ("traj_evo/KITTI_00_SPTAM.txt", AUTO, "KITTI trajectory", 4541),
        ("traj_evo/V102_groundtruth.csv", AUTO, "EuRoC trajectory", 16702),
        ("traj_evo/V102.txt", AUTO, "TUM trajectory", 807),
        ("traj_evo/fr2_desk_groundtruth.txt", AUTO, "TUM trajectory", 20957),
        ("traj_evo/fr2_desk_ORB.txt", AUTO, "TUM trajectory", 2893),
        ("traj_evo/fr2_desk_ORB_kf_mono.txt", AUTO, "TUM trajectory", 157),
        ("traj_evo/freiburg1_xyz-groundtruth.txt", AUTO, "TUM trajectory", 3000),
        ("traj_evo/freiburg1_xyz-rgbdslam.txt", AUTO, "TUM trajectory", 788),
        ("traj_evo/georeferenced.tum", AUTO, "TUM trajectory", 1000),
        ("bags_evo/ROS_example.bag", SourceOptions(topics=("S-PTAM",)), "ROS 1 bag", 5439),
        ("bags_evo/nav2_turtlebot.mcap", SourceOptions(topics=("/odom",)), "MCAP recording", 2639),
    ],
)
def test_real_trajectories_are_recognised(name: str, options: SourceOptions, kind: str, poses: int) -> None:
    folder, _, file = name.partition("/")
    source = open_source(shared_data(folder) / file, options, "est")
    assert source.trajectory is not None
    assert (source.kind, len(source.trajectory)) == (kind, poses)


def test_real_bags_give_their_clouds_and_a_bag_of_transforms_says_what_it_holds() -> None:
    clouds = shared_data("bags_pointcloud")
    lidar = open_source(clouds / "embag_test.bag", AUTO, "est")
    assert lidar.cloud is not None and len(lidar.cloud) == 36336
    assert lidar.trajectory is not None and lidar.frames is None
    single = open_source(clouds / "ros_numpy_test.bag", AUTO, "est")
    assert single.cloud is not None and len(single.cloud) == 100
    transforms = shared_data("bags_evo") / "tf_example"
    with pytest.raises(InputError, match=r"/tf \(tf2_msgs/TFMessage, 517 messages\)"):
        open_source(transforms, AUTO, "gt")


def test_real_depth_takes_the_poses_of_an_estimate() -> None:
    path = shared_data("rgbd_tum_fr1_rpy_a")
    source = open_source(path, AUTO, "est", trajectory_path=path / "estimated_dvo.txt")
    assert source.trajectory is not None and len(source.trajectory) == 100
    assert source.frames is not None and source.frames.count == 100
