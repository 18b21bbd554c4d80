"""Depth and colour images: from files, and from the buffers and compressed blobs of ROS messages.

Depth leaves this file as float32 metres along the optical axis with 0 for "missing". Missing in the source is
0, NaN, an infinity, a negative number, or 65535 (the largest 16-bit value, which some drivers write for "too
far").
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError

if TYPE_CHECKING:
    from PIL.Image import Image

    from maomaps_warp.model.camera import Camera

#: A colour image belongs to the depth image of the nearest stamp if they are at most this far apart, nanoseconds
#: (the default of TUM's associate.py).
MAX_COLOR_GAP_NS = 20_000_000

#: Raw 16-bit value that means "no measurement", beside 0.
MISSING_16BIT = 65535
#: The same as the bits of a float32.
_MISSING_BITS = int(np.float32(MISSING_16BIT).view(np.uint32))
#: Pixel type and metres per unit of the depth encodings of sensor_msgs/Image (REP 118).
DEPTH_ENCODINGS = {"32FC1": ("f4", 1.0), "16UC1": ("u2", 1e-3), "mono16": ("u2", 1e-3)}
#: Where red, green and blue lie in a pixel of the colour encodings of sensor_msgs/Image, and bytes per pixel.
COLOR_ENCODINGS = {
    "rgb8": ((0, 1, 2), 3),
    "bgr8": ((2, 1, 0), 3),
    "rgba8": ((0, 1, 2), 4),
    "bgra8": ((2, 1, 0), 4),
    "mono8": ((0, 0, 0), 1),
}
#: Pillow's names of single-channel images with more than 8 bits.
_WIDE_MODES = {"I;16", "I;16B", "I;16L", "I"}
#: How compressedDepth starts: int32 format, float32 A and B (ROS's compressed_depth_image_transport).
_COMPRESSED_DEPTH_HEADER = struct.Struct("<iff")


def read_depth_image(path: Path, *, scale: float) -> NDArray[np.float32]:
    """Read a 16-bit PNG or PGM.

    Args:
        path: the file.
        scale: metres per unit of the stored integers (0.001 for millimetres, 1 / 5000 for TUM RGB-D).

    Returns:
        (H, W) float32, metres along the optical axis; 0 = missing.

    Raises:
        InputError: the file is absent, damaged, or not a single-channel 16-bit image.
    """
    with _image_errors(path):
        data = path.read_bytes()
        # Pillow stretches a PGM whose stated maximum is less than 65535; the raw values are depth.
        raw = _read_pgm16(data) if data[:2] == b"P5" else None
    if raw is None:
        raw = _wide_pixels(_open_image(data, path), path)
    return _metres(raw, scale)


def read_color_image(path: Path) -> NDArray[np.uint8]:
    """Read a colour image in any format that Pillow knows.

    Returns:
        (H, W, 3) uint8 RGB.

    Raises:
        InputError: the file is absent, damaged, or a depth image.
    """
    with _image_errors(path):
        data = path.read_bytes()
    return decode_compressed_color(data, path)


def decode_depth(
    data: bytes | NDArray[np.uint8],
    height: int,
    width: int,
    step: int,
    encoding: str,
    is_bigendian: bool,
    where: object = "depth image",
) -> NDArray[np.float32]:
    """Decode the pixels of a sensor_msgs/Image.

    Args:
        data: the rows, one after another, each of `step` bytes of which the last may be padding.
        height, width: pixels.
        step: bytes from one row to the next.
        encoding: a key of DEPTH_ENCODINGS.
        is_bigendian: byte order of the pixels.
        where: file and topic, for messages.

    Returns:
        (H, W) float32, metres along the optical axis; 0 = missing.

    Raises:
        InputError: unknown encoding, or fewer bytes than the size needs.
    """
    if encoding not in DEPTH_ENCODINGS:
        raise InputError(where, f"depth encoding {encoding!r}", f"known: {', '.join(DEPTH_ENCODINGS)}")
    kind, scale = DEPTH_ENCODINGS[encoding]
    # Spelt out, or else NumPy keeps a mark of the order that other libraries (Open3D) do not take for their own.
    dtype = np.dtype(f"{'>' if is_bigendian else '<'}{kind}")
    # A copy where rows are padded or start anywhere: kernels want aligned arrays.
    return _metres(np.require(_rows(data, (height, width), step, dtype, where), requirements=["C", "A"]), scale)


def decode_color(
    data: bytes | NDArray[np.uint8],
    height: int,
    width: int,
    step: int,
    encoding: str,
    where: object = "colour image",
) -> NDArray[np.uint8]:
    """Decode the pixels of a sensor_msgs/Image; arguments and errors as in `decode_depth`.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    if encoding not in COLOR_ENCODINGS:
        raise InputError(where, f"colour encoding {encoding!r}", f"known: {', '.join(COLOR_ENCODINGS)}")
    order, channels = COLOR_ENCODINGS[encoding]
    pixels = _rows(data, (height, width * channels), step, np.dtype("u1"), where).reshape(height, width, channels)
    if order == (0, 1, 2) and channels == 3:
        return np.ascontiguousarray(pixels)
    rgb = np.empty((height, width, 3), np.uint8)
    for channel, place in enumerate(order):
        rgb[:, :, channel] = pixels[:, :, place]
    return rgb


