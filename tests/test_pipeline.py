"""The main job on analytic worlds: one transform for trajectory and map, nothing lost, nothing guessed."""

from __future__ import annotations

import gc
import json
import weakref

import numpy as np
import pytest
from scenes import VOXEL, camera_pose, cluttered_room
from scipy.spatial.transform import Rotation

from maomaps_warp.errors import InputError
from maomaps_warp.io.sources import Source
from maomaps_warp.mapping.voxel_map import DepthLimits, build_voxel_map
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.results import NoValue
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.pipeline import score
from maomaps_warp.protocol import PRESETS
from maomaps_warp.protocol_files import with_overrides
from maomaps_warp.report.json_report import score_document

CAMERA = Camera(64, 48, 32.0, 32.0, 31.5, 23.5)
#: Rounding of a fitted transform over a few metres.
FIT = 1e-9


def _trajectory(count=12, stamps=True):
    poses = [camera_pose((0.8 + 0.1 * i, 1.0 + 0.3 * np.sin(i), 0.7), 0.5 * i, 0.1) for i in range(count)]
    stamps_ns = np.arange(count, dtype=np.int64) * 100_000_000 if stamps else None
    return Trajectory(np.stack(poses), stamps_ns, "trajectory")


def _cloud(points):
    return PointCloud(np.asarray(points, dtype=np.float64), source="cloud")


def _source(**parts):
    return Source("side", "made up", **parts)


def _rules(**overrides):
    return with_overrides(PRESETS["maomaps"], overrides, "test")


def _similarity(scale=1.0, angles=(0.4, -0.2, 0.3), shift=(3.0, -2.0, 0.5)):
    return scale, Rotation.from_euler("ZYX", angles).as_matrix(), np.array(shift)


def _moved(trajectory, points, similarity):
    """The same run as another world would state it: p -> s R p + t."""
    scale, R, t = similarity
    T = trajectory.T_world_camera.copy()
    T[:, :3, :3] = R @ T[:, :3, :3]
    T[:, :3, 3] = scale * T[:, :3, 3] @ R.T + t
    return Trajectory(T, trajectory.stamps_ns, "estimate"), scale * points @ R.T + t


def test_a_run_against_itself_is_exactly_zero_everywhere():
    gt = _source(trajectory=_trajectory(), cloud=_cloud(cluttered_room(0)))
    run = score(gt, gt, camera=CAMERA, device="cpu").score
    assert run.ate.errors["absolute"].translation.max == 0.0
    assert run.rpe.errors["frames"].translation.max < 1e-15
    assert run.ame_nn.accuracy.max == run.ame_nn.completeness.max == 0.0
    assert run.ame_nn.overlap.iou == 1.0
    assert run.ame_ray.absolute.max == 0.0
    assert run.ame_ray.counts["associated"] > 1000


@pytest.mark.parametrize(("method", "scale"), [("se3", 1.0), ("sim3", 0.37), ("origin", 1.0), ("sim3", 2.5)])
def test_an_alignment_moves_trajectory_and_map_alike(method, scale):
    room, gt_poses = cluttered_room(1), _trajectory()
    est_poses, est_points = _moved(gt_poses, room, _similarity(scale))
    gt = _source(trajectory=gt_poses, cloud=_cloud(room))
    est = _source(trajectory=est_poses, cloud=_cloud(est_points))
    run = score(gt, est, _rules(align=method), camera=CAMERA, device="cpu").score
    assert run.ate.errors["absolute"].translation.max < FIT
    assert run.ame_nn.accuracy.max < FIT
    assert run.ame_nn.overlap.iou == 1.0
    assert run.ame_ray.absolute.median == 0.0
    assert run.alignment.scale == pytest.approx(1.0 / scale)


