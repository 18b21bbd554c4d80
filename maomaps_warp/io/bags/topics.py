"""Which topics of a bag can serve as what."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.messages import COMPRESSED_IMAGE, IMAGE, image_encoding, image_role
from maomaps_warp.io.bags.reading import Bag, Topic, open_bag

POSE_TYPES = (
    "nav_msgs/msg/Path",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
GRID_TYPE = "nav_msgs/msg/OccupancyGrid"

Role = Literal["poses", "clouds", "depths", "colors", "camera_infos", "grids"]
_ROLE_WORDS: dict[Role, str] = {
    "poses": "poses (Path, Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped)",
    "clouds": "point clouds (PointCloud2)",
    "depths": "depth images (32FC1, 16UC1, mono16, compressedDepth)",
    "colors": "colour images (rgb8, bgr8, rgba8, bgra8, mono8, jpeg, png)",
    "camera_infos": "intrinsics (CameraInfo)",
    "grids": "maps of the ground (OccupancyGrid)",
}


@dataclass(frozen=True, eq=False)
class BagContents:
    """The topics of an open bag by what they can serve as. Topics without messages are among the others.

    Attributes:
        bag: the bag.
        wanted: names that the user gave, in any role; each is in the bag and of use.
        topic_option: how the command line calls the option that names topics.
        poses: trajectories.
        clouds: maps.
        depths, colors: images, told apart by the encoding that their first message states.
        camera_infos: intrinsics.
        grids: maps of the ground; among the others unless they were asked for.
        others: everything else.
    """

    bag: Bag
    wanted: tuple[str, ...] = ()
    topic_option: str = "--topic"
    poses: tuple[Topic, ...] = ()
    clouds: tuple[Topic, ...] = ()
    depths: tuple[Topic, ...] = ()
    colors: tuple[Topic, ...] = ()
    camera_infos: tuple[Topic, ...] = ()
    grids: tuple[Topic, ...] = ()
    others: tuple[Topic, ...] = ()

    @property
    def path(self) -> Path:
        """Where the bag lies."""
        return self.bag.path

    @property
    def all(self) -> tuple[Topic, ...]:
        """Every topic."""
        usable = self.poses + self.clouds + self.depths + self.colors + self.camera_infos + self.grids
        return usable + self.others

    def named(self, role: Role) -> tuple[Topic, ...]:
        """The topics of one role that the user named."""
        topics: tuple[Topic, ...] = getattr(self, role)
        return tuple(x for x in topics if any(x.is_named(name) for name in self.wanted))

    def choose(self, role: Role) -> Topic:
        """The topic to use in a role: the named one, else the only one.

        Raises:
            InputError: none or several; lists the candidates.
        """
        pool = self.named(role) or getattr(self, role)
        if len(pool) == 1:
            return pool[0]
        if not pool:
            raise InputError(self.path, f"no topic with {_ROLE_WORDS[role]}", _listing(self.all))
        hint = f"choose one with {self.topic_option} NAME: {'; '.join(map(str, pool))}"
        raise InputError(self.path, f"{len(pool)} topics with {_ROLE_WORDS[role]}", hint)

    def check_names(self) -> None:
        """Raise InputError unless every wanted name is a topic of the bag that can serve as something."""
        for name in self.wanted:
            found = [x for x in self.all if x.is_named(name)]
            if not found:
                raise InputError(self.path, f"no topic {name}", _listing(self.all))
            if all(x in self.others for x in found):
                usable = tuple(x for x in self.all if x not in self.others)
                reason = "no messages" if not found[0].count else f"{found[0]} is nothing that can be scored"
                raise InputError(f"{self.path}, topic {name}", reason, _listing(usable))

    def check_depth_is_readable(self) -> tuple[str, ...]:
        """A note if images hold no depth; raises InputError if one was meant to: by its name, or of no known encoding.

        Naming topics that are no images says that no map is wanted.
        """
        unknown = tuple(x for x in self.others if x.encoding)
        meant = unknown + tuple(x for x in self.colors if "depth" in x.name.lower())
        if self.clouds or self.depths or (self.wanted and not any(self.named("colors"))):
            return ()
        if meant:
            raise InputError(
                f"{self.path}, topic {meant[0].name}",
                f"images of encoding {meant[0].encoding!r} hold no depth that can be read",
                f"allowed: {_ROLE_WORDS['depths']}; for the poses alone name their topic with {self.topic_option} NAME",
            )
        return (f"no map: {self.colors[0].name} holds colours and no topic holds depth",) if self.colors else ()

    def check_named_images(self) -> None:
        """Raise InputError if a colour image was named and no topic holds depth, beside which colours are read."""
        named = self.named("colors")
        if named and not self.depths:
            found = f"{named[0]} holds no depth, nor does any other topic of the bag"
            raise InputError(f"{self.path}, topic {named[0].name}", found, f"allowed: {_ROLE_WORDS['depths']}")


@contextmanager
def open_contents(
    path: Path, wanted: Sequence[str] = (), topic_option: str = "--topic", *, with_grids: bool = False
) -> Iterator[BagContents]:
    """Open a bag and tell what its topics can serve as; reads one message of each image topic.

    Args:
        path: the bag, of any kind.
        wanted: names of topics that the user gave.
        topic_option: how the command line calls the option that names topics, for errors.
        with_grids: whether maps of the ground are of use.

    Raises:
        InputError: not a bag, a damaged one, or one without a wanted topic.
    """
    with open_bag(path) as bag:
        roles: dict[str, list[Topic]] = {}
        for topic in bag.topics:
            role, described = _role_of(bag, topic)
            roles.setdefault(role if role != "grids" or with_grids else "others", []).append(described)
        contents = BagContents(
            bag, tuple(wanted), topic_option, **{role: tuple(topics) for role, topics in roles.items()}
        )
        contents.check_names()
        yield contents


def _role_of(bag: Bag, topic: Topic) -> tuple[str, Topic]:
    if not topic.count:
        return "others", topic
    if topic.type in POSE_TYPES:
        return "poses", topic
    if topic.type == CLOUD_TYPE:
        return "clouds", topic
    if topic.type == CAMERA_INFO_TYPE:
        return "camera_infos", topic
    if topic.type == GRID_TYPE:
        return "grids", topic
    if topic.type in (IMAGE, COMPRESSED_IMAGE):
        encoding = image_encoding(bag.first_message(topic))
        return image_role(topic.type, encoding), replace(topic, encoding=encoding)
    return "others", topic


def _listing(topics: Sequence[Topic]) -> str:
    if not topics:
        return "the bag holds no messages of use"
    return "topics in this bag: " + "; ".join(map(str, topics))