def decode_compressed_depth(
    data: bytes | NDArray[np.uint8], image_format: str, where: object = "compressed depth image"
) -> NDArray[np.float32]:
    """Decode a depth image of a sensor_msgs/CompressedImage.

    Known are "16UC1; compressedDepth" and "32FC1; compressedDepth" (a 12-byte header, then a 16-bit PNG; the
    second stores quantised inverse depth) and "16UC1; png compressed" (a bare PNG of millimetres).

    Args:
        data: the message's blob.
        image_format: the message's `format`.
        where: file and topic, for messages.

    Returns:
        (H, W) float32, metres along the optical axis; 0 = missing.

    Raises:
        InputError: another format (RVL, say), or a damaged blob.
    """
    blob = bytes(data)
    encoding, _, transport = (part.strip() for part in image_format.partition(";"))
    if DEPTH_ENCODINGS.get(encoding) is None or "rvl" in transport.lower():
        raise InputError(
            where,
            f"compressed depth format {image_format!r}",
            "known: PNG of 16UC1 or 32FC1; or record the raw depth topic",
        )
    kind, scale = DEPTH_ENCODINGS[encoding]
    quantisation = None
    if "compresseddepth" in transport.lower():
        if len(blob) < _COMPRESSED_DEPTH_HEADER.size:
            raise InputError(where, f"{len(blob)} bytes are no compressedDepth image", "the message is damaged")
        quantisation = _COMPRESSED_DEPTH_HEADER.unpack_from(blob)[1:]
        blob = blob[_COMPRESSED_DEPTH_HEADER.size :]
    raw = _wide_pixels(_open_image(blob, where), where)
    if kind == "u2":
        return _metres(raw, scale)
    if quantisation is None:
        raise InputError(where, f"compressed depth format {image_format!r}", "32FC1 needs compressedDepth")
    return _from_inverse_depth(raw, *quantisation)


def decode_compressed_color(data: bytes | NDArray[np.uint8], where: object) -> NDArray[np.uint8]:
    """Decode a JPEG or PNG blob: (H, W, 3) uint8 RGB; InputError if it is damaged or not an 8-bit image."""
    image = _open_image(bytes(data), where)
    if image.mode in _WIDE_MODES or image.mode == "F":
        raise InputError(where, f"a {image.mode} image where a colour image is expected", "is this a depth image?")
    with _image_errors(where):
        return np.array(image.convert("RGB"), dtype=np.uint8)


def check_image_size(shape: tuple[int, ...], camera: Camera, where: object, hint: str) -> None:
    """Raise InputError, with this way out, if an image of this (height, width) is not of the camera's size."""
    if shape != (camera.height, camera.width):
        found = f"the image is {shape[1]}x{shape[0]}, the camera {camera.width}x{camera.height}"
        raise InputError(where, found, hint)


