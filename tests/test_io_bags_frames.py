from __future__ import annotations

import itertools
import weakref
from dataclasses import replace
from pathlib import Path

import bags
import numpy as np
import pytest
from bag_samples import CAMERA, STEP_NS, T0_NS, bag_camera, bag_frames
from bags import BagKind, write_bag

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.frames import MAX_HELD_IMAGES, _joined
from maomaps_warp.io.images import MAX_COLOR_GAP_NS
from maomaps_warp.model.camera import Camera


def frame_bag(tmp_path: Path, depths: list[int], colors: list[int], delay: int = 0, name: str = "run.bag") -> Path:
    """Depth and colour images with these stamps, ms; a colour image of stamp t is filled with t mod 256."""
    entries = []
    for ms in depths:
        stamp = T0_NS + ms * 10**6
        image = np.full((CAMERA.height, CAMERA.width), 1.0, np.float32)
        entries.append(("/depth", stamp, bags.depth_message("ros1", stamp, image)))
    for ms in colors:
        stamp = T0_NS + ms * 10**6
        image = np.full((CAMERA.height, CAMERA.width, 3), ms % 256, np.uint8)
        entries.append(("/rgb", stamp + delay * 10**6, bags.color_message("ros1", stamp, image)))
    return write_bag(tmp_path / name, "ros1", entries)


@pytest.mark.parametrize("delay", [0, 1, 40, 150, -150])
def test_a_depth_image_takes_the_nearest_colour_image_within_20_ms(delay: int, tmp_path: Path) -> None:
    path = frame_bag(tmp_path, [100, 133, 166, 200, 300, 333], [90, 112, 140, 160, 220, 321, 400], delay)
    frames = list(bag_frames(path, camera=CAMERA).read(True))
    taken = [None if x.colors is None else int(x.colors[0, 0, 0]) for x in frames]
    assert taken == [90, 140, 160, 220, None, 321 % 256]


def test_memory_stays_flat_over_a_long_bag() -> None:
    class Item:
        pass

    alive: weakref.WeakSet[Item] = weakref.WeakSet()

    def stamped(topics: str):
        for i, topic in zip(range(2000), itertools.cycle(topics), strict=False):
            item = Item()
            alive.add(item)
            yield topic, i * STEP_NS, item

    for topics, held in (
        ("dc", 2),
        ("ddddddddddddddddddddddddddddddc", 2),
        ("ccccccccccccccccccccccccd", 2),
        ("d", 1),
    ):
        peak = 0
        for _ in _joined(stamped(topics), "d", MAX_COLOR_GAP_NS):
            peak = max(peak, len(alive))
        assert peak <= held * (MAX_HELD_IMAGES + 2), topics


def test_depth_of_another_size_than_the_camera_is_refused(tmp_path: Path) -> None:
    path = frame_bag(tmp_path, [0], [])
    stream = bag_frames(path, camera=Camera.from_fov(320, 240, 90.0))
    with pytest.raises(InputError, match="message 1: the image is 8x6, the camera 320x240"):
        list(stream.read(False))


def test_colour_of_another_size_than_depth_is_refused_only_when_asked_for(tmp_path: Path) -> None:
    depth = bags.depth_message("ros1", T0_NS, np.ones((6, 8), np.float32))
    color = bags.color_message("ros1", T0_NS, np.zeros((12, 16, 3), np.uint8))
    path = write_bag(tmp_path / "run.bag", "ros1", [("/depth", T0_NS, depth), ("/rgb", T0_NS, color)])
    stream = bag_frames(path, camera=CAMERA)
    assert len(list(stream.read(False))) == 1
    with pytest.raises(InputError, match="topic /rgb: the image is 16x12, the camera 8x6"):
        list(stream.read(True))


def test_frames_without_a_camera_ask_for_one(tmp_path: Path) -> None:
    path = frame_bag(tmp_path, [0], [])
    assert bag_camera(path) is None
    with pytest.raises(InputError, match="--camera"):
        bag_frames(path, camera=None)


