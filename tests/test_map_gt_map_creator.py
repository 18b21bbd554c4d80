"""The protocol `gt_map_creator` against the NumPy twin of the original, voxel for voxel and colour for colour."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import bags
import numpy as np
import oracle_gt_map as twin
import pytest
from scipy.spatial.transform import Rotation
from tum_sample import TumFrames, read_tum

from maomaps_warp.io.sources import SourceOptions
from maomaps_warp.jobs.ground_truth import GroundTruth, build_ground_truth, open_recording
from maomaps_warp.map_protocol import MAP_PRESETS
from maomaps_warp.model.camera import Camera
from maomaps_warp.protocol_files import with_overrides
from maomaps_warp.sim.agent import drive
from maomaps_warp.sim.render import render_frames
from maomaps_warp.sim.scene import furnished_flat

ORIGINAL = MAP_PRESETS["gt_map_creator"]
#: What a recording states and the original ignores.
STATED = Camera(320, 240, 262.5, 262.5, 159.75, 119.75)
DEPTH, RGB, INFO, POSE = "/habitat/depth/image", "/habitat/rgb/image", "/habitat/rgb/camera_info", "/true_pose"
#: Optical to body axes, written out.
R_BODY_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def write(path: Path, kind: bags.BagKind, depths: dict, colors: dict, poses: dict) -> Path:
    """A bag with the topics of MAOMaps: images by stamp, and (position, recorded quaternion xyzw) by stamp."""
    entries = [(DEPTH, t, bags.depth_message(kind, t, image)) for t, image in depths.items()]
    entries += [(RGB, t, bags.color_message(kind, t, image)) for t, image in colors.items()]
    entries += [(INFO, t, bags.camera_info(kind, t, STATED)) for t in depths]
    entries += [(POSE, t, bags.pose_stamped(kind, t, p, q)) for t, (p, q) in poses.items()]
    return bags.write_bag(bags.bag_path(path, kind), kind, sorted(entries, key=lambda entry: entry[1]))


def create(path: Path, pose_frame: str, protocol=ORIGINAL) -> GroundTruth:
    return build_ground_truth(open_recording(path, protocol, SourceOptions(pose_frame=pose_frame)), protocol)


def colored_voxels(truth: GroundTruth) -> twin.Voxels:
    world = truth.voxels.ijk + truth.voxels.grid.origin_ijk
    return dict(zip(map(tuple, world.tolist()), map(tuple, truth.voxels.colors.tolist()), strict=True))


def body_poses(frames: TumFrames, stamps: np.ndarray) -> dict:
    """Position and quaternion of the body at every stamp: the motion capture's neighbours, interpolated."""
    from scipy.spatial.transform import Slerp

    t = (frames.pose_stamps_ns - frames.pose_stamps_ns[0]) * 1e-9
    at = (stamps - frames.pose_stamps_ns[0]) * 1e-9
    turn = (
        Slerp(t, Rotation.from_matrix(frames.T_world_camera[:, :3, :3]))(at) * Rotation.from_matrix(R_BODY_CAMERA).inv()
    )
    positions = np.stack([np.interp(at, t, frames.T_world_camera[:, i, 3]) for i in range(3)], axis=1)
    return {s: (p, q) for s, p, q in zip(stamps.tolist(), positions.tolist(), turn.as_quat().tolist(), strict=True)}


