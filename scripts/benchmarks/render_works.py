"""Depth images of a triangle mesh, as the virtual robot's camera renders them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from benchmarks.rows import Row, Skipped, check_share
from benchmarks.setting import Setting
from benchmarks.timing import interleaved

#: Images, on a way through a furnished flat.
FRAMES = 40
WIDTH, HEIGHT = 320, 240
#: Metres: float32 rays over a few metres.
SAME_DEPTH = 1e-4
#: Share of pixels whose ray passes an edge.
GRAZING_SHARE = 2e-4


def depth(setting: Setting) -> Iterator[Row | Skipped]:
    """Ours with all that a frame takes, Open3D's casting of the same rays alone."""
    from maomaps_warp.model.camera import Camera
    from maomaps_warp.sim.agent import drive
    from maomaps_warp.sim.render import render_frames
    from maomaps_warp.sim.scene import furnished_flat

    if find_spec("open3d") is None:
        yield Skipped("render", "open3d is not installed")
        return
    flat = furnished_flat(0)
    camera = Camera.from_fov(WIDTH, HEIGHT, 90.0)
    way = drive(flat, frames=240).select(np.arange(0, 240, 240 // FRAMES))
    stream = render_frames(flat.world, camera, way, setting.device)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    pixels = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    theirs = _open3d(flat.vertices, flat.triangles, pixels.reshape(-1, 3), way.T_world_camera, setting.threads)
    timed = interleaved(
        {"ours": lambda: [frame.depth for frame in stream.read(False)], "theirs": theirs}, setting.repeats
    )
    both = [np.stack(timed[name].result).reshape(FRAMES, -1) for name in ("ours", "theirs")]
    both[1][~np.isfinite(both[1])] = 0.0
    differ = int((np.abs(both[0] - both[1]) > SAME_DEPTH).sum())
    agreement = check_share("depths to 0.1 mm", differ, both[0].size, GRAZING_SHARE)
    speeds = [FRAMES / float(np.median(timed[name].seconds)) for name in ("ours", "theirs")]
    sizes = (
        f"{FRAMES} images of {WIDTH}x{HEIGHT}, {len(flat.triangles)} triangles: "
        f"{speeds[0]:.0f} frames a second, Open3D {speeds[1]:.0f}"
    )
    yield replace(setting.row("render", sizes, timed["ours"], "Open3D", timed["theirs"]), agreement=agreement)


def _open3d(
    vertices: NDArray[np.float32],
    triangles: NDArray[np.int32],
    pixels: NDArray[np.float64],
    poses: NDArray[np.float64],
    threads: int,
) -> Callable[[], list[NDArray[np.float32]]]:
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
    scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(triangles.astype(np.uint32)))
    rays = []
    for T in poses:
        directions = pixels @ T[:3, :3].T
        origins = np.broadcast_to(T[:3, 3], directions.shape)
        rays.append(o3d.core.Tensor(np.concatenate([origins, directions], axis=1).astype(np.float32)))
    return lambda: [scene.cast_rays(each, nthreads=threads)["t_hit"].numpy() for each in rays]
