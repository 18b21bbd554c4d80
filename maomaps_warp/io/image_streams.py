"""Frames from image files on disk."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from maomaps_warp.errors import InputError
from maomaps_warp.io.images import check_image_size, read_color_image, read_depth_image
from maomaps_warp.io.read_ahead import ahead
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream


@dataclass(frozen=True)
class ImageFiles:
    """The files of one frame.

    Attributes:
        depth: a 16-bit image.
        color: the colour image of the same view and size, or None.
        stamp_ns: nanoseconds, or None where there are no stamps.
    """

    depth: Path
    color: Path | None
    stamp_ns: int | None = None


def stream_images(folder: Path, images: Sequence[ImageFiles], camera: Camera, scale: float) -> FrameStream:
    """Frames of these images in this order, read when their turn comes, a few ahead.

    Args:
        folder: where they come from, for messages.
        images: at least one; the depth of the first is read at once, so that a wrong camera is found early.
        camera: of every image.
        scale: metres per unit of the depth images.

    Raises:
        InputError: there are no images. While reading: an image is damaged or not of the camera's size.
    """
    if not images:
        raise InputError(folder, "holds no depth images", "PNG files in depth/ are expected")
    _read_frame(0, images[0], camera, scale, with_colors=False)

    def read(with_colors: bool) -> Iterator[Frame]:
        return ahead(
            lambda index: _read_frame(index, images[index], camera, scale, with_colors), iter(range(len(images)))
        )

    return FrameStream(camera, len(images), read, str(folder))


def color_notes(images: Sequence[ImageFiles]) -> tuple[str, ...]:
    """How many frames have no colours, if any."""
    without = sum(image.color is None for image in images)
    return (f"{without} of {len(images)} depth images have no colour image",) if without else ()


def _read_frame(index: int, image: ImageFiles, camera: Camera, scale: float, with_colors: bool) -> Frame:
    depth = read_depth_image(image.depth, scale=scale)
    colors = read_color_image(image.color) if with_colors and image.color else None
    check_image_size(depth.shape, camera, image.depth, "give the camera of these images with --camera")
    if image.color and colors is not None:
        check_image_size(colors.shape[:2], camera, image.color, "scale the colour images to the depth, or remove them")
    return Frame(index, image.stamp_ns, depth, colors)
