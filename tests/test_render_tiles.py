"""Tiles of rays down a tree of triangles: against wp.Mesh's rays, against float64 NumPy, and without a hole."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from scipy.spatial.transform import Rotation

from maomaps_warp.kernels.appearance import create_appearance
from maomaps_warp.kernels.pixels import view_from
from maomaps_warp.kernels.render import MeshScene, render_scene
from maomaps_warp.kernels.triangle_tree import MAX_DEPTH, build_triangle_tree

#: Share of pixels whose ray passes an edge so closely that its rounding decides.
GRAZING_SHARE = 1e-3
#: Metres: float32 rays over a few metres.
DEPTH_TOLERANCE = 1e-4


def arrays(corners):
    """Points and indices of triangles, (F, 3, 3) metres."""
    points = wp.array(corners.reshape(-1, 3), dtype=wp.vec3, device="cpu")
    return points, wp.array(np.arange(len(points)), dtype=wp.int32, device="cpu")


def soup(rng, count=400):
    """Triangles of all sizes around the origin, a tenth of them without an area."""
    corners = rng.uniform(-4.0, 4.0, (count, 1, 3)) + rng.normal(0.0, 1.0, (count, 3, 3)) * rng.choice(
        [0.05, 0.5, 2.0], (count, 1, 1)
    )
    corners[::20, 2] = corners[::20, 1]
    corners[1::20] = corners[1::20, :1]
    return corners.astype(np.float32)


def pose_at(rng):
    return rng.uniform(-2.0, 2.0, 3), Rotation.random(random_state=rng)


def images(mesh, corners, pose, *, size=(61, 45), shown=None, with_look=True, max_depth=20.0, lens=None, **options):
    """What a camera sees; the part of each face is its number. `lens`: fx, fy, cx, cy."""
    faces = len(corners)
    numbers = np.arange(faces, dtype=np.int32)
    look = None
    if with_look:
        shades = np.random.default_rng(9).integers(0, 256, (faces, 3, 3)).astype(np.uint8)
        look = create_appearance([np.full((1, 1, 3), 255, np.uint8)], 0 * numbers, corner_colors=shades, device="cpu")
    shown = np.ones(faces) if shown is None else shown
    scene = MeshScene(
        mesh,
        look,
        wp.array(shown.astype(np.uint8), dtype=wp.uint8, device="cpu"),
        wp.array(numbers, dtype=wp.int32, device="cpu"),
    )
    position, rotation = pose
    T = wp.transformf(wp.vec3f(*position.tolist()), wp.quatf(*rotation.as_quat().tolist()))
    view = view_from(T, size[0], *(lens or (40.0, 42.0, size[0] / 2.0, size[1] / 2.0 - 0.3)), max_depth)
    out = render_scene(scene, view, size[1], with_normals=True, with_parts=True, **options)
    return {name: image.numpy() for name, image in vars(out).items() if image is not None}


def numpy_hits(corners, shown, pose, size, max_depth):
    """Nearest face, (H, W), -1: none, and its depth, by float64 rays against every face (Moeller, Trumbore 1997)."""
    position, rotation = pose
    v, u = np.mgrid[: size[1], : size[0]].astype(float)
    rays = np.stack([(u - size[0] / 2.0) / 40.0, (v - (size[1] / 2.0 - 0.3)) / 42.0, np.ones_like(u)], axis=-1)
    rays = rays @ rotation.as_matrix().T
    nearest, face = np.full(u.shape, max_depth), np.full(u.shape, -1)
    for number, (a, b, c) in enumerate(corners.astype(float)):
        p = np.cross(rays, c - a)
        det = p @ (b - a)
        usable = np.abs(det) > 1e-12
        if not shown[number]:
            usable &= det > 0.0
        scale = 1.0 / np.where(usable, det, 1.0)
        s = (p @ (position - a)) * scale
        q = np.cross(position - a, b - a)
        r = (rays @ q) * scale
        t = ((c - a) @ q) * scale
        hit = usable & (s >= 0.0) & (r >= 0.0) & (s + r <= 1.0) & (t > 0.0) & (t < nearest)
        nearest[hit], face[hit] = t[hit], number
    return face, nearest


@pytest.mark.parametrize("samples", [1, 3])
@pytest.mark.parametrize("size", [(61, 45), (3, 7), (1, 1), (64, 4)])
def test_tiles_see_what_single_rays_see(size, samples):
    rng = np.random.default_rng(5)
    differ = pixels = seen = 0
    for _ in range(6):
        corners, shown, pose = soup(rng), rng.integers(0, 2, 400), pose_at(rng)
        options = {"size": size, "shown": shown, "samples": samples}
        points, indices = arrays(corners)
        alone = images(wp.Mesh(points, indices), corners, pose, **options)
        tiles = images(build_triangle_tree(points, indices), corners, pose, **options)
        assert alone.keys() == tiles.keys() == {"depth", "colors", "normals", "parts"}
        same = alone["parts"] == tiles["parts"]
        # The same face: the same bits, whichever way it was found.
        for name in ("depth", "normals"):
            np.testing.assert_array_equal(alone[name][same], tiles[name][same])
        differ += np.count_nonzero(~same) + np.count_nonzero((alone["colors"] != tiles["colors"]).any(axis=-1) & same)
        pixels += same.size
        seen += np.count_nonzero(tiles["parts"] >= 0)
    assert differ <= max(1, GRAZING_SHARE * samples**2 * pixels)
    assert seen > 0.5 * pixels


def test_tiles_see_what_float64_rays_see():
    rng = np.random.default_rng(6)
    differ = pixels = culled = 0
    for _ in range(5):
        corners, shown, pose = soup(rng), rng.integers(0, 2, 400), pose_at(rng)
        tiles = images(build_triangle_tree(*arrays(corners)), corners, pose, shown=shown, with_look=False)
        face, depth = numpy_hits(corners, shown, pose, (61, 45), 20.0)
        same = face == tiles["parts"]
        np.testing.assert_allclose(
            tiles["depth"][same], np.where(face >= 0, depth, 0.0)[same], rtol=0.0, atol=DEPTH_TOLERANCE
        )
        differ += np.count_nonzero(~same)
        pixels += same.size
        culled += np.count_nonzero(face != numpy_hits(corners, np.ones(400), pose, (61, 45), 20.0)[0])
    assert differ <= GRAZING_SHARE * pixels
    assert culled > 0.05 * pixels


@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_no_ray_leaves_a_closed_mesh(shape):
    rng = np.random.default_rng(7)
    if shape == "sphere":
        mesh = trimesh.creation.icosphere(subdivisions=4, radius=3.0)
    else:
        mesh = trimesh.creation.box((6, 5, 4)).subdivide().subdivide().subdivide()
    corners = mesh.triangles.astype(np.float32)
    tree = build_triangle_tree(*arrays(corners))
    # A ray through the middle of the image meets a corner, as exactly as float32 can say it.
    towards_corners = [
        (np.zeros(3), Rotation.align_vectors(corner[None], [[0.0, 0.0, 1.0]])[0]) for corner in mesh.vertices[::3]
    ]
    lens = (40.0, 42.0, 8.0, 8.0)
    for pose in [*towards_corners, *(pose_at(rng) for _ in range(50))]:
        assert (images(tree, corners, pose, with_look=False, size=(17, 17), lens=lens)["depth"] > 0.0).all()


def test_rays_that_run_along_edges_are_not_lost():
    # Powers of two, so that nothing is rounded: rays of one slope both ways meet the diagonal of a square of two faces.
    square = np.array([[-2, -2, 2], [2, -2, 2], [2, 2, 2], [-2, 2, 2]], dtype=np.float32)
    corners = square[[[0, 1, 2], [0, 2, 3]]]
    ahead = (np.zeros(3), Rotation.identity())
    lens = (32.0, 32.0, 32.0, 32.0)
    parts = images(build_triangle_tree(*arrays(corners)), corners, ahead, size=(65, 65), lens=lens)["parts"]
    assert (parts >= 0).all()
    row, column = np.mgrid[:65, :65]
    np.testing.assert_array_equal(parts[row != column], np.where(row < column, 0, 1)[row != column])


def test_a_face_with_one_side_is_seen_from_its_front_alone():
    corners = np.array([[[-9, -9, 2], [9, -9, 2], [0, 9, 2]]], dtype=np.float32)
    ahead = (np.zeros(3), Rotation.identity())
    for order, front in (([0, 1, 2], False), ([0, 2, 1], True)):
        turned = corners[:, order]
        for mesh in (build_triangle_tree(*arrays(turned)), wp.Mesh(*arrays(turned))):
            parts = images(mesh, turned, ahead, shown=np.zeros(1))["parts"]
            assert (parts[10:30, 20:40] == (0 if front else -1)).all()


def test_nothing_is_seen_beyond_the_maximum_in_tiles():
    corners = soup(np.random.default_rng(8))
    tree = build_triangle_tree(*arrays(corners))
    pose = pose_at(np.random.default_rng(1))
    whole = images(tree, corners, pose)["depth"]
    limit = np.sort(whole[whole > 0.0])[1000]
    cut = images(tree, corners, pose, max_depth=float(limit))["depth"]
    np.testing.assert_array_equal(cut, np.where(whole < limit, whole, 0.0))


def test_threads_change_no_byte():
    corners = soup(np.random.default_rng(2))
    tree = build_triangle_tree(*arrays(corners))
    pose = pose_at(np.random.default_rng(3))
    one, three = (images(tree, corners, pose, size=(200, 151), samples=2, threads=n) for n in (1, 3))
    for name, image in one.items():
        np.testing.assert_array_equal(image, three[name])


def _shrinking(count):
    """Each cut takes one of them off, until areas vanish."""
    scales = 1e19 * 16.5 ** -np.arange(count)
    return (np.array([[1.0, 0, 0], [1, 1, 0], [1, 0, 1]]) * scales[:, None, None]).astype(np.float32)


@pytest.mark.parametrize(
    "corners",
    [
        soup(np.random.default_rng(4), 3000),
        soup(np.random.default_rng(4), 1),
        np.tile(np.eye(3, dtype=np.float32), (5000, 1, 1)),
        _shrinking(46),
        soup(np.random.default_rng(4), 3000) * np.float32(1e25),
    ],
    ids=["soup", "one", "all alike", "each much smaller than the last", "so large that areas are infinite"],
)
def test_a_tree_holds_every_triangle_once_inside_of_its_boxes(corners):
    tree = build_triangle_tree(*arrays(corners))
    lower, upper, first, count, face = (
        getattr(tree, name).numpy() for name in ("lower", "upper", "first", "count", "face")
    )
    assert sorted(face) == list(range(len(corners)))
    np.testing.assert_array_equal(tree.corners.numpy().reshape(-1, 3, 3), corners[face])
    taken, deepest, waiting = [], 0, [(0, 1)]
    while waiting:
        node, depth = waiting.pop()
        deepest = max(deepest, depth)
        if count[node]:
            inside = corners[face[first[node] : first[node] + count[node]]]
            taken += range(first[node], first[node] + count[node])
            assert (inside >= lower[node]).all()
            assert (inside <= upper[node]).all()
        else:
            for child in (first[node], first[node] + 1):
                assert (lower[child] >= lower[node]).all()
                assert (upper[child] <= upper[node]).all()
                waiting.append((child, depth + 1))
    assert sorted(taken) == list(range(len(corners)))
    # Cut into halves from depth 32 on: the stack of a walk holds one node of each level.
    assert deepest <= min(32 + np.log2(len(corners)), MAX_DEPTH - 1) + 1
    # Leaves are small: a ray that comes by meets few triangles.
    assert count.max() <= 8


def test_triangles_that_are_none_are_refused():
    with pytest.raises(ValueError, match="at least one triangle"):
        build_triangle_tree(*arrays(np.empty((0, 3, 3), np.float32)))
    points, _ = arrays(np.eye(3, dtype=np.float32)[None])
    for corners, words in (([0, 1, 2, 0], "three of each"), ([0, 1, 3], "0 to 2, got 3"), ([0, -1, 2], "got -1")):
        with pytest.raises(ValueError, match=words):
            build_triangle_tree(points, wp.array(corners, dtype=wp.int32, device="cpu"))


def test_what_is_no_mesh_or_a_broken_tree_is_named():
    corners = soup(np.random.default_rng(0), 5)
    pose = pose_at(np.random.default_rng(0))
    empty = wp.Mesh(wp.zeros(1, dtype=wp.vec3, device="cpu"), wp.zeros(0, dtype=wp.int32, device="cpu"))
    with pytest.raises(ValueError, match=r"scene\.mesh: expected at least one triangle"):
        images(empty, corners[:0], pose, with_look=False)
    with pytest.raises(TypeError, match=r"scene\.mesh: expected a wp\.Mesh or a TriangleTree, got int"):
        images(7, corners, pose)
    tree = build_triangle_tree(*arrays(corners))
    tree.corners = tree.corners[:6]
    with pytest.raises(ValueError, match=r"scene\.mesh\.corners: expected shape \(15,\)"):
        images(tree, corners, pose)


@pytest.mark.parametrize("build", [build_triangle_tree, wp.Mesh])
def test_a_camera_on_a_surface_sees_no_depth_behind_it(build):
    rng = np.random.default_rng(12)
    on_it = 0
    for _ in range(40):
        corners = rng.normal(0.0, 5.0, (1, 3, 3)).astype(np.float32)
        shares = rng.dirichlet(np.ones(3))
        seen = images(
            build(*arrays(corners)), corners, (shares @ corners[0].astype(float), Rotation.random(random_state=rng))
        )
        np.testing.assert_array_equal(seen["depth"] > 0.0, seen["parts"] >= 0)
        assert (seen["depth"] >= 0.0).all()
        on_it += np.count_nonzero(seen["parts"] >= 0)
    assert on_it


def test_a_small_closed_sheet_far_away_has_no_holes():
    # Boxes of centimetres, seen over 200 m: what is rounded is the distance.
    cells = 128
    side = np.linspace(-0.2, 0.2, cells + 1)
    x, y = np.meshgrid(side, side, indexing="ij")
    turn = Rotation.align_vectors([[1.0, 1.1, 0.9]], [[0.0, 0.0, 1.0]])[0]
    points = turn.apply(np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 3))
    number = np.arange(len(points)).reshape(cells + 1, cells + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack(f, axis=-1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))])
    corners = points[faces].astype(np.float32)
    tree = build_triangle_tree(*arrays(corners))
    inner = points[number[8:-8, 8:-8]].reshape(-1, 3)
    position = turn.apply([20.0, 10.0, 200.0])
    lens = (5e7, 5e7, 1.5, 1.5)  # sixteen rays within a few micrometres of a corner
    for corner in np.random.default_rng(3).choice(inner, 400):
        ahead = Rotation.align_vectors([corner.astype(np.float32) - position], [[0.0, 0.0, 1.0]])[0]
        seen = images(tree, corners, (position, ahead), with_look=False, size=(4, 4), lens=lens, max_depth=1e3)
        assert (seen["parts"] >= 0).all()


@pytest.mark.parametrize("build", [build_triangle_tree, wp.Mesh])
def test_what_stands_behind_a_culled_face_far_away_is_seen(build):
    far = np.array([[[-900, -900, 1000], [900, -900, 1000], [0, 900, 1000]]], dtype=np.float32)
    behind = far[:, [0, 2, 1]] + np.float32([0, 0, 1])
    corners = np.concatenate([far, behind])
    parts = images(
        build(*arrays(corners)), corners, (np.zeros(3), Rotation.identity()), shown=np.zeros(2), max_depth=1e4
    )["parts"]
    assert (parts[18:28, 26:34] == 1).all()
