"""Scenes read from files that trimesh writes: what is up, how large, which colour."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from maomaps_warp.errors import InputError
from maomaps_warp.sim.scene_files import SceneOptions, read_world

#: sRGB levels: colours pass through linear light and back, and are rounded once.
ONE_LEVEL = 1
#: Metres: coordinates pass through float32.
COORDINATE_TOLERANCE = 1e-6


def room(colors: tuple[int, ...] = (200, 100, 50, 255)) -> trimesh.Trimesh:
    """A box of 4 x 3 x 2.5 m, y up as glTF has it, in one plain colour (linear, as glTF states factors)."""
    box = trimesh.creation.box(extents=(4.0, 2.5, 3.0))
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=colors)
    box.visual = trimesh.visual.TextureVisuals(material=material)
    return box


def picture() -> tuple[trimesh.Trimesh, np.ndarray]:
    """A square of 1 m in the plane z = 0 with a texture of 2 x 2 texels: red, green over blue, white."""
    texels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], dtype=np.uint8)
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(texels))
    uv = [[0, 0], [1, 0], [1, 1], [0, 1]]
    square.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return square, texels


def saved(folder: Path, name: str, *meshes: trimesh.Trimesh) -> Path:
    scene = trimesh.Scene()
    for place, mesh in enumerate(meshes):
        scene.add_geometry(mesh, node_name=f"part{place}", geom_name=f"mesh{place}")
    path = folder / name
    path.write_bytes(scene.export(file_type=path.suffix[1:]))
    return path


def test_gltf_has_y_up_and_linear_base_colours(tmp_path: Path) -> None:
    world = read_world(saved(tmp_path, "room.glb", room()))
    np.testing.assert_allclose(world.bounds, [[-2, -1.5, -1.25], [2, 1.5, 1.25]], rtol=0, atol=COORDINATE_TOLERANCE)
    # IEC 61966-2-1 of 200, 100 and 50 of 255, computed by hand
    assert np.abs(world.textures[0].reshape(3).astype(int) - [229, 168, 122]).max() <= ONE_LEVEL
    assert world.corner_uv is None and world.parts == ("part0",) and not world.is_double_sided.any()


def test_normals_still_point_out_of_the_box_that_was_turned(tmp_path: Path) -> None:
    world = read_world(saved(tmp_path, "room.glb", room()))
    a, b, c = (world.vertices[world.triangles[:, k]] for k in range(3))
    outwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3)
    assert (outwards > 0).all()


def test_a_mirrored_part_is_seen_from_the_same_side(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(room(), node_name="mirrored", transform=np.diag([-1.0, 1.0, 1.0, 1.0]))
    path = tmp_path / "mirrored.glb"
    path.write_bytes(scene.export(file_type="glb"))
    world = read_world(path)
    a, b, c = (world.vertices[world.triangles[:, k]] for k in range(3))
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3) > 0).all()


def test_textures_keep_their_rows_and_coordinates(tmp_path: Path) -> None:
    square, texels = picture()
    world = read_world(saved(tmp_path, "picture.glb", square))
    assert np.abs(world.textures[0].astype(int) - texels).max() <= ONE_LEVEL
    assert world.corner_uv is not None
    upper_left = np.all(np.isclose(world.vertices[world.triangles], [0, 0, 1]), axis=2)  # y up: (0, 1, 0) in the file
    np.testing.assert_allclose(world.corner_uv[upper_left], [[0, 1]], rtol=0, atol=COORDINATE_TOLERANCE)


def test_parts_share_one_world_and_keep_their_names(tmp_path: Path) -> None:
    square, _ = picture()
    world = read_world(saved(tmp_path, "both.glb", room(), square, room()))
    assert world.parts == ("part0", "part1", "part2")
    assert np.bincount(world.face_part).tolist() == [12, 2, 12]
    assert len(world.textures) == 2 and world.corner_uv is not None and world.corner_uv.shape == (26, 3, 2)
    left = read_world(tmp_path / "both.glb", SceneOptions(drop=("part1",)))
    assert left.parts == ("part0", "part2") and left.corner_uv is None


def test_ply_has_z_up_and_vertex_colours(tmp_path: Path) -> None:
    box = trimesh.creation.box(extents=(4.0, 3.0, 2.5))
    colors = np.random.default_rng(0).integers(0, 256, (8, 4)).astype(np.uint8)
    box.visual = trimesh.visual.ColorVisuals(box, vertex_colors=colors)
    box.export(tmp_path / "room.ply")
    world = read_world(tmp_path / "room.ply")
    np.testing.assert_allclose(world.bounds, [[-2, -1.5, -1.25], [2, 1.5, 1.25]], rtol=0, atol=COORDINATE_TOLERANCE)
    assert world.corner_colors is not None and world.is_double_sided.all()
    of_corner = {tuple(np.round(v, 3)): c[:3] for v, c in zip(box.vertices, colors, strict=True)}
    for corner, color in zip(
        world.vertices[world.triangles].reshape(-1, 3), world.corner_colors.reshape(-1, 3), strict=True
    ):
        np.testing.assert_array_equal(color, of_corner[tuple(np.round(corner.astype(float), 3))])


def test_units_and_axes_are_what_the_user_says(tmp_path: Path) -> None:
    box = room()
    box.apply_scale(1000.0)
    path = saved(tmp_path, "room.glb", box)
    with pytest.raises(InputError, match=r"is 4000 m wide, read in m \(.*--unit cm.*--unit mm"):
        read_world(path)
    world = read_world(path, SceneOptions(unit="mm", up="z"))
    np.testing.assert_allclose(np.ptp(world.bounds, axis=0).ravel(), [4, 2.5, 3], rtol=0, atol=COORDINATE_TOLERANCE)


def test_habitats_stage_config_says_what_is_up(tmp_path: Path) -> None:
    path = saved(tmp_path, "room.glb", room())
    config = tmp_path / "room.stage_config.json"
    config.write_text(json.dumps({"up": [0, 0, 1]}))
    world = read_world(path)
    assert np.ptp(world.bounds, axis=0).ravel()[2] == pytest.approx(3.0) and "stage_config" in world.notes[0]
    config.write_text(json.dumps({"up": [1, 0, 0]}))
    with pytest.raises(InputError, match="does not say which way is up"):
        read_world(path)
    assert read_world(path, SceneOptions(up="y")).notes == ()


def test_a_scene_that_seems_to_lie_is_noted(tmp_path: Path) -> None:
    box = trimesh.creation.box(extents=(10.0, 11.0, 2.2))  # z up in a file that must have y up
    world = read_world(saved(tmp_path, "lying.glb", box))
    assert any("--up z" in note for note in world.notes)


def test_a_ground_plane_is_named(tmp_path: Path) -> None:
    plane = trimesh.creation.box(extents=(200.0, 0.01, 200.0))
    path = saved(tmp_path, "world.glb", room(), plane)
    with pytest.raises(InputError, match=r"part 'part1' is 200 m wide, all others up to 4 m \(--drop 'part1'"):
        read_world(path)
    assert read_world(path, SceneOptions(drop=("part1",))).parts == ("part0",)
    with pytest.raises(InputError, match="has no part 'floor' to drop"):
        read_world(path, SceneOptions(drop=("floor",)))


def test_a_missing_texture_is_noted(tmp_path: Path) -> None:
    (tmp_path / "room.mtl").write_text("newmtl wall\nKd 0.5 0.5 0.5\nmap_Kd nowhere.png\n")
    text = "mtllib room.mtl\nusemtl wall\n" + "".join(
        f"v {x} {y} {z}\n" for x in (0, 4) for y in (0, 3) for z in (0, 4)
    )
    (tmp_path / "room.obj").write_text(text + "vt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\nf 4/1 6/2 8/3\n")
    world = read_world(tmp_path / "room.obj")
    assert any("nowhere.png" in note for note in world.notes)
    assert world.textures[0].shape == (1, 1, 3)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("room.stl", b"solid", "is no scene"),
        ("room.glb", b"", "is empty"),
        ("room.glb", b"glTF\x02\0\0\0 damaged", "cannot be read as a scene"),
        ("room.obj", b"v 0 0 0\nv 1 0 0\n", "holds no triangles|cannot be read as a scene"),
        ("room.ply", b"ply\nformat ascii 1.0\nend_header\n", "holds no triangles|cannot be read as a scene"),
    ],
)
def test_what_is_no_scene_is_refused(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        read_world(tmp_path / name)
    assert caught.value.where == str(tmp_path / name)


def test_what_is_not_finite_is_named(tmp_path: Path) -> None:
    box = room()
    vertices = box.vertices.copy()
    vertices[3, 1] = np.nan
    faces = "".join("f {} {} {}\n".format(*(face + 1)) for face in box.faces)
    (tmp_path / "room.obj").write_text("".join("v {} {} {}\n".format(*v) for v in vertices) + faces)
    with pytest.raises(InputError, match=r"vertex \d+ is not finite"):
        read_world(tmp_path / "room.obj")


def test_a_missing_file_is_said_before_trimesh_is_loaded(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_world(tmp_path / "nowhere.glb")


def test_a_triangle_without_its_vertices_is_refused(tmp_path: Path) -> None:
    (tmp_path / "room.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n5 0 0\n0 5 0\n0 0 2.5\n3 0 1 2\n3 0 1 999\n"
    )
    with pytest.raises(InputError, match=r"999, but there are 4|cannot be read as a scene"):
        read_world(tmp_path / "room.ply")


def test_a_scene_far_from_its_origin_is_refused(tmp_path: Path) -> None:
    room = trimesh.creation.box((5.0, 4.0, 2.5))
    room.apply_translation((487123.3, 5432123.7, 0.0))
    room.export(tmp_path / "room.ply", vertex_normal=False)
    with pytest.raises(InputError, match="from its origin .*move it to the origin first"):
        read_world(tmp_path / "room.ply")


def test_a_folder_is_no_scene(tmp_path: Path) -> None:
    (tmp_path / "room.glb").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        read_world(tmp_path / "room.glb")
