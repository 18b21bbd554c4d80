"""RGB-D frames, one at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.camera import Camera


@dataclass(frozen=True, eq=False)
class Frame:
    """One depth image with, perhaps, its colours. Its pose comes from a Trajectory, by stamp or by index.

    Attributes:
        index: place in the stream, from 0; pairs the frame with a trajectory that has no stamps.
        stamp_ns: nanoseconds; None where the source has no stamps.
        depth: (H, W) float32, metres along the optical axis; 0 = missing (readers map NaN, inf and 65535 to 0).
        colors: (H, W, 3) uint8 RGB, or None.
        extras: further images of the same size by name, which only a simulator gives and only recorders keep.
    """

    index: int
    stamp_ns: int | None
    depth: NDArray[np.float32]
    colors: NDArray[np.uint8] | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FrameStream:
    """Frames that are read when asked for, so that memory does not grow with the recording.

    Attributes:
        camera: intrinsics of every depth image.
        count: how many depth frames there are; None if unknown (for progress only).
        read: read(with_colors) opens the source anew and yields its frames in order.
        source: what it reads from, for messages.
    """

    camera: Camera
    count: int | None
    read: Callable[[bool], Iterator[Frame]]
    source: str = "frames"