def _metres(raw: NDArray[Any], scale: float) -> NDArray[np.float32]:
    """Raw depth to float32 metres with 0 for everything that is not a measurement; `raw` itself where it is that."""
    # As integers, floats from 0 to the mark of a missing value are smaller than all others, NaN and -0 included.
    is_plain = raw.dtype == np.float32 and raw.flags.c_contiguous and raw.flags.aligned
    if is_plain and raw.view(np.uint32).max(initial=0) < _MISSING_BITS:
        return raw
    valid = np.isfinite(raw) & (raw > 0) & (raw != MISSING_16BIT)
    # Scaled in float64 and rounded once, so that equal depths are equal whatever they were stored as.
    metres = raw if scale == 1.0 else raw.astype(np.float64) * scale
    return np.where(valid, metres, 0.0).astype(np.float32, copy=False)


def _from_inverse_depth(raw: NDArray[np.uint16], quant_a: float, quant_b: float) -> NDArray[np.float32]:
    """Undo the quantisation of compressed_depth_image_transport: depth = A / (value - B), metres."""
    gap = raw.astype(np.float64) - quant_b
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = np.where(raw > 0, quant_a / gap, 0.0).astype(np.float32)
    return _metres(depth, 1.0)


def _rows(
    data: bytes | NDArray[np.uint8], shape: tuple[int, int], step: int, dtype: np.dtype[Any], where: object
) -> NDArray[Any]:
    """View of a (rows, values) image whose rows are `step` bytes apart."""
    rows, values = shape
    row_bytes = values * dtype.itemsize
    needed = (rows - 1) * step + row_bytes
    if rows < 1 or values < 1 or step < row_bytes or len(data) < needed:
        raise InputError(
            where,
            f"{len(data)} bytes in rows of {step} cannot hold {rows} rows of {row_bytes} bytes",
            "the message is damaged, or its width, height and step are wrong",
        )
    return np.ndarray(shape, dtype, np.ascontiguousarray(np.frombuffer(data, np.uint8)), 0, (step, dtype.itemsize))


def _wide_pixels(image: Image, where: object) -> NDArray[np.uint16]:
    """Pixels of a single-channel 16-bit image, (H, W) uint16."""
    if image.mode not in _WIDE_MODES:
        raise InputError(
            where,
            f"a {image.mode} image where 16-bit depth is expected",
            "depth images have one channel of 16 bits; was it converted, or is it the colour image?",
        )
    with _image_errors(where):
        pixels = np.array(image)
    if pixels.min(initial=0) < 0 or pixels.max(initial=0) > MISSING_16BIT:
        raise InputError(where, "depth values beyond 16 bits", "depth images have one channel of 16 bits")
    return pixels.astype(np.uint16)


def _read_pgm16(data: bytes) -> NDArray[np.uint16] | None:
    """Pixels of a binary PGM of two bytes a pixel, big-endian; None if it has one byte a pixel."""
    numbers: list[int] = []
    position = 2
    while len(numbers) < 3:
        end = position
        while data[end : end + 1].isspace():
            end += 1
        if data[end : end + 1] == b"#":
            position = data.index(b"\n", end)
            continue
        start = end
        while data[end : end + 1].isdigit():
            end += 1
        numbers.append(int(data[start:end]))
        position = end
    width, height, maximum = numbers
    if maximum < 256:
        return None
    # Exactly one white-space byte separates the header from the pixels.
    return np.frombuffer(data, ">u2", width * height, position + 1).reshape(height, width).astype(np.uint16)


def _open_image(data: bytes, where: object) -> Image:
    """A loaded Pillow image."""
    from PIL import Image as images

    with _image_errors(where):
        image = images.open(io.BytesIO(data))
        image.load()
        return image


@contextmanager
def _image_errors(where: object) -> Iterator[None]:
    """Turn what Pillow and the operating system raise for a bad image into an InputError."""
    from PIL.Image import DecompressionBombError

    try:
        yield
    except FileNotFoundError as error:
        raise InputError(where, "no such image") from error
    # Pillow's decoders raise all of these for damaged data, SyntaxError for a broken PNG chunk included.
    except (OSError, SyntaxError, ValueError, EOFError, struct.error, IndexError, OverflowError) as error:
        raise InputError(where, f"the image cannot be read: {error}", "it is damaged or not an image") from error
    except DecompressionBombError as error:
        raise InputError(where, f"the image is too large: {error}") from error