def test_a_map_from_frames_is_scaled_with_its_trajectory():
    gt_poses = _trajectory()
    est_poses, _ = _moved(gt_poses, np.zeros((1, 3)), _similarity(2.0))
    rng = np.random.default_rng(0)
    depths = rng.uniform(0.5, 3.0, size=(12, 48, 64)).astype(np.float32)

    def frames(scale):
        def read(with_colors):
            for i, depth in enumerate(depths):
                yield Frame(i, int(gt_poses.stamps_ns[i]), (scale * depth).astype(np.float32))

        return FrameStream(CAMERA, 12, read, "frames")

    gt = _source(trajectory=gt_poses, frames=frames(1.0))
    est = _source(trajectory=est_poses, frames=frames(2.0))
    run = score(gt, est, _rules(align="sim3"), device="cpu").score
    # Samples that lie on a cell's face to within float32 may fall on either side.
    assert run.ame_nn.overlap.iou > 0.995
    assert run.est.facts["pixels_used"] == run.gt.facts["pixels_used"]


def test_range_limits_under_scale_apply_to_the_depth_as_measured_and_are_noted():
    gt_poses = _trajectory()
    est_poses, _ = _moved(gt_poses, np.zeros((1, 3)), _similarity(2.0))

    def frames(depth):
        def read(with_colors):
            for i, stamp in enumerate(gt_poses.stamps_ns):
                yield Frame(i, int(stamp), np.full((48, 64), depth, np.float32))

        return FrameStream(CAMERA, 12, read, "frames")

    gt = _source(trajectory=gt_poses, frames=frames(4.0))
    for depth, used in ((8.0, True), (10.5, False)):  # 4 m and 5.25 m in the ground truth's metres
        est = _source(trajectory=est_poses, frames=frames(depth))
        run = score(gt, est, _rules(align="sim3"), device="cpu").score
        assert isinstance(run.ame_nn, NoValue) != used
        assert "before its scale of 0.5" in run.notes[0]


def test_an_empty_map_has_a_reason_of_its_own():
    room, nothing = _cloud(cluttered_room(2)), _cloud(np.empty((0, 3)))
    for gt, est in ((room, nothing), (nothing, room)):
        run = score(_source(cloud=gt), _source(cloud=est), device="cpu").score
        assert isinstance(run.ame_nn, NoValue) and run.ame_nn.asked
        assert "depth" not in run.ame_nn.reason


@pytest.mark.parametrize("one_clock", [True, False])
def test_an_offset_of_the_clock_reaches_frames_that_come_from_another_file(one_clock):
    poses = _trajectory()
    late = Trajectory(poses.T_world_camera, poses.stamps_ns + 10**11, "late")
    rng = np.random.default_rng(1)
    depths = rng.uniform(0.5, 3.0, size=(12, 48, 64)).astype(np.float32)

    def frames(offset):
        def read(with_colors):
            for i, depth in enumerate(depths):
                yield Frame(i, int(poses.stamps_ns[i]) + offset, depth)

        return FrameStream(CAMERA, 12, read, "frames")

    gt = _source(trajectory=poses, frames=frames(0))
    # One recording: its frames are late too. Two files: the frames have the ground truth's clock.
    est = _source(trajectory=late, frames=frames(10**11 if one_clock else 0), one_clock=one_clock)
    run = score(gt, est, _rules(t_offset=-100.0), device="cpu").score
    assert run.est.facts["frames_without_pose"] == 0
    assert run.ame_nn.accuracy.max == 0.0


def test_a_scaled_estimate_without_scale_is_wrong_and_says_so():
    room, gt_poses = cluttered_room(1), _trajectory()
    est_poses, est_points = _moved(gt_poses, room, _similarity(1.1))
    gt = _source(trajectory=gt_poses, cloud=_cloud(room))
    est = _source(trajectory=est_poses, cloud=_cloud(est_points))
    run = score(gt, est, _rules(align="se3"), camera=CAMERA, device="cpu").score
    assert run.ame_nn.accuracy.rmse > 0.03
    assert run.ame_ray.absolute.rmse > 0.05


def test_trajectories_alone_give_no_map_metrics_and_no_failure():
    run = score(_source(trajectory=_trajectory()), _source(trajectory=_trajectory())).score
    assert run.ate.errors["absolute"].translation.rmse == 0.0
    assert isinstance(run.ame_nn, NoValue) and not run.ame_nn.asked
    assert run.failures == ()
    assert run.device == "none"


