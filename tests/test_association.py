"""Association along transferred rays: known answers, and the float64 twin on cluttered rooms."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import warp as wp
from oracle import associate as oracle_associate
from scenes import VOXEL, camera_pose, cluttered_room, wall
from scipy.spatial.transform import Rotation

from maomaps_warp.kernels.association_rules import to_camera
from maomaps_warp.mapping.cloud_map import voxelise
from maomaps_warp.mapping.distance_field import build_voxel_field
from maomaps_warp.mapping.surface import build_surface
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.correspondences import ElementClass
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.scoring.association import ViewRules, associate_maps
from maomaps_warp.scoring.pair_errors import pair_errors

CAMERA = Camera.from_fov(320, 240, 90.0)
#: Answers that a shift of the ray by this much would change are decided by float32 rounding, metres.
BAND = 2e-5


@pytest.fixture(params=[build_surface, build_voxel_field], ids=["mesh", "voxels"])
def build(request, device):
    """What makes a map ready for rays: a mesh of its faces, or a distance field."""
    return partial(request.param, device=device)


def _surface(points, build, origin=(10, 10, 6)):
    grid = VoxelGrid(VOXEL, np.array(origin, dtype=np.int64))
    return build(voxelise(np.asarray(points, dtype=float), grid))


def _poses(*poses):
    return np.stack(poses)


def _run(est, gt, T_est, T_gt, build, *, first=True, elements=None, **rules):
    e, g = _surface(est, build), _surface(gt, build)
    chosen = e.voxels.points if elements is None else np.asarray(elements, dtype=float)
    rules.setdefault("camera", CAMERA)
    return associate_maps(chosen, e, g, T_est, T_gt, ViewRules(**rules), first_surface_is_estimate=first)


def test_a_wall_too_far_by_ten_centimetres_has_that_error_along_the_ray(build):
    gt, est = wall(2.0, (-1, 1), (-0.5, 0.5)), wall(2.1, (-1, 1), (-0.5, 0.5))
    T = _poses(camera_pose((0, 0, 0), 0.0))
    c = _run([[2.1, 0, 0]], gt, T, T, build)
    assert c.counts == {"total": 1, "associated": 1, "out_of_view": 0, "occluded": 0, "no_ground_truth": 0}
    np.testing.assert_allclose(c.absolute_errors(), 0.1, rtol=0, atol=1e-12)
    assert len(_run(est, gt, T, T, build)) == len(est)


def test_the_transferred_ray_starts_from_the_ground_truth_pose(build):
    # The estimate believes the camera 0.3 m further on and turned by 90 degrees; it sees its wall at 1.7 m.
    T_gt, T_est = camera_pose((0, 0, 0), 0.0), camera_pose((5, 5, 0), np.pi / 2)
    est = [[5.0, 6.7, 0.0]]
    c = _run(est, wall(2.0, (-1, 1), (-0.5, 0.5)), _poses(T_est), _poses(T_gt), build)
    np.testing.assert_allclose(c.gt(), [[2.0, 0, 0]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(c.est(), est, rtol=0, atol=1e-12)
    absolute, relative = pair_errors(c, _poses(T_est), _poses(T_gt))
    np.testing.assert_allclose(relative, 0.3, rtol=0, atol=1e-9)
    np.testing.assert_allclose(absolute, np.linalg.norm([3.0, 6.7, 0.0]), rtol=0, atol=1e-9)
    np.testing.assert_allclose(c.absolute_errors(), absolute, rtol=0, atol=1e-12)


@pytest.mark.parametrize("choice", ["nearest", "first", "last", "all"])
def test_a_map_scored_against_itself_gives_exactly_zero(build, choice):
    room = cluttered_room(3)
    T = _poses(*[camera_pose((0.7 + 0.1 * i, 1.1, 0.7), 0.9 * i, 0.1 * i) for i in range(7)])
    c = _run(room, room, T, T, build, pose_choice=choice)
    assert len(c) > 500
    assert not c.absolute_errors().any()


def test_the_element_itself_is_the_estimate_when_the_protocol_says_so(build):
    # Two voxels behind one another: the far one is seen through the near one, within the tolerance.
    est = [[1.0, 0, 0], [1.2, 0, 0]]
    T = _poses(camera_pose((0, 0, 0), 0.0))
    gt = [[1.0, 0, 0]]
    seen = _run(est, gt, T, T, build, first=True)
    printed = _run(est, gt, T, T, build, first=False)
    np.testing.assert_allclose(seen.absolute_errors(), [0.0, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(printed.absolute_errors(), [0.0, 0.2], rtol=0, atol=1e-12)


def test_every_element_ends_in_exactly_one_class(build):
    est = [[1.0, 0, 0], [2.0, 0, 0], [-1.0, 0, 0], [1.0, 0.5, 0]]
    gt = [[1.3, 0, 0]]
    T = _poses(camera_pose((0, 0, 0), 0.0))
    c = _run(est, gt, T, T, build)
    by_point = {tuple(np.round(p, 2)): ElementClass(k) for p, k in zip(c.elements, c.classes, strict=True)}
    assert by_point == {
        (1.0, 0.0, 0.0): ElementClass.ASSOCIATED,
        (2.0, 0.0, 0.0): ElementClass.OCCLUDED,
        (-1.0, 0.0, 0.0): ElementClass.OUT_OF_VIEW,
        (1.0, 0.5, 0.0): ElementClass.NO_GROUND_TRUTH,
    }
    counts = c.counts
    assert counts.pop("total") == sum(counts.values()) == 4


def test_points_behind_the_camera_count_only_under_the_two_sided_rule(build):
    T = _poses(camera_pose((0, 0, 0), 0.0))
    assert _run([[-1, 0, 0]], [[-1, 0, 0]], T, T, build).counts["out_of_view"] == 1
    assert _run([[-1, 0, 0]], [[-1, 0, 0]], T, T, build, two_sided=True).counts["associated"] == 1


def test_the_image_ends_at_its_last_pixel(build):
    T = _poses(camera_pose((0, 0, 0), 0.0))
    inside, outside = [1.0, 0.95, 0.7], [1.0, 1.05, 0.0]
    above = [1.0, 0.0, 0.8]
    elements = [inside, outside, above]
    c = _run(elements, elements, T, T, build)
    by_point = {tuple(np.round(p, 2)): ElementClass(k).name for p, k in zip(c.elements, c.classes, strict=True)}
    assert by_point == {
        tuple(inside): "ASSOCIATED",
        tuple(outside): "OUT_OF_VIEW",
        tuple(above): "OUT_OF_VIEW",
    }


def test_range_and_near_limits_put_elements_out_of_view(build):
    T = _poses(camera_pose((0, 0, 0), 0.0))
    assert _run([[3, 0, 0]], [[3, 0, 0]], T, T, build, max_range=2.5).counts["out_of_view"] == 1
    assert _run([[3, 0, 0]], [[3, 0, 0]], T, T, build, near=3.5).counts["out_of_view"] == 1


def test_a_camera_inside_an_occupied_voxel_sees_that_voxel_and_not_through_it(build):
    est = [[1.0, 0, 0], [2.0, 0, 0]]
    for choice in ("nearest", "all"):
        for x in (0.98, 0.995, 1.0, 1.02):  # before the voxel's centre, at it, past it
            T = _poses(camera_pose((x, 0.01, 0), 0.0))
            c = _run(est, est, T, T, build, pose_choice=choice)
            assert c.classes.tolist() == [ElementClass.ASSOCIATED, ElementClass.OCCLUDED]
            assert not c.absolute_errors().any()


def test_the_choice_of_the_pose(build):
    # Three poses on a line see the wall; the ground truth of each is another wall distance.
    T_est = _poses(*[camera_pose((x, 0, 0), 0.0) for x in (0.0, 1.0, 0.5)])
    T_gt = _poses(*[camera_pose((x, 0, 0), 0.0) for x in (0.0, 0.8, 0.1)])
    est, gt = [[2.0, 0, 0]], wall(2.0, (-0.5, 0.5), (-0.5, 0.5))
    chosen = {
        choice: _run(est, gt, T_est, T_gt, build, pose_choice=choice).pose.tolist()
        for choice in ("nearest", "first", "last", "all")
    }
    assert chosen == {"nearest": [1], "first": [0], "last": [2], "all": [0, 1, 2]}


def test_of_equally_near_poses_the_lower_index_is_chosen(build):
    # The poses are tried in a shuffled order, so that index 3, the first of the nearer ones, is seldom tried first.
    far, near = camera_pose((0, 0, 0), 0.0), camera_pose((0.5, 0, 0), 0.0)
    T = _poses(*[far] * 3, *[near] * 13)
    assert _run([[2, 0, 0]], [[2, 0, 0]], T, T, build).pose.tolist() == [3]


def test_an_element_exactly_at_the_tolerance_behind_the_surface_is_occluded_wherever_the_grid_lies(build):
    T = _poses(camera_pose((0, 0, 0), 0.0))
    est = [[1.0, 0, 0], [1.5, 0, 0], [1.45, 0, 0]]
    for origin in ((10, 10, 6), (0, 0, 0), (-2000, 36, 1234)):
        e = _surface(est, build, origin=origin)
        c = associate_maps(e.voxels.points, e, e, T, T, ViewRules(CAMERA, occlusion_tolerance=0.5))
        classes = dict(zip(np.round(c.elements[:, 0], 2).tolist(), c.classes.tolist(), strict=True))
        assert classes == {
            1.0: ElementClass.ASSOCIATED,
            1.45: ElementClass.ASSOCIATED,
            1.5: ElementClass.OCCLUDED,
        }


def test_far_walls_are_reached(build):
    T = _poses(camera_pose((0, 0, 0), 0.0))
    assert _run([[60.0, 0, 0]], [[75.0, 0, 0]], T, T, build).absolute_errors() == pytest.approx([15.0])


@wp.kernel(enable_backward=False)
def _to_camera(R: wp.array(dtype=wp.mat33), offsets: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    out[i] = to_camera(R[i], offsets[i])


def test_camera_coordinates_are_those_of_the_inverse_rotation(device):
    offset = np.random.default_rng(0).uniform(-5, 5, size=(200, 3))
    rotation = Rotation.random(200, random_state=1)
    R = wp.array(rotation.as_matrix().astype(np.float32), dtype=wp.mat33, device=device)
    out = wp.empty(200, dtype=wp.vec3, device=device)
    offsets = wp.array(offset.astype(np.float32), dtype=wp.vec3, device=device)
    wp.launch(_to_camera, dim=200, inputs=[R, offsets], outputs=[out], device=device)
    # 5 m times a few roundings of float32.
    np.testing.assert_allclose(out.numpy(), rotation.inv().apply(offset), rtol=0, atol=5e-6)


def test_no_poses_leave_every_element_out_of_view(build):
    none = np.empty((0, 4, 4))
    for choice in ("nearest", "first", "last", "all"):
        c = _run([[2, 0, 0]], [[2, 0, 0]], none, none, build, pose_choice=choice)
        assert c.counts["out_of_view"] == 1
        assert len(c) == 0


def test_no_elements_give_no_correspondences(build):
    T = _poses(camera_pose((0, 0, 0), 0.0))
    c = _run([[2, 0, 0]], [[2, 0, 0]], T, T, build, elements=np.empty((0, 3)))
    assert c.counts["total"] == len(c) == len(c.absolute_errors()) == 0


@pytest.mark.parametrize("choice", ["nearest", "first", "last"])
def test_a_cluttered_room_agrees_with_the_twin(build, choice):
    rng = np.random.default_rng(7)
    gt, est = cluttered_room(5), cluttered_room(6)
    T_gt = _poses(*[camera_pose(tuple(rng.uniform([0.5, 0.5, 0.4], [2.4, 2.0, 1.1])), a) for a in range(6)])
    T_est = T_gt.copy()
    T_est[:, :3, 3] += rng.normal(scale=0.03, size=(6, 3))
    elements = est[rng.choice(len(est), 250, replace=False)]
    c = _run(est, gt, T_est, T_gt, build, elements=elements, pose_choice=choice)

    def cells(points):
        return set(map(tuple, np.rint(points / VOXEL).astype(int).tolist()))

    expected = oracle_associate(elements, cells(est), cells(gt), T_est, T_gt, 1.0, 0.75, 0.5, VOXEL, choice, BAND)
    row_of = {int(e): i for i, e in enumerate(c.element)}
    compared = 0
    for i, (kind, pose, est_cell, gt_cell, safe) in enumerate(expected):
        if not safe:
            continue
        compared += 1
        assert ElementClass(c.classes[i]).name.lower() == kind
        if kind == "associated":
            row = row_of[i]
            assert c.pose[row] == pose
            np.testing.assert_allclose(c.est()[row], np.array(est_cell) * VOXEL, rtol=0, atol=1e-9)
            np.testing.assert_allclose(c.gt()[row], np.array(gt_cell) * VOXEL, rtol=0, atol=1e-9)
    assert compared > 200


def test_surfaces_on_different_grids_are_a_programming_mistake(build):
    a, b = _surface([[0, 0, 0]], build), _surface([[0, 0, 0]], build, origin=(0, 0, 0))
    T = _poses(camera_pose((0, 0, 0), 0.0))
    with pytest.raises(ValueError, match="grid"):
        associate_maps(a.voxels.points, a, b, T, T, ViewRules(CAMERA))


def test_a_mesh_and_a_distance_field_do_not_mix(device):
    grid = VoxelGrid(VOXEL, np.zeros(3, dtype=np.int64))
    voxels = voxelise(np.zeros((1, 3)), grid)
    T = _poses(camera_pose((0, 0, 0), 0.0))
    with pytest.raises(ValueError, match="one kind"):
        associate_maps(
            np.zeros((1, 3)), build_surface(voxels, device), build_voxel_field(voxels, device), T, T, ViewRules(CAMERA)
        )
