"""A few small frames of a recording, with which everything is proved; memory stays flat over any length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import FrameStream

#: Frames of a recording that are looked at, from its start, and frames of these that are kept.
FRAMES_LOOKED_AT = 2000
FRAMES_KEPT = 300
#: Columns that a kept image has at least, pixels: every n-th of the recorded ones.
SMALL_WIDTH = 80

_Progress = Callable[[int, int | None], None]


@dataclass(frozen=True, eq=False)
class FrameSample:
    """Thinned frames of a recording.

    Attributes:
        camera: of the small images.
        index: (N,) int64, places in the stream, ascending.
        stamps_ns: (N,) int64, nanoseconds; None if the frames have none.
        depth: (N, h, w) float32, metres along the optical axis, 0 = missing.
    """

    camera: Camera
    index: NDArray[np.int64]
    stamps_ns: NDArray[np.int64] | None
    depth: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.depth)

    def select(self, place: NDArray[np.int64]) -> FrameSample:
        """The frames at these places of the sample, (M,) int64, ascending."""
        stamps = None if self.stamps_ns is None else self.stamps_ns[place]
        return replace(self, index=self.index[place], stamps_ns=stamps, depth=self.depth[place])


def sample_frames(stream: FrameStream, *, progress: _Progress | None = None) -> FrameSample:
    """Keep at most FRAMES_KEPT frames of the first FRAMES_LOOKED_AT, evenly spaced, every n-th pixel of each.

    Pixels are taken, not averaged: an average over an edge is a depth that is nowhere.
    """
    step = max(1, stream.camera.width // SMALL_WIDTH)
    kept: list[tuple[int, int | None, NDArray[np.float32]]] = []
    stride = 1
    total = None if stream.count is None else min(stream.count, FRAMES_LOOKED_AT)
    for done, frame in enumerate(islice(stream.read(False), FRAMES_LOOKED_AT), start=1):
        if frame.index % stride == 0:
            if len(kept) == FRAMES_KEPT:
                kept, stride = kept[::2], 2 * stride
            if frame.index % stride == 0:
                kept.append((frame.index, frame.stamp_ns, frame.depth[step // 2 :: step, step // 2 :: step].copy()))
        if progress is not None:
            progress(done, total)
    small = _small_camera(stream.camera, step)
    stamps = [stamp for _, stamp, _ in kept if stamp is not None]
    return FrameSample(
        camera=small,
        index=np.array([index for index, _, _ in kept], dtype=np.int64),
        stamps_ns=np.array(stamps, dtype=np.int64) if len(stamps) == len(kept) else None,
        depth=np.stack([depth for *_, depth in kept]) if kept else np.zeros((0, small.height, small.width), np.float32),
    )


def _small_camera(camera: Camera, step: int) -> Camera:
    """The camera of every `step`-th pixel, the first of them `step // 2`."""
    first = step // 2
    return Camera(
        width=len(range(first, camera.width, step)),
        height=len(range(first, camera.height, step)),
        fx=camera.fx / step,
        fy=camera.fy / step,
        cx=(camera.cx - first) / step,
        cy=(camera.cy - first) / step,
    )