def test_choices_that_play_no_part_are_named():
    poses = _source(trajectory=_trajectory(stamps=False))
    rules = _rules(voxel_size=0.1, match="nearest", align="yaw")
    notes = score(poses, poses, rules, camera=CAMERA).score.notes
    assert notes == ("without effect on this input: voxel_size, camera, match",)
    stamped = _source(trajectory=_trajectory())
    assert score(stamped, stamped, _rules(match="nearest")).score.notes == ()


def test_trajectories_read_in_different_pose_conventions_are_pointed_out():
    gt = _trajectory()
    body = Trajectory(gt.T_world_camera, gt.stamps_ns, "odometry", pose_frame="body")
    (note,) = score(_source(trajectory=body), _source(trajectory=gt)).score.notes
    assert "--gt-pose-frame" in note


def test_a_map_and_a_trajectory_have_nothing_in_common():
    with pytest.raises(InputError, match="nothing to compare"):
        score(_source(cloud=_cloud([[0, 0, 0]])), _source(trajectory=_trajectory()))


def test_maps_alone_give_nearest_neighbours_alone():
    room = cluttered_room(2)
    run = score(_source(cloud=_cloud(room)), _source(cloud=_cloud(room + [0, 0, 0.02])), device="cpu").score
    assert run.ame_nn.accuracy.rmse == pytest.approx(0.02, abs=FIT)
    assert isinstance(run.ate, NoValue) and isinstance(run.ame_ray, NoValue)
    assert run.failures == ()


def test_nearest_neighbours_are_taken_between_the_points_as_given():
    rng = np.random.default_rng(3)
    gt, est = rng.uniform(size=(300, 3)), rng.uniform(size=(200, 3))
    run = score(_source(cloud=_cloud(gt)), _source(cloud=_cloud(est)), device="cpu").score
    expected = np.linalg.norm(est[:, None] - gt[None], axis=2).min(axis=1)
    assert run.ame_nn.accuracy.rmse == pytest.approx(np.sqrt((expected**2).mean()), abs=1e-6)
    assert run.ame_nn.accuracy.max == pytest.approx(expected.max(), abs=1e-6)


def test_stamps_that_do_not_match_leave_the_maps_comparable_without_alignment():
    late = Trajectory(_trajectory().T_world_camera, _trajectory().stamps_ns + 10**12, "late")
    room = cluttered_room(2)
    gt = _source(trajectory=_trajectory(), cloud=_cloud(room))
    run = score(gt, _source(trajectory=late, cloud=_cloud(room)), camera=CAMERA, device="cpu").score
    assert run.ame_nn.accuracy.max == 0.0
    assert isinstance(run.ate, NoValue) and "--t-offset" in run.ate.reason
    assert len(run.failures) == 1
    document = score_document(run)
    assert document["metrics"]["ate"]["value"] is None
    assert document["metrics"]["ame_ray"]["counts"]["unmatched"] == 12


def test_stamps_that_do_not_match_leave_no_alignment_and_no_score():
    late = Trajectory(_trajectory().T_world_camera, _trajectory().stamps_ns + 10**12, "late")
    cloud = _cloud(cluttered_room(2))
    run = score(
        _source(trajectory=_trajectory(), cloud=cloud),
        _source(trajectory=late, cloud=cloud),
        _rules(align="se3"),
        device="cpu",
    ).score
    assert all(isinstance(m, NoValue) for m in (run.ate, run.rpe, run.ame_nn, run.ame_ray))
    assert score_document(run)["alignment"] is None


def test_an_estimate_that_no_pose_sees_is_counted_and_has_no_value():
    behind = Trajectory(np.stack([camera_pose((0, 0, 0), 0.0)] * 2), np.array([0, 1], dtype=np.int64), "t")
    cloud = _cloud([[-1.0, 0, 0], [-1.0, 0.05, 0]])
    source = _source(trajectory=behind, cloud=cloud)
    run = score(source, source, camera=CAMERA, device="cpu").score
    assert isinstance(run.ame_ray, NoValue) and run.ame_ray.asked
    assert run.ame_ray.counts["out_of_view"] == run.ame_ray.counts["total"] == 2


