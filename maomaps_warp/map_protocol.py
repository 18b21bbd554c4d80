"""Map protocols: every constant and choice that moves a ground-truth map, by name."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

from maomaps_warp.protocol import (
    DEFAULT_STAMP_GAP,
    MAX_RANGE,
    MIN_RANGE,
    PIXEL_STRIDE,
    Arithmetic,
    ColorMean,
    MatchMethod,
    check_camera,
    check_number,
    constant,
)

RotationChoice = Literal["full", "yaw"]
CeilingRule = Literal["keep", "layer", "height"]


@dataclass(frozen=True)
class MapProtocol:
    """How a ground-truth map is made of a recording. Each field carries unit, meaning and source in its metadata."""

    name: str = constant("maomaps", "", "name of the protocol", "")
    voxel_size: float = constant(
        0.05,
        "m",
        "edge of a voxel; voxel k is centred on k * voxel_size, halves to even",
        "paper, section III-A: discretisation step",
    )
    min_range: float = constant(*MIN_RANGE)
    max_range: float = constant(*MAX_RANGE)
    pixel_stride: int = constant(*PIXEL_STRIDE)
    rotation: RotationChoice = constant(
        "full",
        "",
        "full: the recorded rotation; yaw: only the heading atan2(R10, R00) of the rotation R of the body, wrong for a"
        " camera that pitches or rolls",
        "yaw: original gt_map_creator",
    )
    camera: str = constant(
        "",
        "",
        "intrinsics of the depth images: WIDTHxHEIGHT@horizontal degrees or WIDTHxHEIGHT:fx,fy,cx,cy; empty: what the"
        " recording states (camera_info)",
        "original: fx = fy = 160, centre (160, 120), whatever camera_info says",
    )
    match: MatchMethod = constant(
        "interpolate",
        "",
        "pose of a depth image: lerp + slerp between the poses around its stamp, or the pose of the nearest stamp",
        "interpolate: ours; original: equal stamps, which is nearest with a gap of 0",
    )
    max_stamp_gap: float | None = constant(
        None,
        "s",
        "interpolate: largest distance of the two poses around a stamp; nearest: largest distance to the pose;"
        f" unset: {DEFAULT_STAMP_GAP['interpolate']} and {DEFAULT_STAMP_GAP['nearest']}; images without a pose are"
        " left out",
        "original: 0",
    )
    color_gap: float = constant(
        0.02,
        "s",
        "largest distance of the stamps of a depth image and its colours; where colours are wanted, depth images"
        " without them are left out",
        "TUM's associate.py; original: 0",
    )
    color_mean: ColorMean = constant(
        "rounded",
        "",
        "colour of a voxel: mean of its samples in each channel, rounded (halves up) or truncated to 8 bits",
        "truncated: original gt_map_creator",
    )
    ceiling: CeilingRule = constant(
        "keep",
        "",
        "layer: in the upper half of the occupied z layers the fullest is the ceiling, and what lies higher than"
        " ceiling_margin below it is dropped; height: what lies higher than ceiling_height is dropped",
        "layer: original gt_map_creator",
    )
    ceiling_height: float | None = constant(
        None, "m", "world z of the highest layer that ceiling = height keeps", "ours"
    )
    ceiling_margin: float = constant(
        1.0, "m", "how far below the ceiling the map ends under ceiling = layer", "original gt_map_creator"
    )
    arithmetic: Arithmetic = constant(
        "float32",
        "",
        "float32: relative to the middle of the map, times 1 / voxel_size; float64: in the world, divided by"
        " voxel_size. They differ for samples on a voxel's face",
        "float64: original gt_map_creator",
    )

    def __post_init__(self) -> None:
        for name in ("voxel_size", "max_range", "pixel_stride"):
            check_number(self, name, above=0.0)
        for name in ("min_range", "color_gap", "ceiling_margin"):
            check_number(self, name, least=0.0)
        if self.max_stamp_gap is not None:
            check_number(self, "max_stamp_gap", least=0.0)
        if self.ceiling_height is not None:
            check_number(self, "ceiling_height")
        if self.min_range >= self.max_range:
            raise ValueError(f"min_range = {self.min_range}: must be below max_range = {self.max_range}")
        if self.ceiling == "height" and self.ceiling_height is None:
            raise ValueError("ceiling = 'height': needs ceiling_height")
        if self.camera:
            check_camera(self.camera)

    @property
    def stamp_gap(self) -> float:
        """The gap limit in force, seconds."""
        return DEFAULT_STAMP_GAP[self.match] if self.max_stamp_gap is None else self.max_stamp_gap

    def effective(self) -> dict[str, Any]:
        """All fields for JSON, open choices filled in."""
        return dataclasses.asdict(self) | {"max_stamp_gap": self.stamp_gap}


MAP_PRESETS: dict[str, MapProtocol] = {
    "maomaps": MapProtocol(),
    "gt_map_creator": MapProtocol(
        name="gt_map_creator",
        rotation="yaw",
        camera="320x240:160,160,160,120",
        match="nearest",
        max_stamp_gap=0.0,
        color_gap=0.0,
        color_mean="truncated",
        ceiling="layer",
        arithmetic="float64",
    ),
}
