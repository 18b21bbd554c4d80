"""Errors of correspondences, against a plain NumPy twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from maomaps_warp.model.correspondences import Correspondences
from maomaps_warp.scoring.pair_errors import pair_errors

#: Two orders of the same float64 sums over coordinates of up to 1e4 m differ by less, metres.
ROUNDING = 1e-10


def _poses(rng, count, reach):
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=int(rng.integers(1 << 30))).as_matrix()
    T[:, :3, 3] = rng.uniform(-reach, reach, (count, 3))
    return T


def _correspondences(rng, pairs, poses, points, reach):
    est, gt = (rng.uniform(-reach, reach, (points, 3)) for _ in range(2))

    def draw(high):
        return rng.integers(0, high, pairs).astype(np.int32)

    none = np.zeros(0, dtype=np.uint8)
    return Correspondences(est, none, draw(points), draw(poses), est, draw(points), gt, draw(points))


@pytest.mark.parametrize("pairs", [0, 1, 17, 100_003])
def test_errors_equal_a_numpy_twin(pairs, device, monkeypatch):
    rng = np.random.default_rng(pairs)
    c = _correspondences(rng, pairs, 30, 500, 1e4)
    T_est, T_gt = _poses(rng, 30, 1e4), _poses(rng, 30, 1e4)
    absolute, relative = pair_errors(c, T_est, T_gt, device)
    est, gt = c.est_points[c.est_index], c.gt_points[c.gt_index]
    np.testing.assert_allclose(absolute, np.linalg.norm(est - gt, axis=1), rtol=0, atol=ROUNDING)
    in_frames = [
        np.einsum("nji,nj->ni", T[c.pose, :3, :3], points - T[c.pose, :3, 3])
        for T, points in ((T_est, est), (T_gt, gt))
    ]
    np.testing.assert_allclose(relative, np.linalg.norm(in_frames[0] - in_frames[1], axis=1), rtol=0, atol=ROUNDING)
    for threads in ("1", "3"):
        monkeypatch.setenv("MAOMAPS_THREADS", threads)
        again = pair_errors(c, T_est, T_gt, device)
        assert again[0].tobytes() == absolute.tobytes() and again[1].tobytes() == relative.tobytes()


def test_equal_points_seen_from_equal_poses_are_exactly_zero_apart(device):
    rng = np.random.default_rng(1)
    c = _correspondences(rng, 1000, 20, 100, 1e4)
    same = replace(c, gt_points=c.est_points, gt_index=c.est_index)
    T = _poses(rng, 20, 1e4)
    for errors in pair_errors(same, T, T, device):
        assert not errors.any()
