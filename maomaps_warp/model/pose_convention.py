"""What recorded poses may mean, and how each meaning becomes camera poses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Axes = Literal["optical", "body", "opengl"]

#: (4, 4) float64. Optical-frame coordinates (x right, y down, z forward) to body-frame coordinates (x
#: forward, y left, z up), the same origin.
T_BODY_CAMERA: NDArray[np.float64] = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
T_BODY_CAMERA.setflags(write=False)

_T_AXES_CAMERA: dict[Axes, NDArray[np.float64]] = {
    "optical": np.eye(4),
    "body": T_BODY_CAMERA,
    "opengl": np.diag([1.0, -1.0, -1.0, 1.0]),
}
#: (x, y, z) of a world with z up to one with y up.
_Y_UP_FROM_Z_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
_AXES_MEANINGS: dict[Axes, str] = {
    "optical": "of the camera (x right, y down, z forward)",
    "body": "of the robot's body (x forward, y left, z up)",
    "opengl": "of an OpenGL camera (x right, y up, z backward)",
}

#: Yaw corrections of the twenty samples of the MAOMaps data set, radians.
SAMPLE_YAW_CORRECTIONS: dict[str, float] = {
    f"sample{number}": correction
    for correction, numbers in (
        (-0.45, range(1, 5)),
        (1.51, range(5, 9)),
        (-0.37, range(9, 12)),
        (0.06, range(12, 13)),
        (0.07, range(13, 21)),
    )
    for number in numbers
}


@dataclass(frozen=True)
class PoseConvention:
    """How a source's poses are to be read.

    Attributes:
        name: what `--pose-frame` calls it.
        axes: the frame whose pose is recorded; it shares the camera's origin.
        is_inverse: the pose takes the world to that frame, not that frame to the world.
        order: which of the recorded quaternion's fields x, y, z, w hold the real x, y, z and w: "xyzw" if each its
            own, "yzwx" if w was written first, "xzyw" if y and z were exchanged.
        yaw: radians, added to the heading (a rotation about the world's z at the camera's place).
    """

    name: str
    axes: Axes = "optical"
    is_inverse: bool = False
    order: str = "xyzw"
    yaw: float = 0.0

    @property
    def meaning(self) -> str:
        """In words."""
        direction = "world-to-frame poses" if self.is_inverse else "poses"
        quaternion = {"xyzw": "", "yzwx": ", quaternions w first", "xzyw": ", y and z of the quaternions exchanged"}
        turned = f", {self.yaw:+.4g} rad of yaw" if self.yaw else ""
        return f"{direction} {_AXES_MEANINGS[self.axes]}{quaternion[self.order]}{turned}"

    def camera_poses(self, recorded: NDArray[np.float64]) -> NDArray[np.float64]:
        """T_world_camera, (N, 4, 4) float64, of recorded poses, (N, 4, 4) float64 read as x y z w, metres."""
        T = recorded
        if self.order != "xyzw" and len(T):
            from scipy.spatial.transform import Rotation

            fields = Rotation.from_matrix(T[:, :3, :3]).as_quat()
            T = T.copy()
            T[:, :3, :3] = Rotation.from_quat(fields[:, ["xyzw".index(c) for c in self.order]]).as_matrix()
        if self.is_inverse:
            T = inverse_poses(T)
        if self.axes != "optical":
            T = T @ _T_AXES_CAMERA[self.axes]
        if self.yaw:
            c, s = math.cos(self.yaw), math.sin(self.yaw)
            T = T.copy()
            T[:, :3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ T[:, :3, :3]
        return T


def inverse_poses(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverses of rigid transforms, (N, 4, 4) float64."""
    inverse = np.zeros_like(T)
    R = np.swapaxes(T[:, :3, :3], 1, 2)
    inverse[:, :3, :3] = R
    inverse[:, :3, 3] = -np.einsum("nij,nj->ni", R, T[:, :3, 3])
    inverse[:, 3, 3] = 1.0
    return inverse


def y_up_opengl_poses(T_world_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same poses as Habitat and other worlds with y up and OpenGL's cameras state them.

    Args:
        T_world_camera: (..., 4, 4) float64, metres: an optical frame (x right, y down, z forward) in a world with z up.

    Returns:
        (..., 4, 4): a camera with x right, y up, z backward in a world with y up: (x, y, z) becomes (x, z, -y), as
        scenes in glTF are turned the other way when they are read.
    """
    return _Y_UP_FROM_Z_UP @ T_world_camera @ _T_AXES_CAMERA["opengl"]


def _all_conventions() -> dict[str, PoseConvention]:
    axes: tuple[Axes, ...] = ("optical", "body", "opengl")
    found = {}
    for order, is_inverse, frame in product(("xyzw", "yzwx"), (False, True), axes):
        name = frame + "-inverse" * is_inverse + "-wxyz" * (order == "yzwx")
        found[name] = PoseConvention(name, frame, is_inverse, order)
    # The three orientations of MAOMaps bags: the raw Habitat quaternion with y and z exchanged and half a turn added;
    # the same turn over a quaternion about z; a plain ROS yaw.
    found["maomaps-a"] = PoseConvention("maomaps-a", "body", order="xzyw", yaw=math.pi)
    found["maomaps-b"] = PoseConvention("maomaps-b", "body", yaw=math.pi)
    found["maomaps-c"] = PoseConvention("maomaps-c", "body")
    return found


#: Every convention by name.
CONVENTIONS: dict[str, PoseConvention] = _all_conventions()


def parse_convention(text: str) -> PoseConvention:
    """The convention that `text` names: a key of CONVENTIONS, perhaps with ":" and a yaw correction.

    The correction is a number of radians, or "sample1" to "sample20" of MAOMaps ("maomaps-a:sample7").

    Raises:
        ValueError: no such convention or correction; says what is allowed.
    """
    name, colon, correction = text.partition(":")
    if name not in CONVENTIONS:
        raise ValueError(f"is no pose convention; allowed: {', '.join(CONVENTIONS)}")
    convention = CONVENTIONS[name]
    if not colon:
        return convention
    yaw = parse_yaw_correction(correction)
    return PoseConvention(text, convention.axes, convention.is_inverse, convention.order, convention.yaw + yaw)


def parse_yaw_correction(text: str) -> float:
    """Radians: a number, or "sample1" to "sample20" of the MAOMaps data set.

    Raises:
        ValueError: neither.
    """
    if text in SAMPLE_YAW_CORRECTIONS:
        return SAMPLE_YAW_CORRECTIONS[text]
    try:
        yaw = float(text)
    except ValueError:
        yaw = math.nan
    if not abs(yaw) <= 100.0:
        raise ValueError("must be a number of radians, or sample1 to sample20 of MAOMaps")
    return yaw
