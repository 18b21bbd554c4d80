"""Writes a cloud, and a trajectory and an occupancy grid with it, as a bag that shows them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_formats import recognise_bag
from maomaps_warp.io.bags.writing import Entry, MessageMaker, bag_kind, check_new_bag, write_bag
from maomaps_warp.io.occupancy_maps import read_occupancy
from maomaps_warp.io.rotations import quaternions_from_matrices
from maomaps_warp.io.sources import Source, SourceOptions, source_from_parts
from maomaps_warp.model.cloud import PointCloud
from maomaps_warp.model.occupancy import OccupancyGrid
from maomaps_warp.model.trajectory import Trajectory

#: The stamp of a map without a trajectory, ns: readers take zero for "not set", and the clock of the day would make
#: every bag another.
DEFAULT_STAMP_NS = 10**9

_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


@dataclass(frozen=True)
class PackOptions:
    """How a bag is to be.

    Attributes:
        topic, path_topic, grid_topic: where the cloud, the trajectory and the grid go.
        frame_id: the world's name, in all of them.
        stamp_ns: of every message; None: the trajectory's last, else DEFAULT_STAMP_NS.
        overwrite: replace a file, or a folder that is a bag.
    """

    topic: str = "/map"
    path_topic: str = "/path"
    grid_topic: str = "/grid"
    frame_id: str = "map"
    stamp_ns: int | None = None
    overwrite: bool = False


@dataclass(frozen=True)
class Packed:
    """What was written.

    Attributes:
        contents: topic, message type and size of each message.
        stamp_ns: their stamp.
        notes: what was decided or left out in reading.
    """

    contents: tuple[tuple[str, str, str], ...]
    stamp_ns: int
    notes: tuple[str, ...]


def pack(
    cloud: Path,
    output: Path,
    options: PackOptions,
    source_options: SourceOptions,
    *,
    trajectory: Path | None = None,
    grid: Path | None = None,
) -> Packed:
    """Write a cloud as a PointCloud2, a trajectory as a Path and a map of the ground as an OccupancyGrid.

    Args:
        cloud: a file or sample directory with points.
        output: NAME.bag (ROS 1), NAME.mcap (ROS 2) or NAME (a ROS 2 folder).
        options: topics, frame, stamp.
        source_options: how to read the cloud and the trajectory.
        trajectory: a file with poses and stamps.
        grid: the .yaml of a map_server pair.

    Raises:
        InputError: an input cannot be read, or cannot be told in a message; `output` exists or cannot be written.
    """
    _check_topics(options, trajectory, grid)
    if not options.frame_id.strip():
        raise InputError("--frame-id", "is empty", "RViz and Foxglove need a name, as map")
    kind = bag_kind(output)
    for path in filter(None, (cloud, trajectory, grid)):
        if path.resolve().is_relative_to(output.resolve()):
            found = "is an input" if path.resolve() == output.resolve() else f"holds {path}, an input"
            raise InputError(output, found, "give the bag a place of its own")
        if recognise_bag(path):
            raise InputError(path, "is a bag", "take clouds, poses and grids out of it with `extract` first")
    check_new_bag(output, overwrite=options.overwrite)
    source = source_from_parts(cloud, trajectory, source_options, "one")
    points = _cloud_of(source)
    poses = source.trajectory if trajectory is not None else None
    occupancy = None if grid is None else read_occupancy(grid)
    if poses is not None and poses.stamps_ns is None:
        raise InputError(poses.source, "has no stamps, which a Path needs", "give poses with stamps, as TUM has them")
    stamp_ns = options.stamp_ns or _stamp_of(poses)
    make = MessageMaker.of(kind)
    write_bag(output, kind, _entries(make, options, stamp_ns, (points, poses, occupancy)), overwrite=options.overwrite)
    contents = [(options.topic, "sensor_msgs/PointCloud2", f"{len(points)} points")]
    if poses is not None:
        contents.append((options.path_topic, "nav_msgs/Path", f"{len(poses)} poses"))
    if occupancy is not None:
        height, width = occupancy.cells.shape
        contents.append((options.grid_topic, "nav_msgs/OccupancyGrid", f"{width} x {height} cells"))
    return Packed(tuple(contents), stamp_ns, source.notes + (occupancy.notes if occupancy else ()))


def _entries(
    make: MessageMaker,
    options: PackOptions,
    stamp_ns: int,
    parts: tuple[PointCloud, Trajectory | None, OccupancyGrid | None],
) -> Iterator[Entry]:
    cloud, poses, grid = parts
    header = make.header(stamp_ns, options.frame_id)
    yield options.topic, stamp_ns, make.point_cloud(header, cloud)
    if poses is not None:
        yield options.path_topic, stamp_ns, _path(make, header, options.frame_id, poses)
    if grid is not None:
        yield options.grid_topic, stamp_ns, make.occupancy_grid(header, grid)


def _path(make: MessageMaker, header: object, frame_id: str, trajectory: Trajectory) -> object:
    assert trajectory.stamps_ns is not None
    quaternions = quaternions_from_matrices(trajectory.T_world_camera[:, :3, :3]).tolist()
    rows = zip(trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), quaternions, strict=True)
    poses = [
        make.pose_stamped(make.header(stamp, frame_id, index), position, xyzw)
        for index, (stamp, position, xyzw) in enumerate(rows)
    ]
    return make.path(header, poses)


def _cloud_of(source: Source) -> PointCloud:
    if source.cloud is None:
        found = f"holds depth images and no points (it was read as: {source.kind})"
        raise InputError(source.name, found, "make a map of them first, with `map`")
    return source.cloud


def _stamp_of(poses: Trajectory | None) -> int:
    """The last stamp of the trajectory, else DEFAULT_STAMP_NS."""
    if poses is None or poses.stamps_ns is None:
        return DEFAULT_STAMP_NS
    return int(poses.stamps_ns[-1])


def _check_topics(options: PackOptions, trajectory: Path | None, grid: Path | None) -> None:
    named = {"--topic": options.topic}
    if trajectory is not None:
        named["--path-topic"] = options.path_topic
    if grid is not None:
        named["--grid-topic"] = options.grid_topic
    taken: set[str] = set()
    for option, name in named.items():
        if not _TOPIC.fullmatch(name):
            raise InputError(f"{option} {name}", "is no name of a topic", "letters, digits and _ between slashes: /a/b")
        if name.strip("/") in taken:
            raise InputError(f"{option} {name}", "is used twice", "give each message a topic of its own")
        taken.add(name.strip("/"))
