"""Which topics of a bag can serve as what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from maomaps_warp.errors import InputError
from maomaps_warp.io.bag_messages import COMPRESSED_IMAGE, IMAGE, image_encoding, image_role
from maomaps_warp.io.bag_reading import Bag, Topic, open_bag

POSE_TYPES = (
    "nav_msgs/msg/Path",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"

Role = Literal["poses", "clouds", "depths", "colors", "camera_infos"]
_ROLE_WORDS: dict[Role, str] = {
    "poses": "poses (Path, Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped)",
    "clouds": "point clouds (PointCloud2)",
    "depths": "depth images (32FC1, 16UC1, mono16, compressedDepth)",
    "colors": "colour images (rgb8, bgr8, rgba8, bgra8, mono8, jpeg, png)",
    "camera_infos": "intrinsics (CameraInfo)",
}
_TOPIC_OPTION = "--gt-topic/--est-topic NAME"


@dataclass(frozen=True)
class BagContents:
    """The topics of a bag by what they can serve as. Topics without messages are among the others.

    Attributes:
        path: the bag.
        poses: trajectories.
        clouds: maps.
        depths, colors: images, told apart by the encoding that their first message states.
        camera_infos: intrinsics.
        others: everything else.
    """

    path: Path
    poses: tuple[Topic, ...] = ()
    clouds: tuple[Topic, ...] = ()
    depths: tuple[Topic, ...] = ()
    colors: tuple[Topic, ...] = ()
    camera_infos: tuple[Topic, ...] = ()
    others: tuple[Topic, ...] = ()

    def of(self, role: Role) -> tuple[Topic, ...]:
        """The topics of one role."""
        topics: tuple[Topic, ...] = getattr(self, role)
        return topics

    @property
    def all(self) -> tuple[Topic, ...]:
        """Every topic."""
        usable = self.poses + self.clouds + self.depths + self.colors + self.camera_infos
        return usable + self.others

    def named(self, role: Role, wanted: Sequence[str]) -> tuple[Topic, ...]:
        """The topics of one role that the user named."""
        return tuple(x for x in self.of(role) if any(x.is_named(name) for name in wanted))

    def choose(self, role: Role, wanted: Sequence[str]) -> Topic:
        """The topic to use in a role: the named one, else the only one.

        Args:
            role: what it should serve as.
            wanted: names that the user gave, in any role; each must be in the bag and of use.

        Raises:
            InputError: none or several; lists the candidates.
        """
        self.check_names(wanted)
        pool = self.named(role, wanted) or self.of(role)
        if len(pool) == 1:
            return pool[0]
        if not pool:
            raise InputError(self.path, f"no topic with {_ROLE_WORDS[role]}", _listing(self.all))
        hint = f"choose one with {_TOPIC_OPTION}: {'; '.join(map(str, pool))}"
        raise InputError(self.path, f"{len(pool)} topics with {_ROLE_WORDS[role]}", hint)

    def check_names(self, wanted: Sequence[str]) -> None:
        """Raise InputError unless every name is a topic of the bag that can serve as something."""
        for name in wanted:
            found = [x for x in self.all if x.is_named(name)]
            if not found:
                raise InputError(self.path, f"no topic {name}", _listing(self.all))
            if all(x in self.others for x in found):
                usable = tuple(x for x in self.all if x not in self.others)
                reason = "no messages" if not found[0].count else f"{found[0]} is nothing that can be scored"
                raise InputError(f"{self.path}, topic {name}", reason, _listing(usable))

    def check_named_images(self, wanted: Sequence[str]) -> None:
        """Raise InputError if a colour image was named and no topic holds depth, beside which colours are read."""
        named = self.named("colors", wanted)
        if named and not self.depths:
            found = f"{named[0]} holds no depth, nor does any other topic of the bag"
            raise InputError(f"{self.path}, topic {named[0].name}", found, f"allowed: {_ROLE_WORDS['depths']}")


def describe_bag(path: Path) -> BagContents:
    """What the topics of a bag can serve as; reads one message of each image topic.

    Raises:
        InputError: not a bag, or a damaged one.
    """
    with open_bag(path) as bag:
        return contents_of(bag)


def contents_of(bag: Bag) -> BagContents:
    """What the topics of an open bag can serve as."""
    roles: dict[str, list[Topic]] = {}
    for topic in bag.topics:
        role, described = _role_of(bag, topic)
        roles.setdefault(role, []).append(described)
    return BagContents(bag.path, **{role: tuple(topics) for role, topics in roles.items()})


def _role_of(bag: Bag, topic: Topic) -> tuple[str, Topic]:
    if not topic.count:
        return "others", topic
    if topic.type in POSE_TYPES:
        return "poses", topic
    if topic.type == CLOUD_TYPE:
        return "clouds", topic
    if topic.type == CAMERA_INFO_TYPE:
        return "camera_infos", topic
    if topic.type in (IMAGE, COMPRESSED_IMAGE):
        encoding = image_encoding(bag.first_message(topic))
        return image_role(topic.type, encoding), replace(topic, encoding=encoding)
    return "others", topic


def _listing(topics: Sequence[Topic]) -> str:
    if not topics:
        return "the bag holds no messages of use"
    return "topics in this bag: " + "; ".join(map(str, topics))
