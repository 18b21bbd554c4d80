"""RGB-D frames and their camera from the topics of a bag."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.messages import color_of, depth_of, header_stamp_ns
from maomaps_warp.io.bags.reading import Bag, Topic, open_bag
from maomaps_warp.io.bags.topics import BagContents
from maomaps_warp.io.cameras import camera_from_info
from maomaps_warp.io.images import MAX_COLOR_GAP_NS, check_image_size
from maomaps_warp.io.read_ahead import ahead
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream

_DISORDER_HINT = "stamps must increase; do two nodes publish here, or was the bag played in a loop?"
#: Images of each kind held back at most while waiting for partners; about half a second of a usual camera.
MAX_HELD_IMAGES = 16


def read_bag_camera(contents: BagContents) -> Camera | None:
    """The camera of a bag's depth images, from the first sensor_msgs/CameraInfo that belongs to them.

    Its topic is the one that the user named, else the one in the depth topic's namespace, else the only one.

    Returns:
        The camera, or None if the bag has no camera_info topic.

    Raises:
        InputError: several candidates (lists them), or a camera that is distorted or not calibrated.
    """
    if not contents.camera_infos:
        return None
    infos = contents.named("camera_infos")
    if not infos and contents.depths:
        depth = contents.choose("depths")
        infos = tuple(x for x in contents.camera_infos if _same_namespace(depth.name, x.name))
    topic = infos[0] if len(infos) == 1 else contents.choose("camera_infos")
    return camera_from_info(contents.bag.first_message(topic), f"{contents.path}, topic {topic.name}")


def read_bag_frames(
    contents: BagContents, *, camera: Camera | None, max_color_gap_ns: int = MAX_COLOR_GAP_NS
) -> FrameStream:
    """The depth images of a bag's named topic, or else of the only one, with their colour images, as a stream.

    Depth is recognised by its encoding (32FC1 in metres; 16UC1 and mono16 in millimetres; compressedDepth).
    A depth image takes the colour image of the nearest header stamp, at most `max_color_gap_ns` away; without
    such a partner it has no colours. At most MAX_HELD_IMAGES of each wait for partners, so that memory stays
    flat: colours that were logged later than that many depth images are not joined.

    Args:
        contents: the open bag; the stream opens it anew for each reading.
        camera: the intrinsics; None to take them from the bag's camera_info.
        max_color_gap_ns: largest distance of the stamps of a depth image and its colours, ns; 0: equal stamps.

    Raises:
        InputError: no or several candidates (lists them), no camera; and while reading: damaged images,
            stamps that are zero or do not increase, images of another size than the camera's.
    """
    path = contents.path
    depth = contents.choose("depths")
    camera = camera or read_bag_camera(contents)
    if camera is None:
        raise InputError(path, "no camera_info topic to tell the intrinsics", "give --camera (320x240@90, or a file)")
    intrinsics = camera

    def read(with_colors: bool) -> Iterator[Frame]:
        color = contents.choose("colors") if with_colors and contents.colors else None
        return _read_frames(path, depth, color, intrinsics, max_color_gap_ns)

    return FrameStream(camera=intrinsics, count=depth.count, read=read, source=f"{path}, topic {depth.name}")


def _read_frames(
    path: Path, depth: Topic, color: Topic | None, camera: Camera, max_color_gap_ns: int
) -> Iterator[Frame]:
    depth_place = f"{path}, topic {depth.name}"
    color_place = f"{path}, topic {color.name}" if color is not None else ""

    def decoded(job: _Job) -> Frame:
        where = f"{depth_place}, message {job.index + 1}"
        image = depth_of(job.depth, where)
        check_image_size(image.shape, camera, where, "give the camera of these images with --camera")
        colors = None
        if job.color is not None:
            colors = color_of(job.color, color_place)
            check_image_size(colors.shape[:2], camera, color_place, "use images registered to the depth")
        return Frame(index=job.index, stamp_ns=job.stamp_ns, depth=image, colors=colors)

    with (
        open_bag(path) as bag,
        closing(_stamped(bag, [depth.name] if color is None else [depth.name, color.name])) as stamped,
        closing(_jobs(stamped, depth_place, depth.name, color is not None, max_color_gap_ns)) as jobs,
        closing(ahead(decoded, jobs)) as frames,
    ):
        yield from frames


@dataclass(frozen=True, eq=False)
class _Job:
    """A frame to decode: its messages."""

    index: int
    stamp_ns: int
    depth: Any
    color: Any | None


def _jobs(
    stamped: Iterable[tuple[str, int, Any]], place: str, depth_name: str, with_colors: bool, max_gap_ns: int
) -> Generator[_Job]:
    """Pairs of messages by ascending stamp; `place` names the depth topic in errors."""
    last_ns = 0
    pairs = _joined(stamped, depth_name, max_gap_ns) if with_colors else ((x, None) for _, *x in stamped)
    for index, ((stamp_ns, message), partner) in enumerate(pairs):
        if stamp_ns <= last_ns:
            where = f"{place}, message {index + 1}"
            raise InputError(where, f"the stamp {stamp_ns} ns does not follow {last_ns} ns", _DISORDER_HINT)
        last_ns = stamp_ns
        yield _Job(index, stamp_ns, message, partner)


def _stamped(bag: Bag, names: Sequence[str]) -> Generator[tuple[str, int, Any]]:
    """Topic, header stamp and message of every message of `names`."""
    counts = dict.fromkeys(names, 0)
    with closing(bag.messages(names)) as messages:
        for name, _, message in messages:
            counts[name] += 1
            where = f"{bag.path}, topic {name}, message {counts[name]}"
            yield name, header_stamp_ns(message.header, where), message


def _joined(
    stamped: Iterable[tuple[str, int, Any]], depth_name: str, max_gap_ns: int
) -> Iterator[tuple[tuple[int, Any], Any | None]]:
    """Depth messages in their order, each with the colour message of the nearest stamp or None.

    A depth message is settled as soon as a colour message is not older than it: later ones are only farther.
    """
    depths: deque[tuple[int, Any]] = deque()
    colors: deque[tuple[int, Any]] = deque(maxlen=MAX_HELD_IMAGES)
    for name, stamp_ns, message in stamped:
        (depths if name == depth_name else colors).append((stamp_ns, message))
        while depths and (len(depths) > MAX_HELD_IMAGES or (colors and colors[-1][0] >= depths[0][0])):
            yield depths[0], _nearest(colors, depths.popleft()[0], max_gap_ns)
    while depths:
        yield depths[0], _nearest(colors, depths.popleft()[0], max_gap_ns)


def _nearest(colors: Iterable[tuple[int, Any]], stamp_ns: int, max_gap_ns: int) -> Any | None:
    gap, message = min(
        ((abs(stamp - stamp_ns), message) for stamp, message in colors),
        key=lambda pair: pair[0],
        default=(max_gap_ns + 1, None),
    )
    return message if gap <= max_gap_ns else None


def _same_namespace(image: str, info: str) -> bool:
    """Whether a camera_info topic belongs to an image topic.

    /a/camera_info belongs to /a/image, and to what image_transport makes of it: /a/image/compressedDepth.
    """
    namespace = info.rpartition("/")[0]
    base = image.removesuffix("/compressedDepth").removesuffix("/compressed")
    return namespace == base.rpartition("/")[0]
