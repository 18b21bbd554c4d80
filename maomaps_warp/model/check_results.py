"""What a check of one recording finds."""

from __future__ import annotations

from dataclasses import dataclass

from maomaps_warp.model.pose_convention import PoseConvention


@dataclass(frozen=True, eq=False)
class Candidate:
    """A convention and how well depth agrees under it, over the pairs of frames that overlap.

    Attributes:
        convention: the convention.
        equivalents: names of others that say the same of this recording.
        agreement: share of the pixels with depth that land on depth which agrees within 5 %, mean over the pairs.
        agreement_of_landed: the same of those that land on depth.
        landed: share of the pixels with depth that land on depth.
        residual_m, residual_share: median over the pairs of the median |difference| of the pixels that land, metres
            and relative to depth; NaN if none lands.
        ahead: share of the pairs in which the best candidate agrees better than this one; 0 for the best itself.
        pairs: how many pairs that is about.
        pixels: how many pixels with depth these have.
        yaw_found_rad, yaw_spread_rad: if its yaw was searched for: the best one and how far that scatters. An angle
            in place of the convention's own.
    """

    convention: PoseConvention
    equivalents: tuple[str, ...]
    agreement: float
    agreement_of_landed: float
    landed: float
    residual_m: float
    residual_share: float
    ahead: float
    pairs: int
    pixels: int
    yaw_found_rad: float | None = None
    yaw_spread_rad: float | None = None


@dataclass(frozen=True, eq=False)
class ConventionProof:
    """Which convention the recording fits.

    Attributes:
        candidates: all, the best first; equivalent ones are one candidate.
        best: the convention proved; None unless `is_clear`.
        is_clear: whether the rule of `checking.proof.RULE` holds.
        reason: in one sentence why it is clear or not.
        frames: how many frames with poses were looked at.
        frames_without_pose: how many of the thinned frames have none.
    """

    candidates: tuple[Candidate, ...]
    best: PoseConvention | None
    is_clear: bool
    reason: str
    frames: int = 0
    frames_without_pose: int = 0


@dataclass(frozen=True, eq=False)
class DepthUnit:
    """Depth of the frames looked at, and what fits it.

    Attributes:
        median_m, nearest_m, farthest_m: of the pixels with depth, in the declared unit turned to metres; NaN if none.
        missing: share of the pixels without depth.
        agreements: how well depth multiplied by each factor agrees, under the best convention for it.
        fits: whether the declared unit is proved right (True), another is (False), or it cannot be told (None).
        factor: what depth is to be multiplied by; 1 unless `fits` is False.
        reason: in one sentence.
    """

    median_m: float
    nearest_m: float
    farthest_m: float
    missing: float
    agreements: dict[float, float]
    fits: bool | None
    factor: float
    reason: str


@dataclass(frozen=True)
class StampFacts:
    """Stamps of one stream.

    Attributes:
        what: "depth", "colour", "poses".
        count: how many.
        first_ns, last_ns: nanoseconds.
        median_gap_s, largest_gap_s: seconds; 0 with fewer than two.
        largest_at_s: where the largest gap begins, seconds from the first.
        gaps: how many are larger than one and a half median ones.
        missing: how many messages would fill these.
    """

    what: str
    count: int
    first_ns: int
    last_ns: int
    median_gap_s: float
    largest_gap_s: float
    largest_at_s: float
    gaps: int
    missing: int

    @property
    def rate_hz(self) -> float:
        """One over the median gap; 0 if there is none."""
        return 1.0 / self.median_gap_s if self.median_gap_s > 0 else 0.0


@dataclass(frozen=True)
class Jump:
    """A step between consecutive poses that nothing drives.

    Attributes:
        index: of the pose after it, from 0.
        at_s: seconds from the first pose; None without stamps.
        step_m: its length.
        speed: metres a second; None without stamps.
    """

    index: int
    at_s: float | None
    step_m: float
    speed: float | None


@dataclass(frozen=True)
class UpAxis:
    """The world's up.

    Attributes:
        axis: the nearest of "+x", "-x", "+y", "-y", "+z", "-z".
        away_rad: angle from it to the cameras' mean up vector.
        agreement: length of the mean of their unit up vectors, 0 to 1.
        is_clear: whether that is near enough and they agree enough.
    """

    axis: str
    away_rad: float
    agreement: float
    is_clear: bool


@dataclass(frozen=True)
class ColorGaps:
    """Depth images and their colours.

    Attributes:
        median_s, largest_s: distance of a depth image's stamp to the nearest colour image's, seconds.
        without: how many depth images have none within the limit.
        limit_s: that limit, seconds.
    """

    median_s: float
    largest_s: float
    without: int
    limit_s: float


@dataclass(frozen=True, eq=False)
class RecordingCheck:
    """Everything about one recording.

    Attributes:
        name, kind: what was given, and what it was recognised as.
        camera: of the depth images.
        frames_source, poses_source: file or topic that each came from.
        declared: the convention that the poses were read under; a text for `parse_convention`.
        declared_by: "the user", "the source", or "nobody" if it is only what such sources usually mean.
        proof: what the poses mean.
        is_contradicted: the user declared a convention and another one is proved.
        depth_unit: what fits the depth.
        frames: how many depth frames there are.
        frames_without_pose: how many of them have no pose.
        stamps: rate and gaps of depth, colours and poses; those without stamps are left out.
        color_gaps: None if that is unknown.
        jumps: poses that jump.
        up: the world's up under the convention proved, else under the best one; None if there is none.
        findings: what will trouble other commands, one sentence each.
        notes: of the readers.
        rule: when a proof is clear.
        milliseconds: what each stage took.
    """

    name: str
    kind: str
    camera: str
    frames_source: str
    poses_source: str
    declared: str
    declared_by: str
    proof: ConventionProof
    is_contradicted: bool
    depth_unit: DepthUnit
    frames: int
    frames_without_pose: int
    stamps: tuple[StampFacts, ...]
    color_gaps: ColorGaps | None
    jumps: tuple[Jump, ...]
    up: UpAxis | None
    findings: tuple[str, ...]
    notes: tuple[str, ...]
    rule: str
    milliseconds: dict[str, float]
