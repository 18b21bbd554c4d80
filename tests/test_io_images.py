from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from bags import png
from PIL import Image
from shared_data import shared_data

from maomaps_warp.errors import InputError
from maomaps_warp.io.images import (
    decode_color,
    decode_compressed_color,
    decode_compressed_depth,
    decode_depth,
    read_color_image,
    read_depth_image,
)

RAW = np.array([[0, 1, 5000], [65534, 65535, 300]], np.uint16)
#: RAW in metres at 1 mm a unit, by hand: 0 and 65535 are missing.
METRES = np.array([[0, 0.001, 5], [65.534, 0, 0.3]], np.float32)


def saved(path: Path, pixels: np.ndarray) -> Path:
    Image.fromarray(pixels).save(path)
    return path


def test_a_16_bit_png_is_scaled_to_metres_and_its_missing_values_become_zero(tmp_path: Path) -> None:
    path = saved(tmp_path / "depth.png", RAW)
    depth = read_depth_image(path, scale=0.001)
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, METRES)
    tum = read_depth_image(path, scale=1 / 5000)
    np.testing.assert_array_equal(tum, np.where(METRES > 0, RAW / 5000, 0).astype(np.float32))


@pytest.mark.parametrize("maximum", [65535, 65534, 5000, 256])
@pytest.mark.parametrize("head", [b"P5\n3 2\n%d\n", b"P5 # made by hand\n# 3 x 2\n3\n2 %d "])
def test_a_16_bit_pgm_is_read_raw_whatever_maximum_it_states(maximum: int, head: bytes, tmp_path: Path) -> None:
    path = tmp_path / "depth.pgm"
    path.write_bytes(head % maximum + RAW.astype(">u2").tobytes())
    np.testing.assert_array_equal(read_depth_image(path, scale=0.001), METRES)


def test_real_depth_images_are_divided_by_5000() -> None:
    for path in sorted((shared_data("rgbd_tum_fr1_rpy_a") / "depth").iterdir())[:3]:
        raw = np.asarray(Image.open(path)).astype(np.float64)
        assert 0 < (raw == 0).mean() < 1
        np.testing.assert_array_equal(read_depth_image(path, scale=1 / 5000), (raw / 5000).astype(np.float32))


@pytest.mark.parametrize(
    "pixels",
    [np.zeros((2, 3), np.uint8), np.zeros((2, 3, 3), np.uint8), np.zeros((2, 3, 4), np.uint8)],
    ids=["8-bit", "RGB", "RGBA"],
)
def test_an_8_bit_or_colour_image_is_no_depth_image(pixels: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"depth\.png: a \w+ image where 16-bit depth is expected"):
        read_depth_image(saved(tmp_path / "depth.png", pixels), scale=0.001)


def test_an_8_bit_pgm_is_no_depth_image(tmp_path: Path) -> None:
    path = tmp_path / "depth.pgm"
    path.write_bytes(b"P5 3 2 255\n" + bytes(6))
    with pytest.raises(InputError, match="16-bit depth is expected"):
        read_depth_image(path, scale=0.001)


