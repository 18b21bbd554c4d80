"""The yaw correction of MAOMaps orientations, found by search."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.checking.reprojection import search_costs
from maomaps_warp.checking.sampling import FrameSample
from maomaps_warp.model.pose_convention import CONVENTIONS, SAMPLE_YAW_CORRECTIONS, PoseConvention, parse_convention

F64 = NDArray[np.float64]

#: The search: this many yaws around the circle, then steps of FINE_STEP_RAD around the best of them.
COARSE_STEPS = 72
FINE_STEP_RAD = 0.005
#: Every n-th pixel is enough to search with.
SEARCH_STRIDE = 3
#: A yaw found is taken for a published one this near, radians.
PUBLISHED_WITHIN_RAD = 0.03
#: A recording turns about one axis if the quaternions' other two components stay below this (2 degrees).
OFF_AXIS = 0.02
#: How often the pairs are drawn anew to see how far the yaw found scatters; fixed seed.
DRAWS = 200


@dataclass(frozen=True)
class YawSearch:
    """What the search found.

    Attributes:
        convention: with the yaw found, or with the published one that it is taken for.
        found_rad: the yaw as found, (-pi, pi], in place of that of the convention searched with.
        spread_rad: nineteen in twenty draws of the pairs give a yaw within this distance of it.
    """

    convention: PoseConvention
    found_rad: float
    spread_rad: float


def search_yaw(sample: FrameSample, pairs: NDArray[np.int64], T_world_camera: F64, names: tuple[str, ...]) -> YawSearch:
    """The yaw under which the pairs agree best.

    Args:
        sample: the frames.
        pairs: (P, 2) int64.
        T_world_camera: (N, 4, 4) float64, poses of the frames without any yaw.
        names: conventions that differ by their yaw alone, the plainest first: what the result is named by.
    """

    def costs(yaws: F64) -> F64:
        return search_costs(sample, pairs, turned(T_world_camera, yaws), pixel_stride=SEARCH_STRIDE)

    coarse = np.linspace(-math.pi, math.pi, COARSE_STEPS, endpoint=False)
    coarse_costs = costs(coarse)
    step = 2.0 * math.pi / COARSE_STEPS
    fine = coarse[int(np.argmin(coarse_costs.mean(axis=1)))] + np.arange(-step, step, FINE_STEP_RAD)
    yaws, cost = np.concatenate([coarse, fine]), np.concatenate([coarse_costs, costs(fine)])
    found = float(_wrapped(yaws[int(np.argmin(cost.mean(axis=1)))]))
    weights = np.random.default_rng(0).multinomial(len(pairs), np.full(len(pairs), 1.0 / len(pairs)), size=DRAWS)
    scatter = np.abs(_wrapped(yaws[np.argmin(cost @ weights.T, axis=0)] - found))
    return YawSearch(_named(found, names), found, float(np.percentile(scatter, 95.0)))


def turns_about(T_recorded: F64, axis: str) -> bool:
    """Whether recorded poses, (N, 4, 4) float64, turn about their y or z axis alone, as those of MAOMaps do."""
    from scipy.spatial.transform import Rotation

    xyzw = Rotation.from_matrix(T_recorded[:, :3, :3]).as_quat()
    others = [k for k, name in enumerate("xyz") if name != axis]
    return bool(np.abs(xyzw[:, others]).max(initial=0.0) < OFF_AXIS)


def turned(T_world_camera: F64, yaws: F64) -> F64:
    """(Y, N, 4, 4) float64: poses (N, 4, 4) turned about the world's z, each at its place, by each of Y yaws."""
    return np.stack([replace(PoseConvention(""), yaw=float(yaw)).camera_poses(T_world_camera) for yaw in yaws])


def _wrapped(angle: F64) -> F64:
    """Angles in (-pi, pi]."""
    return np.asarray(math.pi - np.mod(math.pi - angle, 2.0 * math.pi))


def _named(yaw: float, names: tuple[str, ...]) -> PoseConvention:
    """The nearest of the plain conventions and of those with a published correction, else one with the yaw found."""
    published: dict[float, str] = {}
    for sample, correction in SAMPLE_YAW_CORRECTIONS.items():
        published.setdefault(correction, sample)
    of_maomaps = [name for name in reversed(names) if name.startswith("maomaps")]
    texts = [*names, *(f"{name}:{sample}" for name in of_maomaps for sample in published.values())]
    known = [parse_convention(text) for text in texts]
    away = [abs(float(_wrapped(np.array(convention.yaw - yaw)))) for convention in known]
    nearest = int(np.argmin(away))
    if away[nearest] <= PUBLISHED_WITHIN_RAD:
        return known[nearest]
    base = CONVENTIONS[names[-1]]
    return parse_convention(f"{base.name}:{float(_wrapped(np.array(yaw - base.yaw))):.3f}")
