"""Finding the transform from the estimate's world to the ground truth's, from paired poses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.model.alignment import Alignment
from maomaps_warp.protocol import AlignMethod

#: A path is static if the root mean square distance of its positions to their mean is below this, metres,
#: plus the same share of its largest coordinate (so that rounding does not make a far one look alive).
STATIC_SPREAD = 1e-9

#: A rotation is undetermined if the second singular value of the cross-covariance is below this share of the
#: first (for a yaw: the planar moment, of the product of the spreads). Singular values go with the square of
#: lengths, so a path must spread across its main direction by 1/1000 of its spread along it.
RANK_TOLERANCE = 1e-6

ROTATION_WAY_OUT = "--align yaw, or --align origin"


def align(
    method: AlignMethod,
    T_world_camera_gt: NDArray[np.float64],
    T_world_camera_est: NDArray[np.float64],
    *,
    yaw_correction: float = 0.0,
    start_pose: tuple[float, float, float, float] | None = None,
) -> Alignment:
    """Find the transform that moves the estimate onto the ground truth.

    - `none`: the identity, applied to nothing.
    - `origin`: the first pair's poses become equal: T_gt0 T_est0^-1.
    - `start-pose`: the rule of MAOMaps; see `_start_pose`. Both worlds must have z up.
    - `yaw`: the least-squares rotation about z and translation of the positions. Both worlds must have z up.
    - `se3`: the least-squares rotation and translation of the positions; `sim3`: with scale. S. Umeyama,
      "Least-squares estimation of transformation parameters between two point patterns", PAMI 13(4), 1991,
      eqs. 40 to 42, with its guard against reflections.

    Args:
        method: one of the above.
        T_world_camera_gt: (M, 4, 4) float64, metres: ground-truth poses.
        T_world_camera_est: (M, 4, 4) float64: the estimated poses paired with them.
        yaw_correction: radians, added to the yaw of `start-pose`; the other methods do not use it.
        start_pose: x, y, z (metres) and yaw (radians) as a MAOMaps `start_pose_*.txt` holds them; without it
            `start-pose` takes the first pair's ground-truth pose. The other methods do not use it.

    Raises:
        InputError: no pair, or a path that does not determine the transform; the message names a way out.
        ValueError: arrays of the wrong shape, or an unknown method.
    """
    gt, est = T_world_camera_gt, T_world_camera_est
    if gt.ndim != 3 or gt.shape[1:] != (4, 4) or gt.shape != est.shape:
        raise ValueError(f"poses must be two arrays (M, 4, 4), got {gt.shape} and {est.shape}")
    if method == "none":
        return Alignment()
    if method == "start-pose" and start_pose is not None:
        return _start_pose(start_pose, yaw_correction)
    if not len(gt):
        raise _refusal(method, "there is no pair of poses", "--align none")
    if method == "start-pose":
        return _start_at_first_pose(gt[0], yaw_correction)
    if method == "origin":
        return _origin(gt[0], est[0])
    if method == "yaw":
        return _yaw(gt[:, :3, 3], est[:, :3, 3])
    if method in ("se3", "sim3"):
        return _umeyama(method, gt[:, :3, 3], est[:, :3, 3])
    raise ValueError(f"unknown alignment method {method!r}")


def _start_pose(start_pose: tuple[float, float, float, float], yaw_correction: float) -> Alignment:
    """MAOMaps: rotate about z by (yaw + pi + correction), then add the start position.

    The estimate's world is that of a robot at start: x ahead, y left, z up, zero at the camera; its first
    pose is taken for the identity and not looked at. The yaw in the file is that of the raw Habitat
    orientation, whose camera looks the other way: the heading in the world is yaw + pi. The correction mends
    the yaw of single samples of the data set (-0.45 for samples 1 to 4 and so on).
    """
    x, y, z, yaw = start_pose
    return _planar("start-pose", yaw + math.pi + yaw_correction, np.array([x, y, z]), pairs=0)


def _start_at_first_pose(T_world_camera: NDArray[np.float64], yaw_correction: float) -> Alignment:
    """The same rule with the start taken from the first matched ground-truth pose.

    A camera pose says directly where the camera looks (its optical axis, projected to the ground), so that
    heading stands for yaw + pi and no pi is added. The estimate's world must begin at that very pose.
    """
    ahead = T_world_camera[:3, 2]
    if math.hypot(ahead[0], ahead[1]) < 1e-3:  # within 0.06 degrees of the vertical the heading is noise
        raise _refusal("start-pose", "the first ground-truth camera looks straight up or down", "--align origin")
    heading = math.atan2(ahead[1], ahead[0])
    return _planar("start-pose", heading + yaw_correction, T_world_camera[:3, 3], pairs=1)


def _origin(T_gt: NDArray[np.float64], T_est: NDArray[np.float64]) -> Alignment:
    T = np.eye(4)
    T[:3, :3] = T_gt[:3, :3] @ T_est[:3, :3].T
    T[:3, 3] = T_gt[:3, 3] - T[:3, :3] @ T_est[:3, 3]
    return Alignment("origin", T, pairs=1)


def _yaw(gt: NDArray[np.float64], est: NDArray[np.float64]) -> Alignment:
    """The angle that maximises sum(gt . Rz est): atan2 of the planar cross and dot moments."""
    _refuse_static("yaw", gt, est, "--align origin")
    center_gt, center_est = gt.mean(axis=0), est.mean(axis=0)
    g, e = gt - center_gt, est - center_est
    dot = float((e[:, :2] * g[:, :2]).sum())
    cross = float((e[:, 0] * g[:, 1] - e[:, 1] * g[:, 0]).sum())
    if math.hypot(dot, cross) / len(gt) <= RANK_TOLERANCE * _spread(g) * _spread(e):
        raise _refusal("yaw", "a path is vertical, or the paths have nothing in common", "--align origin")
    angle = math.atan2(cross, dot)
    return _planar("yaw", angle, center_gt - _rotation_z(angle) @ center_est, pairs=len(gt))


def _umeyama(method: AlignMethod, gt: NDArray[np.float64], est: NDArray[np.float64]) -> Alignment:
    if len(gt) < 3:
        raise _refusal(method, f"{len(gt)} paired poses do not determine a rotation; it takes 3", ROTATION_WAY_OUT)
    _refuse_static(method, gt, est, ROTATION_WAY_OUT)
    center_gt, center_est = gt.mean(axis=0), est.mean(axis=0)
    g, e = gt - center_gt, est - center_est
    U, D, Vt = np.linalg.svd(g.T @ e / len(gt))
    if D[0] <= RANK_TOLERANCE * _spread(g) * _spread(e) or D[1] <= RANK_TOLERANCE * D[0]:
        found = "a path is a straight line, so the rotation about it is undetermined"
        raise _refusal(method, found, ROTATION_WAY_OUT)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    scale = float((D * signs).sum() / _spread(e) ** 2) if method == "sim3" else 1.0
    T = np.eye(4)
    T[:3, :3] = (U * signs) @ Vt
    T[:3, 3] = center_gt - scale * T[:3, :3] @ center_est
    return Alignment(method, T, scale, pairs=len(gt))


def _planar(method: AlignMethod, angle: float, t: NDArray[np.float64], pairs: int) -> Alignment:
    T = np.eye(4)
    T[:3, :3] = _rotation_z(angle)
    T[:3, 3] = t
    return Alignment(method, T, pairs=pairs)


def _rotation_z(angle: float) -> NDArray[np.float64]:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _spread(centered: NDArray[np.float64]) -> float:
    """Root mean square length of `centered`, (N, 3)."""
    return float(np.sqrt((centered * centered).sum() / len(centered)))


def _refuse_static(method: AlignMethod, gt: NDArray[np.float64], est: NDArray[np.float64], way_out: str) -> None:
    for name, path in (("ground truth", gt), ("estimate", est)):
        if _spread(path - path.mean(axis=0)) <= STATIC_SPREAD * (1.0 + float(np.abs(path).max())):
            raise _refusal(method, f"the path of the {name} does not leave its place", way_out)


def _refusal(method: AlignMethod, found: str, way_out: str) -> InputError:
    return InputError(f"--align {method}", found, f"use {way_out}")