def test_frames_whose_stamps_do_not_increase_are_refused(tmp_path: Path) -> None:
    for second in (0, -5):
        entries = [
            ("/depth", T0_NS + i, bags.depth_message("ros1", T0_NS + offset, np.ones((6, 8), np.float32)))
            for i, offset in enumerate((0, second))
        ]
        path = write_bag(tmp_path / f"{second}.bag", "ros1", entries)
        for with_colors in (True, False):
            with pytest.raises(InputError, match="message 2: the stamp"):
                list(bag_frames(path, camera=CAMERA).read(with_colors))


def test_the_camera_of_the_depth_namespace_is_taken_or_the_only_or_the_named_one(tmp_path: Path) -> None:
    def bag(name: str, *infos: str) -> Path:
        depth = bags.depth_message("ros1", T0_NS, np.ones((6, 8), np.float32))
        entries = [("/cam/depth/image", T0_NS, depth)]
        for i, topic in enumerate(infos):
            camera = replace(CAMERA, fx=10.0 + i)
            entries.append((topic, T0_NS, bags.camera_info("ros1", T0_NS, camera)))
        return write_bag(tmp_path / name, "ros1", entries)

    both = bag("both.bag", "/cam/rgb/camera_info", "/cam/depth/camera_info")
    assert bag_camera(both).fx == 11.0
    assert bag_camera(both, topics=["/cam/rgb/camera_info"]).fx == 10.0
    assert bag_camera(bag("only.bag", "/cam/rgb/camera_info")).fx == 10.0
    with pytest.raises(InputError, match=r"2 topics with intrinsics.*/a/camera_info.*/b/camera_info"):
        bag_camera(bag("neither.bag", "/a/camera_info", "/b/camera_info"))


@pytest.mark.parametrize("kind", ["ros1", "ros2-mcap"])
def test_a_distorted_or_uncalibrated_camera_is_refused(kind: BagKind, tmp_path: Path) -> None:
    bent = bags.camera_info(kind, T0_NS, CAMERA, (0.26, -0.95, 0, 0, 1.1))
    path = write_bag(tmp_path / "bent.bag", kind, [("/camera_info", T0_NS, bent)])
    with pytest.raises(InputError, match=r"topic /camera_info: lens distortion 0.26.*--camera"):
        bag_camera(path)
    blank = bags.camera_info(kind, T0_NS, CAMERA)
    (blank.K if kind == "ros1" else blank.k)[:] = 0
    path = write_bag(tmp_path / "blank.bag", kind, [("/camera_info", T0_NS, blank)])
    with pytest.raises(InputError, match=r"not calibrated.*--camera"):
        bag_camera(path)


def test_padded_rows_and_big_endian_depth_are_read(tmp_path: Path) -> None:
    pixels = np.array([[500, 1000, 65535], [0, 2500, 4000]], dtype=">u2")
    padded = np.concatenate([pixels.view(np.uint8), np.full((2, 5), 0xAB, np.uint8)], axis=1)
    item = bags.image("ros1", T0_NS, pixels, "16UC1")
    item.step, item.data = padded.shape[1], padded.ravel()
    path = write_bag(tmp_path / "run.bag", "ros1", [("/depth", T0_NS, item)])
    (frame,) = bag_frames(path, camera=Camera(3, 2, 1.0, 1.0, 1.0, 0.5)).read(False)
    np.testing.assert_array_equal(frame.depth, np.array([[0.5, 1, 0], [0, 2.5, 4]], np.float32))


def test_a_depth_image_with_too_few_bytes_is_refused_with_its_message(tmp_path: Path) -> None:
    item = bags.depth_message("ros1", T0_NS, np.ones((6, 8), np.float32))
    item.data = item.data[:-1]
    path = write_bag(tmp_path / "run.bag", "ros1", [("/depth", T0_NS, item)])
    with pytest.raises(InputError, match=f"{path}, topic /depth, message 1: 191 bytes"):
        list(bag_frames(path, camera=CAMERA).read(False))
