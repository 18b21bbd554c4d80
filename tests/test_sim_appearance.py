"""Textures, corner colours, light, culled faces, normals and parts of rendered images."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from maomaps_warp.kernels.appearance import create_appearance
from maomaps_warp.kernels.pixels import view_from
from maomaps_warp.kernels.render import Images, MeshScene, render_scene

#: Levels of 8 bits: colours are float32 sums of a few products, rounded once.
ONE_LEVEL = 1
#: Unit vectors through a float32 quaternion.
NORMAL_TOLERANCE = 1e-6
SIZE, FOCAL = 64, 64.0
#: Looks along +x with z up: x right, y down, z forward.
ALONG_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
#: A square of 2 m at x = 2 m that the image shows in full, its front to the camera; corners as the texture's (0, 0) ...
SQUARE = np.array([[2, 1, -1], [2, -1, -1], [2, -1, 1], [2, 1, 1]], dtype=np.float32)
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
SQUARE_UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)


def scene(
    vertices: np.ndarray, faces: np.ndarray, device: str, *, both_sides: bool = True, **look: object
) -> MeshScene:
    given = {"textures": [np.full((1, 1, 3), 200, np.uint8)], "face_texture": np.zeros(len(faces), np.int32)} | look
    return MeshScene(
        wp.Mesh(
            points=wp.array(vertices, dtype=wp.vec3, device=device),
            indices=wp.array(faces.reshape(-1), dtype=wp.int32, device=device),
        ),
        create_appearance(**given, device=device),
        wp.full(len(faces), int(both_sides), dtype=wp.uint8, device=device),
        wp.array(np.arange(len(faces)), dtype=wp.int32, device=device),
    )


def seen(what: MeshScene, rotation: np.ndarray = ALONG_X, **options: object) -> Images:
    xyzw = Rotation.from_matrix(rotation).as_quat()
    middle = SIZE / 2 - 0.5
    view = view_from(wp.transformf(wp.vec3f(), wp.quatf(*xyzw)), SIZE, FOCAL, FOCAL, middle, middle, 50.0)
    return render_scene(what, view, SIZE, **options)


def bilinear(texture: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Texture coordinates, v upwards, to colours: four texels each, repeated at the borders. Float64."""
    rows, columns = texture.shape[:2]
    x, y = np.mod(u, 1.0) * columns - 0.5, (1.0 - np.mod(v, 1.0)) * rows - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    total = np.zeros((*np.shape(u), 3))
    for i in (0, 1):
        for j in (0, 1):
            share = np.abs(1 - i - (y - row)) * np.abs(1 - j - (x - column))
            total += share[..., None] * texture[(row + i) % rows, (column + j) % columns]
    return total


def square_coordinates() -> tuple[np.ndarray, np.ndarray]:
    """Where the ray of each pixel meets the square: u to the right, v upwards, of its 2 m."""
    at = (np.arange(SIZE) - (SIZE / 2 - 0.5)) / FOCAL * 2.0
    return np.meshgrid((at + 1.0) / 2.0, (1.0 - at) / 2.0)


@pytest.mark.parametrize("repeats", [1.0, 2.5])
def test_textures_are_bilinear_and_repeat(device: str, repeats: float) -> None:
    texture = np.random.default_rng(4).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    look = {"textures": [texture], "corner_uv": repeats * SQUARE_UV[SQUARE_FACES], "is_lit": False}
    pixels = seen(scene(SQUARE, SQUARE_FACES, device, **look)).colors.numpy().astype(int)
    u, v = square_coordinates()
    expected = bilinear(texture, repeats * u, repeats * v)
    # On the seam between copies of the texture a rounded coordinate may fall to either side, of the same colour.
    assert np.abs(pixels - expected).max() <= ONE_LEVEL


def test_colours_of_corners_are_interpolated_and_tint_the_texture(device: str) -> None:
    corners = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]], dtype=np.uint8)
    look = {"corner_colors": corners[SQUARE_FACES], "is_lit": False}
    pixels = seen(scene(SQUARE, SQUARE_FACES, device, **look)).colors.numpy().astype(int)
    u, v = square_coordinates()
    lower = u >= v  # the triangle of corners 0, 1, 2
    weights = np.where(
        lower[..., None],
        np.stack([1 - u, u - v, v, np.zeros_like(u)], axis=-1),
        np.stack([1 - v, np.zeros_like(u), u, v - u], axis=-1),
    )
    assert np.abs(pixels - weights @ corners * (200 / 255)).max() <= ONE_LEVEL