@dataclass(frozen=True)
class Recording:
    """Depth, colours and recorded body poses by stamp, and what the twin makes of them, ceiling and all."""

    depths: dict
    colors: dict
    poses: dict
    whole: twin.Voxels


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Every fifth real frame at 320x240, some of them with a partner that is missing or a nanosecond off."""
    frames = read_tum(stride=2)
    chosen = slice(2, 97, 5)
    stamps = frames.stamps_ns[chosen]
    poses = body_poses(frames, stamps)
    depths = dict(zip(stamps.tolist(), frames.depth[chosen], strict=True))
    colors = dict(zip(stamps.tolist(), frames.colors[chosen], strict=True))
    keys = stamps.tolist()
    del colors[keys[3]]
    colors[keys[5] + 1] = colors.pop(keys[5])
    del poses[keys[8]]
    poses[keys[11] - 1] = poses.pop(keys[11])
    del depths[keys[14]]
    yaws = {stamp: (*p, twin.yaw_of_quaternion(*q)) for stamp, (p, q) in poses.items()}
    return Recording(depths, colors, poses, twin.create(depths, colors, yaws))


@pytest.fixture(scope="module")
def bag(recording, tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("real"), "ros1", recording.depths, recording.colors, recording.poses)


def test_the_original_and_its_twin_make_the_same_voxels_and_colours_of_real_frames(recording, bag):
    truth = create(bag, "maomaps-c")
    expected = twin.without_ceiling(recording.whole)
    assert colored_voxels(truth) == expected
    assert len(expected) > 10_000
    assert truth.counts["frames"] == len(recording.depths) == 18
    assert (truth.counts["frames_without_pose"], truth.counts["frames_without_color"]) == (2, 2)
    assert truth.counts["ceiling_removed"] == len(recording.whole) - len(expected) > 1000


def test_the_ceiling_stays_where_it_is_asked_to(recording, bag):
    kept = create(bag, "maomaps-c", with_overrides(ORIGINAL, {"ceiling": "keep"}, "test"))
    assert colored_voxels(kept) == recording.whole
    assert kept.counts["ceiling_removed"] == 0


def test_single_precision_would_not_do(recording, bag):
    """The comparisons above can fail: colours of a map in float32 are not all the twin's."""
    single = create(bag, "maomaps-c", with_overrides(ORIGINAL, {"arithmetic": "float32", "ceiling": "keep"}, "test"))
    assert colored_voxels(single) != recording.whole


def test_the_trajectory_keeps_its_whole_rotation(recording, bag):
    truth = create(bag, "maomaps-c")
    quaternions = [q for _, (_, q) in sorted(recording.poses.items())]
    expected = Rotation.from_quat(quaternions).as_matrix() @ R_BODY_CAMERA
    np.testing.assert_allclose(truth.trajectory.T_world_camera[:, :3, :3], expected, rtol=0, atol=1e-12)
    assert len(truth.trajectory) == len(recording.poses)


# The recorders of MAOMaps: poses of a drive, as the newest and the oldest of them publish orientations.

CORRECTION = -0.45  # samples 1 to 4


def recorded_c(position: np.ndarray, yaw: float) -> tuple:
    return position.tolist(), (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def recorded_a(position: np.ndarray, yaw: float) -> tuple:
    """The raw Habitat quaternion, about y; its consumers exchange y and z and add pi and the sample's correction."""
    raw = yaw - math.pi - CORRECTION
    return position.tolist(), (0.0, math.sin(raw / 2), 0.0, math.cos(raw / 2))


@pytest.fixture(scope="module")
def flat() -> tuple[dict, dict, list, list]:
    """Depth, colours, positions and headings of twelve frames of a simulated drive."""
    scene = furnished_flat(3)
    path = drive(scene, frames=240, seed=3)
    path = path.select(np.arange(0, 240, 20))
    camera = Camera(320, 240, 160.0, 160.0, 160.0, 120.0)
    frames = list(render_frames(scene.world, camera, path, "cpu").read(True))
    stamps = path.stamps_ns.tolist()
    R_world_body = path.T_world_camera[:, :3, :3] @ R_BODY_CAMERA.T
    yaws = np.arctan2(R_world_body[:, 1, 0], R_world_body[:, 0, 0]).tolist()
    depths = {t: frame.depth for t, frame in zip(stamps, frames, strict=True)}
    colors = {t: frame.colors for t, frame in zip(stamps, frames, strict=True)}
    return depths, colors, list(path.positions), yaws


@pytest.mark.parametrize(("pose_frame", "record"), [("maomaps-c", recorded_c), ("maomaps-a:sample1", recorded_a)])
def test_bags_of_both_recorders_give_the_voxels_of_the_twin(pose_frame, record, flat, tmp_path):
    depths, colors, positions, yaws = flat
    recorded = {t: record(p, yaw) for t, p, yaw in zip(depths, positions, yaws, strict=True)}
    poses = {t: (*p.tolist(), yaw) for t, p, yaw in zip(depths, positions, yaws, strict=True)}
    truth = create(write(tmp_path, "ros1", depths, colors, recorded), pose_frame)
    expected = twin.without_ceiling(twin.create(depths, colors, poses))
    assert colored_voxels(truth) == expected
    assert len(expected) > 1000
