from __future__ import annotations

from pathlib import Path

import bags
import numpy as np
import pytest
from bag_samples import ROTATION_TOLERANCE, T0_NS, assert_same_poses, bag_trajectory, some_poses
from bags import bag_path, write_bag
from scipy.spatial.transform import Rotation

from maomaps_warp.errors import InputError


@pytest.mark.parametrize(
    "make",
    [bags.pose_stamped, bags.pose_with_covariance_stamped, bags.transform_stamped],
    ids=["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped"],
)
@pytest.mark.parametrize("kind", ["ros1", "ros2-mcap"])
def test_every_stamped_pose_type_is_the_camera_with_the_stamp_of_its_header(make, kind, tmp_path: Path) -> None:
    late = 5_000_000_000  # the log lags behind the header; only the header counts
    poses = some_poses(4)
    quaternions = Rotation.from_matrix(poses.T_world_camera[:, :3, :3]).as_quat()
    entries = [
        ("/p", int(t) + late, make(kind, int(t), T[:3, 3], q))
        for t, T, q in zip(poses.stamps_ns, poses.T_world_camera, quaternions, strict=True)
    ]
    found = bag_trajectory(write_bag(bag_path(tmp_path, kind), kind, entries))
    assert_same_poses(found, poses)
    assert found.frame_id == "map" and found.notes == ()


def test_odometry_of_a_body_is_turned_into_the_optical_frame_and_noted(tmp_path: Path) -> None:
    def odometry_bag(name: str, child: str) -> Path:
        # A body at (1, 2, 3) that looks along world y.
        turn = (0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4))
        item = bags.odometry("ros1", T0_NS, (1, 2, 3), turn, child)
        return write_bag(tmp_path / name, "ros1", [("/odom", T0_NS, item)])

    body = odometry_bag("body.bag", "base_link")
    found = bag_trajectory(body)
    # The camera's right is world x, its down is world -z, its forward is world y.
    expected = [[1, 0, 0, 1], [0, 0, 1, 2], [0, -1, 0, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(found.T_world_camera[0], expected, rtol=0, atol=ROTATION_TOLERANCE)
    assert "'base_link'" in found.notes[0] and found.frame_id == "odom"

    left_alone = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    optical = odometry_bag("optical.bag", "camera_color_optical_frame")
    for found in (bag_trajectory(optical), bag_trajectory(body, pose_frame="optical")):
        np.testing.assert_allclose(found.T_world_camera[0], left_alone, rtol=0, atol=ROTATION_TOLERANCE)
        assert found.notes == ()
    found = bag_trajectory(optical, pose_frame="body")
    np.testing.assert_allclose(found.T_world_camera[0], expected, rtol=0, atol=ROTATION_TOLERANCE)


def test_of_a_path_the_last_message_with_poses_is_read(tmp_path: Path) -> None:
    def path_entry(log: int, count: int) -> bags.Entry:
        poses = [bags.pose_stamped("ros2-mcap", T0_NS + i, (i, log, 0), frame_id="") for i in range(count)]
        return "/path", T0_NS + log, bags.path_message("ros2-mcap", T0_NS + log, poses)

    grown = write_bag(tmp_path / "grown", "ros2-mcap", [path_entry(1, 1), path_entry(2, 3)])
    found = bag_trajectory(grown)
    np.testing.assert_array_equal(found.positions, [[0, 2, 0], [1, 2, 0], [2, 2, 0]])
    np.testing.assert_array_equal(found.stamps_ns, T0_NS + np.arange(3))
    assert found.frame_id == "map" and found.notes == ("/path: the last of 2 paths is used",)

    reset = write_bag(tmp_path / "reset", "ros2-mcap", [path_entry(1, 1), path_entry(2, 3), path_entry(3, 0)])
    found = bag_trajectory(reset)
    assert len(found) == 3 and "path 2 of 3" in found.notes[0]

    never = write_bag(tmp_path / "never", "ros2-mcap", [path_entry(1, 0)])
    with pytest.raises(InputError, match="none of its 1 paths holds a pose"):
        bag_trajectory(never)


def pose_bag(tmp_path: Path, *poses: tuple) -> Path:
    """A bag of PoseStamped (stamp offset in ns, position, quaternion, frame) logged in this order."""
    entries = [("/pose", T0_NS + i, bags.pose_stamped("ros1", *pose)) for i, pose in enumerate(poses)]
    return write_bag(tmp_path / "run.bag", "ros1", entries)


UNIT = (0, 0, 0, 1)


@pytest.mark.parametrize(
    ("second", "found"),
    [
        ((0, (0, 0, 0), UNIT), "message 2: the header's stamp is 0 ns"),
        ((T0_NS - 5, (0, 0, 0), UNIT), "message 2: stamp .* comes after a later one"),
        ((T0_NS, (1, 0, 0), UNIT), "message 2: stamp .* stands twice"),
        ((T0_NS + 5, (0, 0, 0), (0, 0, 0, 0)), "message 2: quaternion"),
        ((T0_NS + 5, (0, 0, 0), (0, 0, 0, 1.5)), "message 2: quaternion"),
        ((T0_NS + 5, (0, np.nan, 0), UNIT), "message 2: the position is not finite"),
        ((T0_NS + 5, (0, 0, 0), (0, np.nan, 0, 1)), "message 2: quaternion"),
        ((T0_NS + 5, (0, 0, 0), UNIT, "odom"), "message 2: the frame changes from 'map' to 'odom'"),
    ],
)
def test_a_bad_pose_is_refused_with_the_number_of_its_message(second: tuple, found: str, tmp_path: Path) -> None:
    path = pose_bag(tmp_path, (T0_NS, (0, 0, 0), UNIT), second)
    with pytest.raises(InputError, match=f"{path}, topic /pose, {found}"):
        bag_trajectory(path)


def test_poses_published_twice_are_dropped_and_noted(tmp_path: Path) -> None:
    one, two = (T0_NS, (0, 0, 0), UNIT), (T0_NS + 9, (1, 0, 0), UNIT)
    found = bag_trajectory(pose_bag(tmp_path, one, one, two, two, two))
    np.testing.assert_array_equal(found.stamps_ns, [T0_NS, T0_NS + 9])
    np.testing.assert_array_equal(found.positions, [[0, 0, 0], [1, 0, 0]])
    assert found.notes[0].startswith("3 of 5 poses")


def test_one_repeated_stamp_in_a_long_recording_is_kept_and_noted(tmp_path: Path) -> None:
    poses = [(T0_NS + i, (i, 0, 0), UNIT) for i in range(100)]
    found = bag_trajectory(pose_bag(tmp_path, *poses, (T0_NS + 99, (7, 0, 0), UNIT)))
    assert len(found) == 101 and "1 of 101 poses have the stamp of the pose before" in found.notes[0]
    (tmp_path / "run.bag").unlink()
    often = [(T0_NS + 99, (k, 0, 0), UNIT) for k in (7, 8)]
    with pytest.raises(InputError, match="message 101: stamp .* stands twice; 2 stamps are so"):
        bag_trajectory(pose_bag(tmp_path, *poses, *often))
