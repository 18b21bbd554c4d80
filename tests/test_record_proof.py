"""A recorded run's map is the scene that its trajectory saw: voxels and colours, against float64 rays in NumPy."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.io.sources import SourceOptions, open_source

VOXEL = 0.05
#: Rays of the renderer and of the map are float32: so far a point may lie from where float64 puts it, metres.
BAND_M = 2e-5
#: One for each side of the room and of the box in it.
PALETTE = np.random.default_rng(6).permutation(np.arange(12 * 3) * 7).reshape(12, 3).astype(np.uint8)


def room(path: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """A room with a box in it as a coloured PLY; its triangles, (F, 3, 3), and their colours, (F, 3)."""
    corners, faces = [], []
    for lower, upper, inwards in (
        ((-2.513, -2.013, 0.003), (2.487, 1.987, 2.533), True),
        ((0.81, 0.91, 0.003), (1.66, 1.63, 1.21), False),
    ):
        box = trimesh.creation.box(bounds=(lower, upper))
        if inwards:
            box.invert()
        # Two triangles a side, with corners of their own, so that no colour runs over an edge.
        for axis in range(3):
            for sign in (-1, 1):
                side = [f for f, n in zip(box.faces, box.face_normals, strict=True) if n[axis] * sign > 0.5]
                for face in side:
                    faces.append([len(corners), len(corners) + 1, len(corners) + 2])
                    corners += list(box.vertices[face])
    colors = np.repeat(PALETTE, 2, axis=0)
    mesh = trimesh.Trimesh(corners, faces, process=False, vertex_colors=np.repeat(colors, 3, axis=0))
    mesh.export(path)
    # What the file holds is float32.
    triangles = np.array(corners, dtype=np.float32).astype(np.float64).reshape(-1, 3, 3)
    return triangles, colors


def first_hits(triangles: NDArray[np.float64], origin: NDArray[np.float64], rays: NDArray[np.float64]):
    """Points, (N, 3), and triangles, (N,), that rays from one place meet first (Moeller and Trumbore 1997)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    p = np.cross(rays[:, None], c - a)
    scale = (p * (b - a)).sum(axis=2)
    s, q = origin - a, np.cross(origin - a, b - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v, t = (p * s).sum(axis=2) / scale, rays @ q.T / scale, ((c - a) * q).sum(axis=1) / scale
        t = np.where((u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 0), t, np.inf)
    which = t.argmin(axis=1)
    return origin + t[np.arange(len(rays)), which, None] * rays, which


@pytest.mark.parametrize("name", ["run.bag", "run.mcap"])
def test_the_map_of_a_run_is_the_scene_that_it_saw(tmp_path: Path, name: str) -> None:
    triangles, colors = room(tmp_path / "room.ply")
    command = ["record", str(tmp_path / "room.ply"), "-o", str(tmp_path / name), "--duration", "8", "--rate", "2"]
    options = ["--camera", "64x48@90", "--antialias", "1", "--light", "flat", "--device", "cpu", "--pitch", "-10"]
    done = CliRunner().invoke(app, [*command, *options])
    assert done.exit_code == 0, done.output
    sample = tmp_path / "sample"
    done = CliRunner().invoke(app, ["map", str(tmp_path / name), "-o", str(sample), "--pose-frame", "maomaps-c"])
    assert done.exit_code == 0, done.output
    found = np.rint(np.loadtxt(sample / "gt_points_first.txt") / VOXEL).astype(int)
    found_colors = dict(zip(map(tuple, found), np.loadtxt(sample / "gt_colors_first.txt"), strict=True))

    source = open_source(tmp_path / name, SourceOptions(pose_frame="maomaps-c"), "gt")
    assert source.trajectory is not None and source.frames is not None
    v, u = np.indices((48, 64)).reshape(2, -1)
    rays = np.stack([(u - 31.5) / 32.0, (v - 23.5) / 32.0, np.ones(u.size)], axis=1)
    seen: dict[tuple[int, ...], set[int]] = defaultdict(set)
    unsure: set[tuple[int, ...]] = set()
    for T, frame in zip(source.trajectory.T_world_camera, source.frames.read(True), strict=True):
        points, which = first_hits(triangles, T[:3, 3], rays @ T[:3, :3].T)
        depth = (points - T[:3, 3]) @ T[:3, 2]
        # Rays along an edge may take either side of it.
        assert (np.abs(frame.depth.reshape(-1) - depth) < 1e-4).mean() > 0.999
        cells = np.rint(points / VOXEL).astype(int)
        rest = points / VOXEL - cells
        is_near_face = np.abs(np.abs(rest) - 0.5) * VOXEL < BAND_M
        at_edge = np.abs(frame.depth.reshape(-1) - depth) >= 1e-4
        met = T[:3, 3] + frame.depth.reshape(-1, 1) * (rays @ T[:3, :3].T)
        for cell, triangle in zip(cells, which, strict=True):
            seen[tuple(cell)].add(triangle // 2)
        for i in np.flatnonzero(is_near_face.any(axis=1) | at_edge):
            beyond = cells[i] + np.sign(rest[i]).astype(int) * is_near_face[i]
            unsure |= {tuple(cells[i]), tuple(beyond), tuple(np.rint(met[i] / VOXEL).astype(int))}
    assert len(seen) > 3000 and len(unsure) < 0.02 * len(seen)
    assert set(map(tuple, found)) ^ set(seen) <= unsure
    checked = 0
    for cell, sides in seen.items():
        if len(sides) == 1 and cell not in unsure:
            assert tuple(found_colors[cell]) == tuple(colors[2 * sides.copy().pop()]), cell
            checked += 1
    assert checked > 0.8 * len(seen)


def test_a_shaken_noisy_run_has_exact_poses_depth_normals_and_parts(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_typestore

    triangles, _ = room(tmp_path / "room.ply")
    command = ["record", str(tmp_path / "room.ply"), "--duration", "4", "--rate", "2", "--camera", "64x48@90"]
    command += ["--antialias", "1", "--device", "cpu", "-o"]
    effects = ["--effect", "kinect", "--effect", "shake", "--effect", "blur", "--also", "normals", "--also", "parts"]
    done = CliRunner().invoke(app, [*command, str(tmp_path / "plain.bag")])
    assert done.exit_code == 0, done.output
    done = CliRunner().invoke(app, [*command, str(tmp_path / "run.bag"), *effects])
    assert done.exit_code == 0 and "0.0 % of the pixels see nothing" in done.stdout, done.output

    reading = SourceOptions(pose_frame="maomaps-c", topics=("/true_depth/image",))
    source = open_source(tmp_path / "run.bag", reading, "gt")
    plain = open_source(tmp_path / "plain.bag", SourceOptions(pose_frame="maomaps-c"), "gt")
    assert source.trajectory is not None and source.frames is not None and plain.trajectory is not None
    moved = np.linalg.norm(source.trajectory.positions - plain.trajectory.positions, axis=1)
    assert 1e-4 < moved.max() < 0.02, "the robot trembles"
    store, images = get_typestore(Stores.ROS1_NOETIC), {"/habitat/normals/image": [], "/habitat/semantic/image": []}
    noisy = []
    with Reader(tmp_path / "run.bag") as reader:
        for connection, _, data in reader.messages():
            if connection.topic in images:
                images[connection.topic].append(store.deserialize_ros1(data, connection.msgtype).data)
            if connection.topic == "/habitat/depth/image":
                noisy.append(store.deserialize_ros1(data, connection.msgtype).data.view(np.float32))
            if connection.topic == "/habitat/semantic/parts":
                assert store.deserialize_ros1(data, connection.msgtype).data.startswith("[")
    v, u = np.indices((48, 64)).reshape(2, -1)
    rays = np.stack([(u - 31.5) / 32.0, (v - 23.5) / 32.0, np.ones(u.size)], axis=1)
    normal_of = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal_of /= np.linalg.norm(normal_of, axis=1, keepdims=True)
    for index, (T, frame) in enumerate(zip(source.trajectory.T_world_camera, source.frames.read(True), strict=True)):
        points, which = first_hits(triangles, T[:3, 3], rays @ T[:3, :3].T)
        depth = (points - T[:3, 3]) @ T[:3, 2]
        is_same = np.abs(frame.depth.reshape(-1) - depth) < 1e-4
        assert is_same.mean() > 0.999
        normals = images["/habitat/normals/image"][index].view(np.float32).reshape(-1, 3)
        np.testing.assert_allclose(normals[is_same], (normal_of[which] @ T[:3, :3])[is_same], rtol=0, atol=1e-5)
        assert not images["/habitat/semantic/image"][index].view(np.int32).any(), "a PLY is one part"
        seen = noisy[index] > 0
        assert 0.001 < np.abs(noisy[index][seen] - depth[seen]).mean() < 0.2
