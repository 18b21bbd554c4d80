"""What scoring a merge of maps finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.occupancy_results import OccupancyScore
from maomaps_warp.model.results import NoValue
from maomaps_warp.model.statistics import Statistics

#: How the merged map comes into the ground truth's world.
MergeAlign = Literal["none", "first", "best"]


@dataclass(frozen=True)
class SuccessRule:
    """When a merge counts as a success.

    Attributes:
        max_m, max_rad: a source is placed well if its transform error is at most this, metres and radians.
        max_ame: the merged map's mean AME must be at most this too, metres; None: it does not matter.
    """

    max_m: float = 1.0
    max_rad: float = float(np.radians(10.0))
    max_ame: float | None = None


@dataclass(frozen=True)
class TransformError:
    """How far a merge puts a source from where it lies relative to the reference source.

    Attributes:
        translation: metres.
        rotation: radians.
        is_planar: only x, y and yaw were compared, for the merge says nothing of the rest.
    """

    translation: float
    rotation: float
    is_planar: bool


@dataclass(frozen=True)
class SourceScore:
    """One map that went into a merge.

    Attributes:
        name: its file, or its run where there is none.
        run: the run of the sample that it is of.
        is_merged: the merge gave it a transform; None: it gave no transforms at all.
        is_reference: the others' transforms are compared relative to it; it has no error of its own.
        error: against the reference source.
        is_success: placed within the rule's limits; None: cannot be told.
        ame_alone: distances of its points, put where the run truly began, to the run's own ground truth, metres.
        ame_merged: the same, put where the merge puts it.
    """

    name: str
    run: str
    is_merged: bool | None
    is_reference: bool
    error: TransformError | NoValue
    is_success: bool | None
    ame_alone: Statistics | NoValue
    ame_merged: Statistics | NoValue


@dataclass(frozen=True)
class DoubledWalls:
    """Predicted voxels with a second predicted surface where the ground truth has one.

    `in_overlap` = `decided` + `undecided` + `gt_has_more` + `gt_has_none`.

    Attributes:
        distance: how far the line reaches to both sides of the voxel, metres.
        in_overlap: predicted voxels whose nearest ground-truth voxel at least two runs have seen.
        decided: of these, those where the ground truth has exactly one surface on the line.
        doubled: of the decided, those where the prediction has at least two.
        undecided: the ground truth is not planar there, so there is no normal.
        gt_has_more, gt_has_none: the ground truth has several surfaces on the line, or none.
    """

    distance: float
    in_overlap: int
    decided: int
    doubled: int
    undecided: int
    gt_has_more: int
    gt_has_none: int

    @property
    def share(self) -> float | None:
        """doubled / decided; None if nothing was decided."""
        return self.doubled / self.decided if self.decided else None


@dataclass(frozen=True)
class MergedMapScore:
    """AME of a merged map by nearest neighbour.

    Attributes:
        accuracy: distances from every point of the merged map to the merged ground truth, metres.
        completeness: distances from every point of the merged ground truth to the merged map, metres.
        inside, outside: accuracy of the points whose nearest ground-truth element at least two runs have seen, and of
            the others.
        doubled: doubled walls in the overlap.
        counts: points of both maps, inside and outside; ground-truth elements by how many runs have seen them.
    """

    accuracy: Statistics
    completeness: Statistics
    inside: Statistics | NoValue
    outside: Statistics | NoValue
    doubled: DoubledWalls | NoValue
    counts: dict[str, int]


@dataclass(frozen=True)
class BestFit:
    """What moving the merged map by the best rigid transform hides.

    Attributes:
        ame_before: mean AME of the merged map where its transforms (or the first source's start) put it, metres.
        ame_after: mean AME where the best rigid transform puts it, metres.
        translation, rotation: size of that further transform, metres (of the merged map's middle) and radians.
    """

    ame_before: float
    ame_after: float
    translation: float
    rotation: float

    @property
    def hidden(self) -> float:
        """Metres of mean AME that the fit takes away."""
        return self.ame_before - self.ame_after


@dataclass(frozen=True, eq=False)
class MergePlacement:
    """How the merged map came into the ground truth's world.

    Attributes:
        method: as asked for.
        T_gt_merged: (4, 4) float64, metres.
        fit: of "best"; else None.
    """

    method: MergeAlign
    T_gt_merged: NDArray[np.float64]
    fit: BestFit | None = None


@dataclass(frozen=True)
class Apart:
    """The same maps without the merge.

    Attributes:
        sources_mean: mean of the sources' own mean AMEs, metres.
        unmoved: mean AME of the sources laid on one another with identities for transforms, metres.
    """

    sources_mean: float
    unmoved: float


@dataclass(frozen=True, eq=False)
class MergeScore:
    """The result of scoring one merge.

    Attributes:
        sample: the sample directory.
        pair, method: names for tables: what was merged, and by what.
        merged_map: what the merged map is ("union of 2 sources", a file).
        voxel_size: metres.
        rule: when it counts as a success.
        is_success: every source is merged and within the rule; None: cannot be told.
        verdict: why, one sentence.
        placement: how the merged map came into the ground truth's world; None if there is no merged map.
        sources: the maps that were merged, in the order of the runs.
        ame: of the merged map, or why there is none.
        ame_2d: of a merged occupancy grid, or why there is none.
        apart: the sources without the merge, or why that is not known.
        device: Warp device.
        milliseconds: wall time of each stage.
        notes: what a reader of the score should know.
    """

    sample: str
    pair: str
    method: str
    merged_map: str
    voxel_size: float
    rule: SuccessRule
    is_success: bool | None
    verdict: str
    placement: MergePlacement | None
    sources: tuple[SourceScore, ...]
    ame: MergedMapScore | NoValue
    ame_2d: OccupancyScore | NoValue
    apart: Apart | NoValue
    device: str
    milliseconds: dict[str, float]
    notes: tuple[str, ...]

    @property
    def failures(self) -> tuple[str, ...]:
        """Why there is no AME at all; empty if there is one."""
        in_plane = self.ame_2d if isinstance(self.ame_2d, NoValue) else self.ame_2d.ame
        missing = [metric for metric in (self.ame, in_plane) if isinstance(metric, NoValue)]
        return tuple(metric.reason for metric in missing if metric.asked) if len(missing) == 2 else ()
