"""Protocols: every constant and choice that moves a score, by name.

A protocol is part of every result. `docs/protocol.md` is the specification; this module is its executable half.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

from maomaps_warp.errors import InputError

AlignMethod = Literal["none", "origin", "start-pose", "yaw", "se3", "sim3"]
MatchMethod = Literal["interpolate", "nearest"]
PoseChoice = Literal["nearest", "first", "last", "all"]

#: Largest gap where the protocol leaves it open, seconds: two ground-truth samples that enclose a stamp (5 Hz), and
#: evo's default for the nearest stamp.
DEFAULT_STAMP_GAP: dict[str, float] = {"interpolate": 0.2, "nearest": 0.01}


def _constant(default: Any, unit: str, meaning: str, source: str) -> Any:
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "source": source})


@dataclass(frozen=True)
class Protocol:
    """How a run is scored. Each field carries its unit, meaning and source in its metadata; see `describe`."""

    name: str = _constant("maomaps", "", "name of the protocol", "")
    voxel_size: float = _constant(
        0.05, "m", "edge of a voxel of both maps", "paper, section III-A: discretisation step"
    )
    cells: Literal["rounded", "floored"] = _constant(
        "rounded",
        "",
        "rounded: voxel k is centred on k * voxel_size, halves to even; floored: it starts there, and coordinates pass"
        " through float32",
        "rounded: the original ground-truth creator; floored: OctoMap in the original scorer",
    )
    prune_leaves: bool = _constant(
        False,
        "",
        "full 2x2x2 blocks of the predicted map count as one element, repeatedly",
        "OctoMap in the original scorer; a defect elsewhere: thick walls weigh less",
    )
    min_range: float = _constant(
        0.01, "m", "depth samples at this distance or nearer are no map points", "original gt_map_creator"
    )
    max_range: float = _constant(
        10.0, "m", "depth samples at this distance or farther are no map points", "original gt_map_creator"
    )
    pixel_stride: int = _constant(
        1, "pixels", "every n-th pixel of each row and column is back-projected", "original: every pixel"
    )
    align: AlignMethod = _constant(
        "none", "", "transform of the estimate found from the trajectories", "paper: none; field: evo"
    )
    yaw_correction: float = _constant(
        0.0, "rad", "added to the yaw of align = start-pose", "MAOMaps: one a sample, see docs/protocol.md"
    )
    match: MatchMethod = _constant(
        "interpolate",
        "",
        "pose of the ground truth at an estimate's stamp: lerp + slerp between neighbours, or the nearest sample",
        "interpolate: original compute_ate_rpe (without its Euler wrap); nearest: evo",
    )
    max_stamp_gap: float | None = _constant(
        None,
        "s",
        "interpolate: largest distance of the two samples around a stamp; nearest: largest distance to the sample;"
        f" unset: {DEFAULT_STAMP_GAP['interpolate']} and {DEFAULT_STAMP_GAP['nearest']}",
        "nearest: evo's default",
    )
    t_offset: float = _constant(0.0, "s", "added to the estimate's stamps", "evo")
    camera: str = _constant(
        "320x240@90",
        "",
        "camera where the input states none: WIDTHxHEIGHT@horizontal degrees",
        "paper, Table I",
    )
    near: float = _constant(
        0.01,
        "m",
        "an element is in front of the camera if it lies farther than this along the optical axis",
        "ours",
    )
    view_range: float = _constant(
        math.inf, "m", "an element farther from the camera is out of view", "original scorer: no limit"
    )
    two_sided_view: bool = _constant(
        False,
        "",
        "points in the mirrored cone BEHIND the camera count as visible",
        "original scorer tests x > 0 after dividing by x; a defect",
    )
    occlusion_tolerance: float = _constant(
        0.5,
        "m",
        "the first predicted voxel on the ray must lie nearer to the element than this",
        "original scorer",
    )
    pose_choice: PoseChoice = _constant(
        "nearest",
        "",
        "which of the poses that see an element casts its ray",
        "original scorer: nearest|first|last|all",
    )
    est_point: Literal["first-surface", "element"] = _constant(
        "first-surface",
        "",
        "the estimate's side of a correspondence: the first predicted voxel on the ray (what the camera sees), or the"
        " predicted element itself",
        "first-surface: ours, so that a perfect map scores 0; element: paper, eq. AME",
    )
    headline: Literal["rmse", "mean"] = _constant(
        "rmse",
        "",
        "statistic of AME that is printed first",
        "rmse: paper, eq. AME; mean: what the original prints",
    )
    thresholds: tuple[float, ...] = _constant(
        (0.05, 0.10, 0.20),
        "m",
        "distances of precision, recall and F-score (strictly below)",
        "Tanks and Temples",
    )
    rpe_frames: int = _constant(
        1, "frames", "step of the relative error over frames", "paper, eq. RPE: consecutive poses"
    )
    rpe_metres: float = _constant(1.0, "m", "step of the relative error over ground-truth path length", "evo")
    rpe_seconds: float = _constant(
        1.0, "s", "step of the relative error over time", "TUM RGB-D benchmark: drift per second"
    )

    def __post_init__(self) -> None:
        positive: tuple[str, ...] = ("voxel_size", "max_range", "view_range", "occlusion_tolerance", "pixel_stride")
        positive += ("rpe_frames", "rpe_metres", "rpe_seconds")
        for name in positive:
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")
        for name in ("min_range", "near"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if self.min_range >= self.max_range:
            raise ValueError(f"min_range {self.min_range} must be below max_range {self.max_range}")
        if not math.isfinite(self.voxel_size) or not math.isfinite(self.t_offset):
            raise ValueError("voxel_size and t_offset must be finite")
        if self.max_stamp_gap is not None and not 0 <= self.max_stamp_gap < math.inf:
            raise ValueError(f"max_stamp_gap must be a number of seconds from 0, got {self.max_stamp_gap}")
        if not self.thresholds or not all(0 < t < math.inf for t in self.thresholds):
            raise ValueError(f"thresholds must be distances above 0, got {self.thresholds}")
        if self.prune_leaves and self.cells != "floored":
            raise ValueError("prune_leaves needs cells = 'floored': OctoMap's tree is made of floored cells")

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


def with_overrides(protocol: Protocol, overrides: dict[str, Any], where: str) -> Protocol:
    """A protocol with some fields replaced.

    Args:
        protocol: where to start.
        overrides: fields by name, as TOML gives them.
        where: what to blame, for the message.

    Raises:
        InputError: an unknown field, or a value it cannot take.
    """
    hints = get_type_hints(Protocol)
    for name, value in overrides.items():
        if name not in hints:
            raise InputError(where, f"no such field: {name}", f"fields: {', '.join(hints)}")
        allowed = get_args(hints[name])
        if allowed and all(isinstance(a, str) for a in allowed) and value not in allowed:
            raise InputError(where, f"{name} = {value!r}", f"allowed: {', '.join(allowed)}")
    try:
        return dataclasses.replace(protocol, **{k: _as_field(hints[k], v) for k, v in overrides.items()})
    except (TypeError, ValueError) as error:
        raise InputError(where, str(error)) from None


def _as_field(hint: Any, value: Any) -> Any:
    """`value` in the type of a field, where that loses nothing."""
    if hint is bool or isinstance(value, bool):
        if hint is not bool or not isinstance(value, bool):
            raise TypeError(f"expected {getattr(hint, '__name__', hint)}, got {value!r}")
        return value
    if hint is int:
        if not isinstance(value, int):
            raise TypeError(f"expected a whole number, got {value!r}")
        return value
    if hint is float or float in get_args(hint):
        if isinstance(value, list | tuple):
            return tuple(float(v) for v in value)
        if value is None:
            return None
        if not isinstance(value, int | float):
            raise TypeError(f"expected a number, got {value!r}")
        return float(value)
    return value


def load_protocol(name_or_file: str) -> Protocol:
    """A preset by name, or a TOML file: fields of Protocol, and `base` with the preset to start from.

    Raises:
        InputError: neither; or a file with an unknown field or a bad value.
    """
    if name_or_file in PRESETS:
        return PRESETS[name_or_file]
    path = Path(name_or_file)
    if not path.is_file():
        raise InputError(
            f"--protocol {name_or_file}",
            "no such protocol",
            f"presets: {', '.join(PRESETS)}; or a .toml file",
        )
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise InputError(path, f"not a TOML file: {error}") from None
    base = values.pop("base", "maomaps")
    if base not in PRESETS:
        raise InputError(path, f"base = {base!r}", f"presets: {', '.join(PRESETS)}")
    return with_overrides(PRESETS[base], {"name": path.stem} | values, str(path))


def to_toml(protocol: Protocol) -> str:
    """The protocol as a TOML file that `load_protocol` reads back to an equal one."""
    lines = []
    for f in dataclasses.fields(protocol):
        value = getattr(protocol, f.name)
        if value is None:
            continue
        unit = f" [{f.metadata['unit']}]" if f.metadata["unit"] else ""
        lines += [f"# {f.metadata['meaning']}{unit}", f"{f.name} = {_toml_value(value)}"]
    return "\n".join(lines) + "\n"


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, tuple):
        return "[" + ", ".join(repr(v) for v in value) + "]"
    return repr(value)
