"""Rotations as files write them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError

#: A quaternion's norm may differ from 1 by this much (dimensionless): text of three decimals rounds it by
#: 0.001, while wrong columns or a wrong order of columns are far off.
QUATERNION_NORM_TOLERANCE = 0.01

#: Largest entry of |R^T R - I| of a rotation matrix, dimensionless. Text of four decimals moves it by 2e-4,
#: of six to nine digits by far less; a similarity's scale or wrong columns move it by more.
ORTHONORMALITY_TOLERANCE = 1e-3


def checked_quaternions(xyzw: NDArray[np.float64], where_of: Callable[[int], str]) -> NDArray[np.float64]:
    """Unit quaternions of what a file holds.

    Args:
        xyzw: (N, 4) float64.
        where_of: the place of row i, for the message.

    Returns:
        (N, 4) float64 xyzw, norm 1.

    Raises:
        InputError: a quaternion is not finite, zero, or its norm is off by more than
            QUATERNION_NORM_TOLERANCE.
    """
    norms = np.linalg.norm(xyzw, axis=1)
    bad = np.flatnonzero(~(np.abs(norms - 1.0) <= QUATERNION_NORM_TOLERANCE))
    if len(bad):
        row = int(bad[0])
        text = " ".join(f"{value:.6g}" for value in xyzw[row])
        found = f"quaternion (x y z w) {text} has norm {norms[row]:.6g}, not 1"
        more = f"; {len(bad)} of {len(xyzw)} rows are so" if len(bad) > 1 else ""
        raise InputError(where_of(row), found + more, "remove such rows, or check the order of the columns")
    return np.asarray(xyzw / norms[:, None])


def checked_rotations(matrices: NDArray[np.float64], where_of: Callable[[int], str]) -> NDArray[np.float64]:
    """The rotations nearest to what a file holds: U V^T of the singular value decomposition U S V^T.

    Args:
        matrices: (N, 3, 3) float64, finite.
        where_of: the place of matrix i, for the message.

    Returns:
        (N, 3, 3) float64, orthonormal, determinant 1.

    Raises:
        InputError: a matrix is mirrored, or |R^T R - I| exceeds ORTHONORMALITY_TOLERANCE.
    """
    defect = np.abs(np.swapaxes(matrices, 1, 2) @ matrices - np.eye(3)).max(axis=(1, 2))
    mirrored = np.linalg.det(matrices) < 0
    bad = np.flatnonzero((defect > ORTHONORMALITY_TOLERANCE) | mirrored)
    if len(bad):
        row = int(bad[0])
        found = "a mirrored matrix (determinant -1)" if mirrored[row] and defect[row] <= 0.1 else "no rotation matrix"
        more = f"; {len(bad)} of {len(matrices)} rows are so" if len(bad) > 1 else ""
        detail = f" (|R^T R - I| up to {defect[row]:.2g}, {ORTHONORMALITY_TOLERANCE:g} is allowed)"
        raise InputError(where_of(row), found + detail + more, "poses are rigid and right-handed")
    U, _, Vt = np.linalg.svd(matrices)
    return np.asarray(U @ Vt)


def matrices_from_quaternions(xyzw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices, (N, 3, 3) float64, of quaternions, (N, 4) float64 xyzw, none of them zero."""
    from scipy.spatial.transform import Rotation

    if not len(xyzw):
        return np.empty((0, 3, 3))
    return np.asarray(Rotation.from_quat(xyzw).as_matrix(), np.float64)


def quaternions_from_matrices(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions, (N, 4) float64 xyzw with w >= 0, of rotation matrices, (N, 3, 3) float64."""
    from scipy.spatial.transform import Rotation

    if not len(rotations):
        return np.empty((0, 4))
    return np.asarray(Rotation.from_matrix(rotations).as_quat(canonical=True), np.float64)


def matrices_from_rpy(
    roll: NDArray[np.float64], pitch: NDArray[np.float64], yaw: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Rz(yaw) Ry(pitch) Rx(roll), (N, 3, 3) float64, of angles, each (N,) float64, radians."""
    (cr, cp, cy), (sr, sp, sy) = (f(np.stack([roll, pitch, yaw])) for f in (np.cos, np.sin))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def rpy_from_matrices(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Roll, pitch, yaw, (N, 3) float64, radians, of rotations Rz(yaw) Ry(pitch) Rx(roll), (N, 3, 3) float64.

    At a pitch of +-90 degrees only the difference of yaw and roll is defined. Roll is therefore read after
    yaw was undone, which makes the three angles give the rotation back at every pitch.
    """
    R = rotations
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-R[:, 2, 0], c * R[:, 0, 0] + s * R[:, 1, 0])
    roll = np.arctan2(s * R[:, 0, 2] - c * R[:, 1, 2], c * R[:, 1, 1] - s * R[:, 0, 1])
    return np.stack([roll, pitch, yaw], axis=1)


def poses(positions: NDArray[np.float64], rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rigid transforms, (N, 4, 4) float64, of positions, (N, 3) metres, and rotations, (N, 3, 3)."""
    T = np.zeros((len(positions), 4, 4))
    T[:, :3, :3] = rotations
    T[:, :3, 3] = positions
    T[:, 3, 3] = 1.0
    return T
