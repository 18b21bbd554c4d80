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
    from maomaps_warp.errors import CapacityError as CapacityError
    from maomaps_warp.errors import InputError as InputError
    from maomaps_warp.errors import MaomapsError as MaomapsError
    from maomaps_warp.errors import NoScoreError as NoScoreError
    from maomaps_warp.io.sources import Source as Source
    from maomaps_warp.io.sources import SourceOptions as SourceOptions
    from maomaps_warp.io.sources import open_original_directory as open_original_directory
    from maomaps_warp.io.sources import open_source as open_source
    from maomaps_warp.io.sources import source_from_parts as source_from_parts
    from maomaps_warp.model.alignment import Alignment as Alignment
    from maomaps_warp.model.camera import Camera as Camera
    from maomaps_warp.model.cloud import PointCloud as PointCloud
    from maomaps_warp.model.correspondences import Correspondences as Correspondences
    from maomaps_warp.model.frame import Frame as Frame
    from maomaps_warp.model.frame import FrameStream as FrameStream
    from maomaps_warp.model.results import NoValue as NoValue
    from maomaps_warp.model.results import Score as Score
    from maomaps_warp.model.statistics import Statistics as Statistics
    from maomaps_warp.model.trajectory import Trajectory as Trajectory
    from maomaps_warp.pipeline import ScoredRun as ScoredRun
    from maomaps_warp.pipeline import score as score
    from maomaps_warp.protocol import PRESETS as PRESETS
    from maomaps_warp.protocol import Protocol as Protocol
    from maomaps_warp.protocol_files import load_protocol as load_protocol
    from maomaps_warp.report.json_report import score_document as score_document

#: The public names, by the module that holds them.
_NAMES = {
    "errors": ("CapacityError", "InputError", "MaomapsError", "NoScoreError"),
    "io.sources": (
        "Source",
        "SourceOptions",
        "open_original_directory",
        "open_source",
        "source_from_parts",
    ),
    "model.alignment": ("Alignment",),
    "model.camera": ("Camera",),
    "model.cloud": ("PointCloud",),
    "model.correspondences": ("Correspondences",),
    "model.frame": ("Frame", "FrameStream"),
    "model.results": ("NoValue", "Score"),
    "model.statistics": ("Statistics",),
    "model.trajectory": ("Trajectory",),
    "pipeline": ("ScoredRun", "score"),
    "protocol": ("PRESETS", "Protocol"),
    "protocol_files": ("load_protocol",),
    "report.json_report": ("score_document",),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'maomaps_warp' has no attribute {name!r}")
    return getattr(importlib.import_module(f"maomaps_warp.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