def test_aligning_without_a_trajectory_names_the_way_out():
    with pytest.raises(InputError, match="--align se3.*no trajectory.*--align none"):
        score(_source(cloud=_cloud([[0, 0, 0]])), _source(cloud=_cloud([[0, 0, 0]])), _rules(align="se3"))


def test_the_same_input_gives_the_same_bytes_but_for_the_times():
    gt = _source(trajectory=_trajectory(), cloud=_cloud(cluttered_room(4)))
    est = _source(trajectory=_trajectory(), cloud=_cloud(cluttered_room(5)))

    def document():
        result = score_document(score(gt, est, camera=CAMERA, device="cpu").score)
        assert result.pop("milliseconds")
        return json.dumps(result, allow_nan=False)

    assert document() == document()


@pytest.mark.parametrize("choice", ["nearest", "all"])
def test_both_casters_and_any_number_of_threads_give_the_same_score(monkeypatch, choice):
    room, poses = cluttered_room(3), _trajectory()
    moved = _moved(poses, room, _similarity(1.0, (0.03, 0.0, 0.0), (0.02, -0.03, 0.0)))
    gt, est = _source(trajectory=poses, cloud=_cloud(room)), _source(trajectory=moved[0], cloud=_cloud(moved[1]))
    found = {}
    for caster, threads in (("voxels", "1"), ("voxels", "3"), ("mesh", "3")):
        monkeypatch.setenv("MAOMAPS_THREADS", threads)
        run = score(gt, est, _rules(caster=caster, pose_choice=choice), camera=CAMERA, device="cpu")
        found[caster, threads] = score_document(run.score)["metrics"]
    assert json.dumps(found["voxels", "1"]) == json.dumps(found["voxels", "3"])
    leaps, mesh = (found[key]["ame_ray"] for key in (("voxels", "3"), ("mesh", "3")))
    assert mesh["counts"]["total"] == leaps["counts"]["total"]
    # A ray in a thousand grazes an edge.
    assert mesh["counts"]["associated"] == pytest.approx(leaps["counts"]["associated"], rel=2e-3)
    assert mesh["median"] == pytest.approx(leaps["median"], rel=2e-2)


def test_a_number_of_threads_that_is_none_is_refused(monkeypatch):
    monkeypatch.setenv("MAOMAPS_THREADS", "two")
    gt = _source(trajectory=_trajectory(), cloud=_cloud(cluttered_room(0)))
    with pytest.raises(InputError, match="MAOMAPS_THREADS: 'two' is no number of threads"):
        score(gt, gt, camera=CAMERA, device="cpu")


def test_the_camera_comes_from_the_option_then_the_estimate_then_the_ground_truth_then_the_protocol():
    small, wide = Camera(10, 10, 10.0, 10.0, 4.5, 4.5), Camera(20, 20, 10.0, 10.0, 9.5, 9.5)
    base = {"trajectory": _trajectory(), "cloud": _cloud(cluttered_room(0))}

    def named(camera=None, gt=None, est=None):
        run = score(_source(**base, camera=gt), _source(**base, camera=est), camera=camera, device="cpu")
        return run.score.camera

    assert named(CAMERA, small, wide).startswith("64x48")
    assert named(None, small, wide).startswith("20x20")
    assert named(None, small, None).startswith("10x10")
    assert "the protocol's" in named()


@pytest.mark.slow
def test_memory_holds_few_frames_at_a_time(device, monkeypatch):
    monkeypatch.setenv("MAOMAPS_THREADS", "1")
    monkeypatch.setattr("maomaps_warp.mapping.brick_map.BATCH_FRAMES", 1)
    alive: list[weakref.ref] = []
    most = 0

    def read(with_colors):
        nonlocal most
        for i in range(40):
            depth = np.full((48, 64), 1.0 + 0.01 * i, np.float32)
            alive.append(weakref.ref(depth))
            yield Frame(i, None, depth)
            del depth
            gc.collect()
            most = max(most, sum(r() is not None for r in alive))

    stream = FrameStream(CAMERA, None, read, "endless")
    grid = VoxelGrid(VOXEL, np.zeros(3, dtype=np.int64))
    build_voxel_map(stream, lambda f: np.eye(4), grid, DepthLimits(), device=device)
    assert most <= 1 + 2
