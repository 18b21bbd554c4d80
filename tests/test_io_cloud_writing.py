"""Clouds that are written, read back by other programs' readers and byte by byte."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from maomaps_warp.errors import InputError
from maomaps_warp.io.cloud_writing import CLOUD_SUFFIXES
from maomaps_warp.io.clouds import read_cloud, write_cloud, write_xyz

RNG = np.random.default_rng(5)
#: Metres. Numbers with all the digits of float64.
POINTS = RNG.normal(size=(400, 3)) * 30.0
COLORS = RNG.integers(0, 256, (400, 3), dtype=np.uint8)
#: Metres, beyond where float32 resolves a millimetre.
FAR = POINTS + [4_000_000.0, -700_000.0, 120.0]
#: Metres, relative to the coordinate's size: half a step of float32.
FLOAT32_STEP = 2.0**-24
every_suffix = pytest.mark.parametrize("suffix", CLOUD_SUFFIXES)
exact_suffixes = pytest.mark.parametrize("suffix", [".ply", ".txt", ".xyz", ".npz"])


@exact_suffixes
@pytest.mark.parametrize("points", [POINTS, FAR], ids=["near", "far"])
def test_text_ply_and_npz_keep_every_digit_and_every_colour(tmp_path: Path, suffix: str, points: np.ndarray) -> None:
    path = tmp_path / f"cloud{suffix}"
    write_cloud(path, points, COLORS)
    cloud = read_cloud(path)
    np.testing.assert_array_equal(cloud.points, points)
    np.testing.assert_array_equal(cloud.colors, COLORS)


def test_pcd_keeps_float32_near_zero_and_float64_far_away(tmp_path: Path) -> None:
    write_cloud(tmp_path / "near.pcd", POINTS, COLORS)
    np.testing.assert_array_equal(read_cloud(tmp_path / "near.pcd").points, POINTS.astype(np.float32))
    np.testing.assert_array_equal(read_cloud(tmp_path / "near.pcd").colors, COLORS)
    write_cloud(tmp_path / "far.PCD", FAR, COLORS)
    np.testing.assert_array_equal(read_cloud(tmp_path / "far.PCD").points, FAR)


@every_suffix
def test_clouds_without_colours_get_none(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"cloud{suffix}"
    write_cloud(path, POINTS)
    cloud = read_cloud(path)
    assert cloud.colors is None and len(cloud) == len(POINTS)
    np.testing.assert_allclose(cloud.points, POINTS, rtol=FLOAT32_STEP if suffix == ".pcd" else 0, atol=0)


def test_trimesh_reads_our_ply(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.ply", FAR, COLORS)
    cloud = trimesh.load(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(np.asarray(cloud.vertices), FAR)
    np.testing.assert_array_equal(np.asarray(cloud.colors)[:, :3], COLORS)


def test_a_ply_is_laid_out_as_its_header_says(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.ply", np.array([[1.5, -2.0, 0.1]]), np.array([[7, 255, 0]], np.uint8))
    header, _, body = (tmp_path / "cloud.ply").read_bytes().partition(b"end_header\n")
    assert header.decode().splitlines() == [
        "ply",
        "format binary_little_endian 1.0",
        "element vertex 1",
        *(f"property double {axis}" for axis in "xyz"),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
    ]
    assert body == struct.pack("<3d3B", 1.5, -2.0, 0.1, 7, 255, 0)


def test_numpy_reads_our_text_and_npz(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.txt", POINTS, COLORS)
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "cloud.txt"), np.hstack([POINTS, COLORS]))
    write_cloud(tmp_path / "cloud.npz", POINTS, COLORS)
    with np.load(tmp_path / "cloud.npz") as arrays:
        assert {name: arrays[name].dtype for name in arrays.files} == {"points": np.float64, "colors": np.uint8}


def test_map_texts_stay_short_and_take_colours(tmp_path: Path) -> None:
    write_xyz(tmp_path / "map.txt", np.array([[-92, -140, 10]]) * 0.05, np.array([[1, 2, 3]], np.uint8))
    assert (tmp_path / "map.txt").read_text() == "-4.6 -7 0.5 1 2 3\n"


@every_suffix
def test_the_same_cloud_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    for name in ("one", "two"):
        write_cloud(tmp_path / f"{name}{suffix}", POINTS, COLORS)
    assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()


@pytest.mark.parametrize("name", ["cloud.las", "cloud", "cloud.pcd.gz"])
def test_other_suffixes_are_refused_with_those_that_are_allowed(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"allowed: \.pcd, \.ply, \.txt, \.xyz, \.npz") as caught:
        write_cloud(tmp_path / name, POINTS)
    assert str(tmp_path / name) in str(caught.value)
    assert not list(tmp_path.iterdir())


@every_suffix
def test_a_folder_that_does_not_exist_is_named(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(InputError, match="no folder"):
        write_cloud(tmp_path / "nowhere" / f"cloud{suffix}", POINTS)


def test_colours_of_another_length_are_a_programming_mistake(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="colors must be"):
        write_cloud(tmp_path / "cloud.ply", POINTS, COLORS[1:])
