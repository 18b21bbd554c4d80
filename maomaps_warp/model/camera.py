"""The pinhole camera."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

_NUMBER = r"([-+0-9.eE]+)"
_FOV_TEXT = re.compile(rf"(\d+)x(\d+)@{_NUMBER}")
_INTRINSICS_TEXT = re.compile(rf"(\d+)x(\d+):{_NUMBER},{_NUMBER},{_NUMBER},{_NUMBER}")


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion.

    The frame is optical: x right, y down, z forward. Pixel (0, 0) is the CENTRE of the first pixel, as in
    sensor_msgs/CameraInfo, so the image covers u in [-0.5, width - 0.5) and v in [-0.5, height - 0.5).

    Attributes:
        width, height: image size, pixels.
        fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ValueError(f"camera size must be positive, got {self.width}x{self.height}")
        values = (self.fx, self.fy, self.cx, self.cy)
        if not all(math.isfinite(v) for v in values) or self.fx <= 0 or self.fy <= 0:
            raise ValueError(f"camera needs finite fx, fy > 0 and cx, cy; got {values}")

    @classmethod
    def from_fov(cls, width: int, height: int, horizontal_fov_deg: float) -> Camera:
        """A camera with square pixels whose image spans `horizontal_fov_deg` from edge to edge, centred."""
        if not 0.0 < horizontal_fov_deg < 180.0:
            raise ValueError(f"horizontal field of view must lie in (0, 180) degrees, got {horizontal_fov_deg}")
        focal = 0.5 * width / math.tan(0.5 * math.radians(horizontal_fov_deg))
        return cls(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    def resized(self, width: int, height: int) -> Camera:
        """A camera of the same view, edge to edge, whose image has another size."""
        x, y = width / self.width, height / self.height
        return Camera(width, height, self.fx * x, self.fy * y, (self.cx + 0.5) * x - 0.5, (self.cy + 0.5) * y - 0.5)

    @classmethod
    def from_text(cls, text: str) -> Camera | None:
        """The camera that `text` describes; None if it is of neither form.

        Args:
            text: "320x240@90" (pixels, horizontal field of view in degrees) or "640x480:525,525,319.5,239.5" (pixels).

        Raises:
            ValueError: one of the forms with impossible numbers.
        """
        if match := _FOV_TEXT.fullmatch(text.strip()):
            width, height, fov = match.groups()
            return cls.from_fov(int(width), int(height), float(fov))
        if match := _INTRINSICS_TEXT.fullmatch(text.strip()):
            width, height, *intrinsics = match.groups()
            return cls(int(width), int(height), *map(float, intrinsics))
        return None

    @property
    def tangent_bounds(self) -> tuple[float, float, float, float]:
        """The image's borders as slopes (x/z min, x/z max, y/z min, y/z max), dimensionless."""
        return (
            (-0.5 - self.cx) / self.fx,
            (self.width - 0.5 - self.cx) / self.fx,
            (-0.5 - self.cy) / self.fy,
            (self.height - 0.5 - self.cy) / self.fy,
        )

    def __str__(self) -> str:
        return f"{self.width}x{self.height} fx={self.fx:.6g} fy={self.fy:.6g} cx={self.cx:.6g} cy={self.cy:.6g}"
