"""Protocols: every constant and choice that moves a score, by name.

A protocol is part of every result. `docs/protocol.md` is the specification; this module is its executable half.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, Literal

from maomaps_warp.model.camera import Camera

AlignMethod = Literal["none", "origin", "start-pose", "yaw", "se3", "sim3"]
MatchMethod = Literal["interpolate", "nearest"]
PoseChoice = Literal["nearest", "first", "last", "all"]
Caster = Literal["voxels", "mesh"]
#: How the colours of a voxel's samples become one: their mean, rounded (halves up) or truncated to 8 bits.
ColorMean = Literal["rounded", "truncated"]
#: Of back-projection. float32: relative to the middle of the map, times the inverse of the voxel size; float64: in the
#: world, divided by it.
Arithmetic = Literal["float32", "float64"]

#: Largest gap where the protocol leaves it open, seconds: two ground-truth samples that enclose a stamp (5 Hz), and
#: evo's default for the nearest stamp.
DEFAULT_STAMP_GAP: dict[str, float] = {"interpolate": 0.2, "nearest": 0.01}

#: Of any number in a protocol: metres, seconds (317 years), frames.
LARGEST = 1e10


def constant(default: Any, unit: str, meaning: str, source: str) -> Any:
    """A field of a protocol with what has to be known about it."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "source": source})


#: Which depth samples become map points: of every protocol that maps recordings.
MIN_RANGE = (0.01, "m", "depth samples at this distance or nearer are no map points", "original gt_map_creator")
MAX_RANGE = (10.0, "m", "depth samples at this distance or farther are no map points", "original gt_map_creator")
PIXEL_STRIDE = (1, "pixels", "every n-th pixel of each row and column is back-projected", "original: every pixel")


def check_number(protocol: Any, name: str, *, above: float | None = None, least: float | None = None) -> None:
    """Refuse a field that is NaN, beyond all measure, not above `above` or below `least`.

    Raises:
        ValueError: with the field's name, its value and the limit.
    """
    value = getattr(protocol, name)
    if not abs(value) <= LARGEST and not (name == "view_range" and value == math.inf):
        raise ValueError(f"{name} = {value}: must be a number up to {LARGEST:g}")
    if (above is not None and not value > above) or (least is not None and not value >= least):
        limit = f"above {above:g}" if above is not None else f"at least {least:g}"
        raise ValueError(f"{name} = {value:g}: must be {limit}")


def check_camera(text: str) -> None:
    """Raise ValueError unless a protocol's field `camera` describes a camera."""
    try:
        camera = Camera.from_text(text)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"camera = {text!r}: {error}") from None
    if camera is None:
        raise ValueError(f"camera = {text!r}: must be WIDTHxHEIGHT@DEGREES or WIDTHxHEIGHT:fx,fy,cx,cy")