def test_a_depth_image_is_no_colour_image(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is this a depth image"):
        read_color_image(saved(tmp_path / "depth.png", RAW))


@pytest.mark.parametrize("suffix", ["png", "pgm", "jpg"])
def test_an_image_cut_anywhere_is_refused_with_its_name(suffix: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    path = tmp_path / f"image.{suffix}"
    if suffix == "pgm":
        path.write_bytes(b"P5\n40 30\n65535\n" + rng.bytes(40 * 30 * 2))
    elif suffix == "png":
        saved(path, rng.integers(0, 65536, (30, 40), dtype=np.uint16))
    else:
        saved(path, rng.integers(0, 256, (30, 40, 3), dtype=np.uint8))
    data = path.read_bytes()
    read = read_color_image if suffix == "jpg" else lambda x: read_depth_image(x, scale=0.001)
    assert read(path).shape[:2] == (30, 40)
    # A PNG is whole without its last chunk IEND (12 bytes), a JPEG without its two bytes of end.
    for cut in [*range(0, min(len(data), 80)), *range(80, len(data) - 12, 97)]:
        path.write_bytes(data[:cut])
        with pytest.raises(InputError) as caught:
            read(path)
        assert caught.value.where == str(path)


def test_a_missing_image_is_refused(tmp_path: Path) -> None:
    for read in (read_color_image, lambda x: read_depth_image(x, scale=1.0)):
        with pytest.raises(InputError, match=r"none\.png: no such image"):
            read(tmp_path / "none.png")


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
def test_millimetres_are_decoded_in_both_byte_orders_with_padded_rows(encoding: str, big: bool) -> None:
    order = ">" if big else "<"
    rows = b"".join(struct.pack(order + "3H", *row.tolist()) + b"\xee\xee\xee" for row in RAW)
    depth = decode_depth(rows[:-3], 2, 3, 9, encoding, big)  # the last row may end without its padding
    np.testing.assert_array_equal(depth, METRES)


@pytest.mark.parametrize("big", [False, True])
def test_metres_are_decoded_bit_by_bit_and_what_is_no_depth_becomes_zero(big: bool) -> None:
    values = [0.1, 3.3333333, 0.0, float("nan"), float("inf"), -float("inf"), -1.0, 65535.0]
    data = struct.pack((">" if big else "<") + "8f", *values)
    depth = decode_depth(np.frombuffer(data, np.uint8), 2, 4, 16, "32FC1", big)
    np.testing.assert_array_equal(depth.ravel(), np.array([0.1, 3.3333333, 0, 0, 0, 0, 0, 0], np.float32))
    assert depth.flags.writeable


@pytest.mark.parametrize(
    ("size", "height", "width", "step"),
    [(11, 2, 3, 6), (12, 2, 3, 4), (0, 0, 0, 0), (12, 0, 3, 6), (12, 2, 0, 0)],
)
def test_an_image_that_contradicts_its_size_is_refused(size: int, height: int, width: int, step: int) -> None:
    with pytest.raises(InputError, match=r"run\.bag, topic /depth"):
        decode_depth(bytes(size), height, width, step, "16UC1", False, "run.bag, topic /depth")


@pytest.mark.parametrize(
    ("encoding", "channels", "order"),
    [("rgb8", 3, [0, 1, 2]), ("bgr8", 3, [2, 1, 0]), ("rgba8", 4, [0, 1, 2]), ("bgra8", 4, [2, 1, 0])],
)
def test_colours_are_decoded_from_every_order_of_channels(encoding: str, channels: int, order: list[int]) -> None:
    stored = np.random.default_rng(6).integers(0, 256, (4, 5, channels), dtype=np.uint8)
    padded = np.concatenate([stored.reshape(4, -1), np.full((4, 3), 7, np.uint8)], axis=1)
    found = decode_color(padded.tobytes(), 4, 5, padded.shape[1], encoding)
    for channel in range(3):
        np.testing.assert_array_equal(found[:, :, channel], stored[:, :, order[channel]])


def test_grey_becomes_three_equal_channels() -> None:
    found = decode_color(bytes([1, 2, 3, 4]), 2, 2, 2, "mono8")
    assert found.tolist() == [[[1] * 3, [2] * 3], [[3] * 3, [4] * 3]]


def test_unknown_encodings_are_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'bayer_rggb8'.*rgb8, bgr8"):
        decode_color(bytes(4), 2, 2, 2, "bayer_rggb8")
    with pytest.raises(InputError, match=r"'64FC1'.*32FC1, 16UC1, mono16"):
        decode_depth(bytes(32), 2, 2, 16, "64FC1", False)


@pytest.mark.parametrize("image_format", ["16UC1; compressedDepth", "16UC1; compressedDepth png"])
def test_compressed_millimetres_are_decoded_bit_by_bit(image_format: str) -> None:
    blob = struct.pack("<iff", 0, 0.0, 0.0) + png(RAW)
    np.testing.assert_array_equal(decode_compressed_depth(blob, image_format), METRES)


def test_a_bare_png_of_millimetres_is_decoded() -> None:
    np.testing.assert_array_equal(decode_compressed_depth(png(RAW), "16UC1; png compressed "), METRES)


def test_quantised_inverse_depth_is_decoded_by_its_formula() -> None:
    # depth = A / (value - B); value 0 is missing, and so is what does not come out positive.
    quant_a, quant_b = 10100.0, -1009.0
    values = np.array([[0, 1, 91], [1, 4041, 9091]], np.uint16)
    blob = struct.pack("<iff", 0, quant_a, quant_b) + png(values)
    found = decode_compressed_depth(blob, "32FC1; compressedDepth png")
    expected = [[0, 10100 / 1010, 10100 / 1100], [10, 10100 / 5050, 1]]
    np.testing.assert_array_equal(found, np.array(expected, np.float32))

    behind = struct.pack("<iff", 0, quant_a, 91.0) + png(values)
    found = decode_compressed_depth(behind, "32FC1; compressedDepth")
    assert found[0].tolist() == [0, 0, 0] and found[1, 0] == 0 and (found[1, 1:] > 0).all()


@pytest.mark.parametrize(
    ("blob", "image_format", "found"),
    [
        (bytes(12), "16UC1; compressedDepth rvl", "rvl"),
        (bytes(5), "16UC1; compressedDepth", "5 bytes"),
        (bytes(40), "16UC1; compressedDepth", "cannot be read"),
        (struct.pack("<iff", 0, 0, 0) + png(RAW)[:-30], "16UC1; compressedDepth", "cannot be read"),
        (png(np.zeros((2, 2), np.uint8)), "16UC1; png compressed", "16-bit depth is expected"),
        (png(RAW), "32FC1; png compressed", "needs compressedDepth"),
        (png(RAW), "rgb8; jpeg compressed bgr8", "jpeg"),
    ],
)
def test_what_is_no_compressed_depth_is_refused(blob: bytes, image_format: str, found: str) -> None:
    with pytest.raises(InputError, match=f"run.bag, topic /d.*{found}"):
        decode_compressed_depth(blob, image_format, "run.bag, topic /d")


def test_compressed_colours_are_decoded() -> None:
    pixels = np.random.default_rng(7).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    np.testing.assert_array_equal(decode_compressed_color(png(pixels), "rgb"), pixels)
    stream = io.BytesIO()
    Image.new("RGB", (16, 8), (200, 30, 90)).save(stream, "JPEG", quality=95)
    found = decode_compressed_color(stream.getvalue(), "rgb")
    assert found.shape == (8, 16, 3)
    # JPEG rounds colours by a few of 255 steps.
    assert np.abs(found.astype(int) - [200, 30, 90]).max() <= 3
    with pytest.raises(InputError, match="rgb: the image cannot be read"):
        decode_compressed_color(b"nonsense", "rgb")
