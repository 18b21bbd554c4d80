"""The one place that opens anything: a file, a folder, a bag, or a map and a trajectory, becomes a Source."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import recognise_bag
from maomaps_warp.io.original_directory import is_original_directory
from maomaps_warp.io.source import Side, Source, SourceOptions, option
from maomaps_warp.io.source_kinds import FORMATS, open_part
from maomaps_warp.model.frame import FrameStream
from maomaps_warp.model.trajectory import Trajectory

__all__ = [
    "FORMATS",
    "Side",
    "Source",
    "SourceOptions",
    "is_original_directory",
    "open_original_directory",
    "open_source",
    "source_from_parts",
]

#: No options: everything is recognised.
AS_IT_COMES = SourceOptions()

#: Larger coordinates are no metres but damage: float64 steps are 0.1 mm here, and squares of far larger numbers
#: overflow.
LARGEST_COORDINATE_M = 1e12


def open_source(
    path: Path,
    options: SourceOptions = AS_IT_COMES,
    side: Side = "gt",
    *,
    map_path: Path | None = None,
    trajectory_path: Path | None = None,
) -> Source:
    """Open any file, folder or bag, recognised by its content.

    Args:
        path: what to open.
        options: how to read it.
        side: "gt" or "est", to name the options in errors; and of a bag with both clouds and depth images the
            ground truth takes the depth, the estimate the cloud, unless a topic is named.
        map_path: take the map from here; `path` is then only asked for its poses.
        trajectory_path: take the poses from here; `path` is then only asked for its map.

    Raises:
        InputError: something is absent, unknown or damaged, or there are neither poses nor points.
    """
    if map_path and trajectory_path:
        found = f"{option(side, 'map')} and {option(side, 'trajectory')} leave nothing to take from it"
        raise InputError(path, found, "give the whole and one of them, or both of them alone")
    if map_path or trajectory_path:
        return source_from_parts(map_path or path, trajectory_path or path, options, side)
    _check_topics_have_a_bag(options, side, path)
    return _checked(open_part(path, options, side, "all"), side)


def source_from_parts(
    map_path: Path | None,
    trajectory_path: Path | None,
    options: SourceOptions = AS_IT_COMES,
    side: Side = "gt",
) -> Source:
    """A side made of a map, a trajectory, or both; the map may be depth images that the poses belong to.

    Raises:
        InputError: as `open_source`, or a part is not what it was given as.
    """
    paths = tuple(path for path in (map_path, trajectory_path) if path)
    if not paths:
        raise ValueError("source_from_parts needs a map or a trajectory")
    _check_topics_have_a_bag(options, side, *paths)
    parts = []
    if map_path:
        part = open_part(map_path, options, side, "map")
        if part.cloud is None and part.frames is None:
            found = f"holds no map (it was read as: {part.kind})"
            raise InputError(map_path, found, f"a map is points or depth images; see {option(side, 'format')}")
        parts.append(part)
    if trajectory_path:
        part = open_part(trajectory_path, options, side, "trajectory")
        if part.trajectory is None:
            found = f"holds no poses (it was read as: {part.kind})"
            raise InputError(trajectory_path, found, f"a trajectory is poses; see {option(side, 'format')}")
        parts.append(part)
    return _checked(_joined(*parts) if len(parts) == 2 else parts[0], side)


def open_original_directory(path: Path, options: SourceOptions = AS_IT_COMES) -> tuple[Source, Source]:
    """Ground truth and estimate in an input directory of the original program, poses paired by index."""
    original = replace(options, format="original")
    return open_source(path, original, "gt"), open_source(path, original, "est")


def _joined(map_part: Source, trajectory_part: Source) -> Source:
    return replace(
        map_part,
        name=f"{map_part.name} + {trajectory_part.name}",
        kind=f"{map_part.kind} + {trajectory_part.kind}",
        trajectory=trajectory_part.trajectory,
        camera=map_part.camera or trajectory_part.camera,
        start_pose=map_part.start_pose or trajectory_part.start_pose,
        one_clock=False,
        notes=tuple(dict.fromkeys((*map_part.notes, *trajectory_part.notes))),
    )


def _check_topics_have_a_bag(options: SourceOptions, side: Side, *paths: Path) -> None:
    if options.topics and not any(recognise_bag(path) for path in paths):
        given = " and ".join(map(str, paths))
        raise InputError(
            f"{option(side, 'topic')} {options.topics[0]}", f"{given}: not a bag", "topics are only in bags"
        )


def _checked(source: Source, side: Side) -> Source:
    """The source, if there is something in it to score."""
    if source.trajectory is None and source.cloud is None:
        raise InputError(
            source.name,
            f"holds depth images without poses (it was read as: {source.kind})",
            f"give the poses with {option(side, 'trajectory')}",
        )
    if source.trajectory is not None:
        _check_reach(source.trajectory.source, "pose", source.trajectory.positions)
    if source.cloud is not None:
        _check_reach(source.cloud.source, "point", source.cloud.points)
    if source.frames is not None and source.trajectory is not None:
        _check_pairing(source.frames, source.trajectory, side)
    return source


def _check_reach(where: str, item: str, points: NDArray[np.float64]) -> None:
    if max(points.max(initial=0.0), -points.min(initial=0.0)) > LARGEST_COORDINATE_M:
        far = np.flatnonzero(np.abs(points).max(axis=1) > LARGEST_COORDINATE_M)
        place = " ".join(f"{value:g}" for value in points[far[0]])
        more = f"; {len(far)} of {len(points)} are so" if len(far) > 1 else ""
        found = f"{item} {far[0] + 1} lies at {place} m{more}"
        raise InputError(
            where, found, f"coordinates are metres, up to {LARGEST_COORDINATE_M:g}: remove or rescale them"
        )


def _check_pairing(frames: FrameStream, trajectory: Trajectory, side: Side) -> None:
    """Frames and poses pair by index if one of them has no stamps: then there must be as many of both."""
    if frames.count is None or frames.count == len(trajectory):
        return
    if trajectory.stamps_ns is None or next(frames.read(False)).stamp_ns is None:
        found = f"{len(trajectory)} poses for the {frames.count} depth images of {frames.source}"
        hint = f"without stamps they pair by index; give poses with stamps, or as many, by {option(side, 'trajectory')}"
        raise InputError(trajectory.source, found, hint)