@dataclass(frozen=True)
class Protocol:
    """How a run is scored. Each field carries its unit, meaning and source in its metadata; see `explain`."""

    name: str = constant("maomaps", "", "name of the protocol", "")
    voxel_size: float = constant(0.05, "m", "edge of a voxel of both maps", "paper, section III-A: discretisation step")
    cells: Literal["rounded", "floored"] = constant(
        "rounded",
        "",
        "rounded: voxel k is centred on k * voxel_size, halves to even; floored: it starts there, and coordinates pass"
        " through float32",
        "rounded: the original ground-truth creator; floored: OctoMap in the original scorer",
    )
    prune_leaves: bool = constant(
        False,
        "",
        "full 2x2x2 blocks of the predicted map count as one element, repeatedly",
        "OctoMap in the original scorer; a defect elsewhere: thick walls weigh less",
    )
    min_range: float = constant(*MIN_RANGE)
    max_range: float = constant(*MAX_RANGE)
    pixel_stride: int = constant(*PIXEL_STRIDE)
    align: AlignMethod = constant(
        "none", "", "transform of the estimate found from the trajectories", "paper: none; field: evo"
    )
    yaw_correction: float = constant(
        0.0, "rad", "added to the yaw of align = start-pose", "MAOMaps: one a sample, see docs/protocol.md"
    )
    match: MatchMethod = constant(
        "interpolate",
        "",
        "pose of the ground truth at an estimate's stamp: lerp + slerp between neighbours, or the nearest sample",
        "interpolate: original compute_ate_rpe (without its Euler wrap); nearest: evo",
    )
    max_stamp_gap: float | None = constant(
        None,
        "s",
        "interpolate: largest distance of the two samples around a stamp; nearest: largest distance to the sample;"
        f" unset: {DEFAULT_STAMP_GAP['interpolate']} and {DEFAULT_STAMP_GAP['nearest']}",
        "nearest: evo's default",
    )
    t_offset: float = constant(0.0, "s", "added to the estimate's stamps", "evo")
    camera: str = constant(
        "320x240@90",
        "",
        "camera where the input states none: WIDTHxHEIGHT@horizontal degrees",
        "paper, Table I",
    )
    near: float = constant(
        0.01,
        "m",
        "an element is in front of the camera if it lies farther than this along the optical axis",
        "ours",
    )
    view_range: float = constant(
        math.inf, "m", "an element farther from the camera is out of view", "original scorer: no limit"
    )
    two_sided_view: bool = constant(
        False,
        "",
        "points in the mirrored cone BEHIND the camera count as visible",
        "original scorer tests x > 0 after dividing by x; a defect",
    )
    occlusion_tolerance: float = constant(
        0.5,
        "m",
        "the first predicted voxel on the ray must lie nearer to the element than this",
        "original scorer",
    )
    pose_choice: PoseChoice = constant(
        "nearest",
        "",
        "which of the poses that see an element casts its ray",
        "original scorer: nearest|first|last|all",
    )
    caster: Caster = constant(
        "voxels",
        "",
        "how the first voxel on a ray is found: voxels: in leaps through a distance field of the map; mesh: as the"
        " first of the voxels' exposed faces; they can differ on rays that graze an edge",
        "ours; docs/performance.md",
    )
    est_point: Literal["first-surface", "element"] = constant(
        "first-surface",
        "",
        "the estimate's side of a correspondence: the first predicted voxel on the ray (what the camera sees), or the"
        " predicted element itself",
        "first-surface: ours, so that a perfect map scores 0; element: paper, eq. AME",
    )
    headline: Literal["rmse", "mean"] = constant(
        "rmse",
        "",
        "statistic of AME that is printed first",
        "rmse: paper, eq. AME; mean: what the original prints",
    )
    thresholds: tuple[float, ...] = constant(
        (0.05, 0.10, 0.20),
        "m",
        "distances of precision, recall and F-score (strictly below)",
        "Tanks and Temples",
    )
    rpe_frames: int = constant(
        1, "frames", "step of the relative error over frames", "paper, eq. RPE: consecutive poses"
    )
    rpe_metres: float = constant(1.0, "m", "step of the relative error over ground-truth path length", "evo")
    rpe_seconds: float = constant(
        1.0, "s", "step of the relative error over time", "TUM RGB-D benchmark: drift per second"
    )

    def __post_init__(self) -> None:
        for name in ("voxel_size", "max_range", "view_range", "occlusion_tolerance", "pixel_stride"):
            check_number(self, name, above=0.0)
        for name in ("rpe_frames", "rpe_metres", "rpe_seconds"):
            check_number(self, name, above=0.0)
        for name in ("min_range", "near"):
            check_number(self, name, least=0.0)
        for name in ("t_offset", "yaw_correction"):
            check_number(self, name)
        if self.max_stamp_gap is not None:
            check_number(self, "max_stamp_gap", least=0.0)
        if self.min_range >= self.max_range:
            raise ValueError(f"min_range = {self.min_range}: must be below max_range = {self.max_range}")
        if not self.thresholds or not all(0 < t <= LARGEST for t in self.thresholds):
            raise ValueError(f"thresholds = {list(self.thresholds)}: must be distances above 0")
        if self.prune_leaves and self.cells != "floored":
            raise ValueError("prune_leaves = true: needs cells = 'floored', which OctoMap's tree is made of")
        check_camera(self.camera)

    @property
    def stamp_gap(self) -> float:
        """The gap limit in force, seconds."""
        return DEFAULT_STAMP_GAP[self.match] if self.max_stamp_gap is None else self.max_stamp_gap

    @property
    def center_offset(self) -> float:
        """Where a cell's centre lies, in voxels; see `VoxelGrid`."""
        return 0.0 if self.cells == "rounded" else 0.5

    def effective(self) -> dict[str, Any]:
        """All fields for JSON, open choices filled in; infinite limits become null."""
        values = dataclasses.asdict(self) | {"max_stamp_gap": self.stamp_gap}
        return {
            k: None if isinstance(v, float) and math.isinf(v) else list(v) if isinstance(v, tuple) else v
            for k, v in values.items()
        }


PRESETS: dict[str, Protocol] = {
    "maomaps": Protocol(),
    "paper": Protocol(name="paper", est_point="element"),
    "slam_comparison": Protocol(
        name="slam_comparison",
        cells="floored",
        prune_leaves=True,
        near=0.0,
        two_sided_view=True,
        est_point="element",
        headline="mean",
    ),
}


def changes_of(protocol: Protocol) -> dict[str, Any]:
    """Fields in which a protocol differs from the preset of its name (from `maomaps` if it is a file's)."""
    preset = PRESETS.get(protocol.name, PRESETS["maomaps"])
    fields = (f.name for f in dataclasses.fields(Protocol) if f.name != "name")
    return {name: getattr(protocol, name) for name in fields if getattr(protocol, name) != getattr(preset, name)}
