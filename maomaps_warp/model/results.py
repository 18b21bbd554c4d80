"""What scoring finds: one dataclass a metric, each with its support."""

from __future__ import annotations

from dataclasses import dataclass, field

from maomaps_warp.model.alignment import Alignment
from maomaps_warp.model.statistics import Statistics
from maomaps_warp.protocol import Protocol


@dataclass(frozen=True)
class NoValue:
    """A metric without a number.

    Attributes:
        reason: why, one sentence.
        asked: the input should have given one, so the command fails; False: it was never to be had (no map given).
        counts: what became of the data, where that is known.
    """

    reason: str
    asked: bool
    counts: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class PoseErrors:
    """Errors of paired poses: translation in metres, rotation in radians."""

    translation: Statistics
    rotation: Statistics


@dataclass(frozen=True)
class TrajectoryScore:
    """Absolute or relative trajectory errors.

    Attributes:
        errors: by kind: "absolute"; or "frames", "metres" and "seconds" for the steps of the relative error.
        counts: poses of the estimate, matched, unmatched; for the relative error the pairs of each kind.
    """

    errors: dict[str, PoseErrors]
    counts: dict[str, int]


@dataclass(frozen=True)
class ThresholdScore:
    """Shares within one distance; Tanks and Temples' definitions (strictly below the threshold).

    Attributes:
        threshold: metres.
        precision: share of the estimate's points nearer to the ground truth.
        recall: share of the ground truth's points nearer to the estimate.
        f_score: their harmonic mean; 0 if both are 0.
    """

    threshold: float
    precision: float
    recall: float
    f_score: float


@dataclass(frozen=True)
class VoxelOverlap:
    """Cells that both maps occupy.

    Attributes:
        est, gt: occupied cells of each map.
        common: cells occupied in both.
        iou: common / (est + gt - common).
    """

    est: int
    gt: int
    common: int
    iou: float


@dataclass(frozen=True)
class NearestScore:
    """AME by nearest neighbour.

    Attributes:
        accuracy: distances from every estimated point to the ground truth, metres.
        completeness: distances from every ground-truth point to the estimate, metres.
        thresholds: precision, recall and F at each threshold.
        overlap: occupied voxels of both maps.
        counts: points of both maps and what was dropped.
    """

    accuracy: Statistics
    completeness: Statistics
    thresholds: tuple[ThresholdScore, ...]
    overlap: VoxelOverlap
    counts: dict[str, int]


@dataclass(frozen=True)
class RayScore:
    """AME by association along transferred camera rays.

    Attributes:
        absolute: distances in the world, metres: drift and reconstruction.
        relative: distances between the points in their own cameras' frames, metres: reconstruction alone.
        counts: `total` elements and their classes, which add up to it; `correspondences`; `poses`.
    """

    absolute: Statistics
    relative: Statistics
    counts: dict[str, int]


@dataclass(frozen=True)
class InputSummary:
    """What was scored.

    Attributes:
        name: what the user gave.
        kind: what it was recognised as.
        facts: sizes: poses, path length, duration, map points, voxels, frames.
        notes: what readers dropped or decided.
    """

    name: str
    kind: str
    facts: dict[str, float | int | str]
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Score:
    """The result of scoring one run.

    Attributes:
        protocol: the effective protocol.
        camera: the camera used for visibility, and where it came from; empty if none was needed.
        pairing: how poses were paired ("interpolate", "nearest" or "index") and the largest gap, seconds; None
            without pairs.
        alignment: the transform of the estimate; None if it could not be found for want of paired poses.
        ate, rpe, ame_nn, ame_ray: the metrics, or why there is none.
        gt, est: the inputs.
        device: Warp device, or "none" if nothing ran on one.
        milliseconds: wall time of each stage.
        notes: what a reader of the score should know.
    """

    protocol: Protocol
    camera: str
    pairing: tuple[str, float] | None
    alignment: Alignment | None
    ate: TrajectoryScore | NoValue
    rpe: TrajectoryScore | NoValue
    ame_nn: NearestScore | NoValue
    ame_ray: RayScore | NoValue
    gt: InputSummary
    est: InputSummary
    device: str
    milliseconds: dict[str, float]
    notes: tuple[str, ...]

    @property
    def failures(self) -> tuple[str, ...]:
        """Reasons of the metrics that the input should have given and that have no number."""
        metrics = (self.ate, self.rpe, self.ame_nn, self.ame_ray)
        return tuple(dict.fromkeys(m.reason for m in metrics if isinstance(m, NoValue) and m.asked))
