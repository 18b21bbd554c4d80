"""Takes clouds, trajectories and occupancy grids out of a bag."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags import BagContents, open_bag, read_bag_cloud, read_bag_clouds, read_bag_trajectory
from maomaps_warp.io.bags.occupancy import read_bag_grid
from maomaps_warp.io.bags.reading import Bag, Topic
from maomaps_warp.io.bags.topics import CLOUD_TYPE, GRID_TYPE, POSE_TYPES
from maomaps_warp.io.clouds import write_cloud
from maomaps_warp.io.occupancy_maps import write_map_server
from maomaps_warp.io.stamp_order import seconds_text
from maomaps_warp.io.trajectories import write_maomaps_poses, write_tum
from maomaps_warp.io.trajectory_formats import timestamps_beside
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.pose_convention import parse_convention
from maomaps_warp.stopwatch import Stopwatch

PoseFormat = Literal["tum", "maomaps"]
CloudFormat = Literal["pcd", "ply", "txt"]


@dataclass(frozen=True)
class ExtractOptions:
    """What to take out of a bag, and how to write it.

    Attributes:
        topics: names; empty for all that hold clouds, poses or occupancy grids.
        every: all clouds of a topic, not the last one alone.
        trajectory_format: "tum" (the camera's poses) or "maomaps" (the body's).
        pose_frame: what the recorded poses mean, see `parse_convention`.
        cloud_format: suffix of the clouds' files.
        overwrite: write into a folder that holds something already.
    """

    topics: tuple[str, ...] = ()
    every: bool = False
    trajectory_format: PoseFormat = "tum"
    pose_frame: str = "auto"
    cloud_format: CloudFormat = "pcd"
    overwrite: bool = False


@dataclass(frozen=True)
class Extracted:
    """What was taken from one topic.

    Attributes:
        topic: where it was.
        count: points, poses or cells, of all files together.
        unit: which of them.
        files: in the order of the messages.
        notes: what was decided or left out.
    """

    topic: Topic
    count: int
    unit: str
    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Extraction:
    """What came of a bag.

    Attributes:
        taken: what was written, topic by topic.
        failures: why topics, or parts of them, could not be taken.
    """

    taken: tuple[Extracted, ...]
    failures: tuple[str, ...]


#: One file, or several that belong together: the files, points or poses or cells, notes.
_Piece = tuple[tuple[Path, ...], int, tuple[str, ...]]
_Taker = Callable[[Bag, Topic, Path, ExtractOptions], Iterator[_Piece]]


def extract(path: Path, folder: Path, options: ExtractOptions, clock: Stopwatch) -> Extraction:
    """Write the clouds, trajectories and occupancy grids of a bag into a folder.

    A topic that cannot be read is told among the failures, and the others are taken all the same.

    Args:
        path: a bag of any kind.
        folder: new or empty, unless `options.overwrite`.
        options: what and how.
        clock: collects the topics' times.

    Raises:
        InputError: no bag, none of the topics, a folder that is in use, or nothing at all could be taken.
    """
    _check_folder(folder, options.overwrite)
    if options.pose_frame != "auto":
        try:
            parse_convention(options.pose_frame)
        except ValueError as error:
            raise InputError(f"--pose-frame {options.pose_frame}", str(error)) from None
    taken: list[Extracted] = []
    failures: list[str] = []
    with open_bag(path) as bag:
        topics = _chosen(bag, options.topics)
        stems = file_stems([topic.name for topic in topics])
        is_new = not folder.exists()
        _make(folder)
        for topic, stem in zip(topics, stems, strict=True):
            with clock.stage(topic.name):
                _take(bag, topic, folder / stem, options, taken, failures)
        if not taken:
            if is_new:
                folder.rmdir()
            raise InputError(path, f"nothing could be taken out: {'; '.join(failures)}")
    return Extraction(tuple(taken), tuple(failures))


def file_stems(topics: Sequence[str]) -> list[str]:
    """A name of a file for each topic: "/slam/map" becomes "slam_map"; numbers keep equal ones apart.

    Names differ by more than upper and lower case, and none is what another's file of stamps is called.
    """
    stems: list[str] = []
    used: set[str] = set()
    for topic in topics:
        plain = re.sub(r"[^A-Za-z0-9.-]+", "_", topic.strip("/")).lstrip(".") or "topic"
        stem, number = plain, 1
        while used & {stem.lower(), f"{stem.lower()}_timestamps"}:
            number += 1
            stem = f"{plain}_{number}"
        used |= {stem.lower(), f"{stem.lower()}_timestamps"}
        stems.append(stem)
    return stems


def _chosen(bag: Bag, wanted: Sequence[str]) -> list[Topic]:
    """The topics to take; those named, or all of use that hold messages."""
    listed = "topics in this bag: " + ("; ".join(map(str, bag.topics)) or "none")
    for name in wanted:
        found = [topic for topic in bag.topics if topic.is_named(name)]
        if not found:
            raise InputError(bag.path, f"no topic {name}", listed)
        if not any(topic.type in _TAKERS for topic in found):
            reason = f"{found[0]} holds no clouds, poses or occupancy grids"
            raise InputError(f"{bag.path}, topic {name}", reason, listed)
    topics = [topic for topic in bag.topics if topic.type in _TAKERS and (topic.count or wanted)]
    if wanted:
        topics = [topic for topic in topics if any(topic.is_named(name) for name in wanted)]
    if not topics:
        raise InputError(bag.path, "the bag holds no clouds, poses or occupancy grids", listed)
    return topics


def _take(
    bag: Bag, topic: Topic, stem: Path, options: ExtractOptions, taken: list[Extracted], failures: list[str]
) -> None:
    """Take one topic; what was written before a failure counts among what was taken."""
    taker, unit = _TAKERS[topic.type]
    pieces: list[_Piece] = []
    try:
        for piece in taker(bag, topic, stem, options):
            pieces.append(piece)  # kept when a later one fails
    except InputError as error:
        failures.append(str(error))
    files = tuple(file for files, _, _ in pieces for file in files)
    if files:
        notes = dict.fromkeys(note for _, _, more in pieces for note in more)
        taken.append(Extracted(topic, sum(count for _, count, _ in pieces), unit, files, tuple(notes)))


def _take_clouds(bag: Bag, topic: Topic, stem: Path, options: ExtractOptions) -> Iterator[_Piece]:
    contents, empty = BagContents(bag, (topic.name,), clouds=(topic,)), 0
    if not options.every:
        yield _written(stem.with_name(f"{stem.name}.{options.cloud_format}"), read_bag_cloud(contents))
        return
    for number, (stamp_ns, cloud) in enumerate(read_bag_clouds(contents), start=1):
        if not len(cloud):
            empty += 1
            continue
        name = f"{stem.name}_{number:06d}_{seconds_text(stamp_ns)}.{options.cloud_format}"
        yield _written(stem.with_name(name), cloud)
    if empty == topic.count:
        raise InputError(f"{contents.path}, topic {topic.name}", f"none of its {empty} clouds has a finite point")
    if empty:
        yield (), 0, (f"{empty} of {topic.count} clouds have no finite point and were left out",)


def _written(path: Path, cloud: PointCloud) -> _Piece:
    write_cloud(path, cloud.points, cloud.colors)
    dropped = cloud.dropped_nonfinite
    more = (f"{path.name}: {dropped} points that are NaN or infinite were dropped",) if dropped else ()
    return (path,), len(cloud), cloud.notes + more


def _take_trajectory(bag: Bag, topic: Topic, stem: Path, options: ExtractOptions) -> Iterator[_Piece]:
    contents = BagContents(bag, (topic.name,), poses=(topic,))
    trajectory = read_bag_trajectory(contents, pose_frame=options.pose_frame)
    path = stem.with_name(f"{stem.name}.txt")
    if options.trajectory_format == "tum":
        write_tum(path, trajectory)
        yield (path,), len(trajectory), trajectory.notes
    else:
        write_maomaps_poses(path, trajectory)
        yield (path, timestamps_beside(path)), len(trajectory), trajectory.notes


def _take_grid(bag: Bag, topic: Topic, stem: Path, options: ExtractOptions) -> Iterator[_Piece]:
    grid = read_bag_grid(BagContents(bag, (topic.name,), grids=(topic,)))
    files = write_map_server(stem.with_name(f"{stem.name}.yaml"), grid, overwrite=options.overwrite)
    yield files, grid.cells.size, grid.notes


#: How a type is taken, and what it is counted in.
_TAKERS: dict[str, tuple[_Taker, str]] = {
    CLOUD_TYPE: (_take_clouds, "points"),
    GRID_TYPE: (_take_grid, "cells"),
    **dict.fromkeys(POSE_TYPES, (_take_trajectory, "poses")),
}


def _check_folder(folder: Path, overwrite: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "is a file", "name a folder, new or empty")
    try:
        if folder.is_dir() and not overwrite and any(folder.iterdir()):
            hint = "name a new folder, or --overwrite replaces files of the same names"
            raise InputError(folder, "is not empty", hint)
    except OSError as error:
        raise InputError(folder, f"cannot be read: {error.strerror}", "choose another folder") from error


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, f"cannot be made: {error.strerror}", "choose a writable place") from error