def test_more_samples_are_the_mean_of_their_rays(device: str) -> None:
    texture = np.random.default_rng(5).integers(0, 256, (40, 40, 3)).astype(np.uint8)
    look = {"textures": [texture], "corner_uv": SQUARE_UV[SQUARE_FACES], "is_lit": False}
    what = scene(SQUARE, SQUARE_FACES, device, **look)
    images = seen(what, samples=3)
    u, v = square_coordinates()
    pixel = u[0, 1] - u[0, 0]
    shifts = [(i / 3 * pixel, j / 3 * pixel) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    expected = np.mean([bilinear(texture, u + i, v + j) for i, j in shifts], axis=0)
    inside = slice(1, -1)  # rays of the outermost pixels pass the square
    assert np.abs(images.colors.numpy().astype(int) - expected)[inside, inside].max() <= ONE_LEVEL
    np.testing.assert_array_equal(images.depth.numpy(), seen(what).depth.numpy())


def test_light_is_brightest_face_on_and_from_above_and_never_more_than_one(device: str) -> None:
    floor = np.array([[-9, -9, -1], [9, -9, -1], [9, 9, -1], [-9, 9, -1]], dtype=np.float32)
    down = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    up = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    of_floor = seen(scene(floor, SQUARE_FACES, device), down).colors.numpy()
    of_ceiling = seen(scene(-floor, SQUARE_FACES, device), up).colors.numpy()
    middle = SIZE // 2, SIZE // 2
    assert of_floor[middle].tolist() == [200] * 3 and of_floor.max() == 200
    assert 150 < of_ceiling[middle][0] < 180  # all but what comes from above
    assert of_floor[0, 0, 0] < of_floor[middle][0]


def test_faces_that_show_only_their_front_are_seen_through_from_behind(device: str) -> None:
    behind = SQUARE + np.array([1.0, 0.0, 0.0], dtype=np.float32)
    two = np.concatenate([SQUARE, behind])
    faces = np.concatenate([SQUARE_FACES[:, ::-1], SQUARE_FACES + 4])  # the near one shows its back
    assert np.allclose(seen(scene(two, faces, device)).depth.numpy(), 2.0, atol=1e-5)
    culled = seen(scene(two, faces, device, both_sides=False), with_parts=True)
    middle = slice(SIZE // 4, -SIZE // 4)
    assert np.allclose(culled.depth.numpy()[middle, middle], 3.0, atol=1e-4)
    assert culled.parts.numpy()[0, 0] == -1 and culled.depth.numpy()[0, 0] == 0.0
    assert set(np.unique(culled.parts.numpy()[middle, middle])) == {2, 3}


def test_normals_face_the_camera_in_its_own_frame(device: str) -> None:
    turn = Rotation.from_euler("z", 0.3).as_matrix() @ ALONG_X
    for faces in (SQUARE_FACES, SQUARE_FACES[:, ::-1]):
        images = seen(scene(SQUARE, faces, device), turn, with_normals=True)
        hit = images.depth.numpy() > 0
        assert hit.any() and not hit.all()
        expected = turn.T @ [-1.0, 0.0, 0.0]
        np.testing.assert_allclose(
            images.normals.numpy()[hit], np.tile(expected, (hit.sum(), 1)), rtol=0, atol=NORMAL_TOLERANCE
        )
        assert not images.normals.numpy()[~hit].any()


def test_any_number_of_threads_gives_the_same_bytes() -> None:
    texture = np.random.default_rng(6).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    what = scene(SQUARE, SQUARE_FACES, "cpu", textures=[texture], corner_uv=SQUARE_UV[SQUARE_FACES], grain=0.05)
    one, three = (seen(what, samples=2, with_parts=True, threads=threads) for threads in (1, 3))
    for name in ("depth", "colors", "parts"):
        assert getattr(one, name).numpy().tobytes() == getattr(three, name).numpy().tobytes()


def test_wrong_looks_are_named() -> None:
    texture = np.zeros((2, 2, 3), np.uint8)
    with pytest.raises(ValueError, match="corner_uv: needed"):
        create_appearance([texture], np.zeros(2, np.int32), device="cpu")
    with pytest.raises(ValueError, match="face_texture"):
        create_appearance([texture], np.ones(2, np.int32), device="cpu")
    with pytest.raises(ValueError, match=r"corner_colors: expected \(2, 3, 3\)"):
        create_appearance([texture[:1, :1]], np.zeros(2, np.int32), None, np.zeros((2, 3, 4), np.uint8), device="cpu")
    with pytest.raises(ValueError, match="textures"):
        create_appearance([texture[:, :0]], np.zeros(2, np.int32), device="cpu")
