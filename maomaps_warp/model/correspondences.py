"""What each predicted map element was associated with."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class ElementClass(IntEnum):
    """The one class in which every predicted element ends."""

    ASSOCIATED = 0
    OUT_OF_VIEW = 1
    OCCLUDED = 2
    NO_GROUND_TRUTH = 3


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Pairs of predicted and ground-truth points along transferred rays, and the class of every element.

    A correspondence is kept as indices; the points follow from the arrays they index.

    Attributes:
        elements: (N, 3) float64, predicted elements (voxel centres, or OctoMap leaves), metres, aligned world.
        classes: (N,) uint8, an ElementClass each.
        element: (M,) int32, the element of each correspondence, ascending.
        pose: (M,) int32, the matched pose pair that saw it.
        est_points: (M', 3) float64 points that `est_index` points into: the estimate's side, m* in the paper.
        est_index: (M,) int32.
        gt_points: (M'', 3) float64 points that `gt_index` points into: the ground truth's side, m in the paper.
        gt_index: (M,) int32.
    """

    elements: NDArray[np.float64]
    classes: NDArray[np.uint8]
    element: NDArray[np.int32]
    pose: NDArray[np.int32]
    est_points: NDArray[np.float64]
    est_index: NDArray[np.int32]
    gt_points: NDArray[np.float64]
    gt_index: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.element)

    @property
    def counts(self) -> dict[str, int]:
        """Elements in all and by class; the classes add up to the total."""
        by_class = {c.name.lower(): int(np.count_nonzero(self.classes == c)) for c in ElementClass}
        return {"total": len(self.classes), **by_class}

    def est(self) -> NDArray[np.float64]:
        """The estimate's points of the correspondences, (M, 3) float64, metres, aligned world."""
        return self.est_points[self.est_index]

    def gt(self) -> NDArray[np.float64]:
        """The ground truth's points of the correspondences, (M, 3) float64, metres, world."""
        return self.gt_points[self.gt_index]

    def absolute_errors(self) -> NDArray[np.float64]:
        """|m* - m| in the world, (M,) float64, metres; `scoring.pair_errors` has the relative ones too."""
        return np.asarray(np.linalg.norm(self.est() - self.gt(), axis=1))


def in_camera(T_world_camera: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points, (N, 3) float64 world, each in the frame of its own camera, (N, 4, 4): (N, 3) float64, metres."""
    moved = points - T_world_camera[:, :3, 3]
    return np.asarray(np.einsum("nji,nj->ni", T_world_camera[:, :3, :3], moved))
