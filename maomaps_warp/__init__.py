"""Measure how good the maps of visual SLAM are.

    import maomaps_warp as mw

    gt = mw.open_source(Path("gt.bag"), side="gt")
    est = mw.source_from_parts(Path("map.pcd"), Path("trajectory.txt"), side="est")
    run = mw.score(gt, est)

Stages live in `maomaps_warp.mapping` and `maomaps_warp.scoring`, Warp kernels to embed in `maomaps_warp.kernels`.
Importing the package starts nothing: each name is loaded when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from maomaps_warp.errors import CapacityError, InputError, MaomapsError, NoScoreError
    from maomaps_warp.io.sources import Source, SourceOptions, open_source, source_from_parts
    from maomaps_warp.model.camera import Camera
    from maomaps_warp.model.cloud import PointCloud
    from maomaps_warp.model.frame import Frame, FrameStream
    from maomaps_warp.model.results import Score
    from maomaps_warp.model.trajectory import Trajectory
    from maomaps_warp.model.voxels import VoxelGrid, VoxelMap
    from maomaps_warp.pipeline import ScoredRun, score
    from maomaps_warp.protocol import PRESETS, Protocol, load_protocol

_HOME = {
    "CapacityError": "errors",
    "InputError": "errors",
    "MaomapsError": "errors",
    "NoScoreError": "errors",
    "Source": "io.sources",
    "SourceOptions": "io.sources",
    "open_source": "io.sources",
    "source_from_parts": "io.sources",
    "Camera": "model.camera",
    "PointCloud": "model.cloud",
    "Frame": "model.frame",
    "FrameStream": "model.frame",
    "Score": "model.results",
    "Trajectory": "model.trajectory",
    "VoxelGrid": "model.voxels",
    "VoxelMap": "model.voxels",
    "ScoredRun": "pipeline",
    "score": "pipeline",
    "PRESETS": "protocol",
    "Protocol": "protocol",
    "load_protocol": "protocol",
}

__all__ = [
    "PRESETS",
    "Camera",
    "CapacityError",
    "Frame",
    "FrameStream",
    "InputError",
    "MaomapsError",
    "NoScoreError",
    "PointCloud",
    "Protocol",
    "Score",
    "ScoredRun",
    "Source",
    "SourceOptions",
    "Trajectory",
    "VoxelGrid",
    "VoxelMap",
    "load_protocol",
    "open_source",
    "score",
    "source_from_parts",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'maomaps_warp' has no attribute {name!r}")
    return getattr(importlib.import_module(f"maomaps_warp.{_HOME[name]}"), name)
