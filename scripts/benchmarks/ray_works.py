"""First hits of rays, and building what they are cast into."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from benchmarks import ours
from benchmarks.flats import Flat
from benchmarks.peers_rays import Cast, VoxelMesh, embreex_caster, open3d_caster, voxel_mesh
from benchmarks.rows import Row, Skipped, check_share
from benchmarks.setting import Setting
from benchmarks.timing import interleaved
from maomaps_warp.model.voxels import pack_keys

F32 = NDArray[np.float32]
#: Of each element, so many poses are looked at, and the nearest that sees it casts its ray.
TRIED_POSES = 16
#: Two hits nearer to one another along the ray are one: the ray passes between two voxels there. Metres.
SAME_HIT = 1e-3
#: Share of rays that may graze an edge, so that rounding decides whether they hit it.
GRAZING_SHARE = 2e-4

CASTERS: dict[str, tuple[str, Callable[[VoxelMesh, int], Cast]]] = {
    "Open3D": ("open3d", open3d_caster),
    "embreex": ("embreex", embreex_caster),
}


def casting(setting: Setting) -> Iterator[Row | Skipped]:
    """Rays in the scorer's order into the ground truth's map."""
    import warp as wp

    flat = setting.flat
    origins, directions = scorer_rays(flat)
    mesh = voxel_mesh(flat.gt_map.ijk, flat.gt_map.grid.voxel_size)
    field = ours.ray_field(flat.gt_map, setting.device)
    starts, ways = (wp.array(rays, dtype=wp.vec3, device=setting.device) for rays in (origins, directions))
    sizes = f"{len(origins)} rays into {len(flat.gt_map)} voxels"
    for peer, (module, build) in CASTERS.items():
        if find_spec(module) is None:
            yield Skipped("rays", f"{module} is not installed")
            continue
        timed = interleaved(
            {
                "ours": lambda: ours.cast(field, starts, ways, setting.threads),
                "theirs": partial(build(mesh, setting.threads), origins, directions),
            },
            setting.repeats,
        )
        agreement = compare_hits(flat, origins, directions, timed["ours"].result, mesh, timed["theirs"].result)
        yield replace(setting.row("rays", sizes, timed["ours"], peer, timed["theirs"]), agreement=agreement)


def building(setting: Setting) -> Iterator[Row | Skipped]:
    """From voxels to something that rays can be cast into."""
    voxels = setting.flat.gt_map
    for peer, (module, build) in CASTERS.items():
        if find_spec(module) is None:
            yield Skipped("ray-build", f"{module} is not installed")
            continue

        def theirs(build: Callable[[VoxelMesh, int], Cast] = build) -> Cast:
            return build(voxel_mesh(voxels.ijk, voxels.grid.voxel_size), setting.threads)

        timed = interleaved({"ours": lambda: ours.ray_field(voxels, setting.device), "theirs": theirs}, setting.repeats)
        row = setting.row("ray-build", f"{len(voxels)} voxels", timed["ours"], f"mesh + {peer}", timed["theirs"])
        yield replace(row, agreement="hits are compared under `rays`")


def scorer_rays(flat: Flat) -> tuple[F32, F32]:
    """Origins and unit directions, (R, 3) float32, metres from the grid's origin, as association casts them.

    An element c of the estimate that pose i sees gives the direction T_gt,i T_est,i^-1 c from pose i of the ground
    truth; elements in the order of the map. Poses within an occupied voxel are left out: there a mesh is entered from
    behind, and a voxel map is hit at once.
    """
    rng = np.random.default_rng(11)
    elements, poses = flat.est_map.points, flat.est.T_world_camera
    x_min, x_max, y_min, y_max = flat.camera.tangent_bounds
    nearest = np.full(len(elements), np.inf)
    chosen = np.full(len(elements), -1)
    grid = flat.gt_map.grid
    free = ~np.isin(pack_keys(grid.ijk_of(flat.gt.positions)), pack_keys(flat.gt_map.ijk))
    in_camera = np.zeros_like(elements)
    for _ in range(TRIED_POSES):
        tried = rng.integers(0, len(poses), len(elements))
        T = poses[tried]
        q = np.einsum("nji,nj->ni", T[:, :3, :3], elements - T[:, :3, 3])
        x, y, z = q.T
        seen = (z > 0.2) & (x > x_min * z) & (x < x_max * z) & (y > y_min * z) & (y < y_max * z)
        distance = np.sqrt(x * x + y * y + z * z)
        better = seen & free[tried] & (distance < nearest)
        nearest[better], chosen[better], in_camera[better] = distance[better], tried[better], q[better]
    rows = np.flatnonzero(chosen >= 0)
    T = flat.gt.T_world_camera[chosen[rows]]
    directions = np.einsum("nij,nj->ni", T[:, :3, :3], in_camera[rows])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = T[:, :3, 3] - grid.origin
    return np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32)


def compare_hits(
    flat: Flat, origins: F32, directions: F32, hits: NDArray[np.int32], mesh: VoxelMesh, triangles: NDArray[np.integer]
) -> str:
    """That both hit the same place on each ray, but for grazing ones, in words.

    Args:
        flat: whose ground truth was hit.
        origins, directions: (R, 3) float32, metres from the grid's origin.
        hits: (R,) voxels that ours hit; -1 for none.
        mesh: what the peer cast into.
        triangles: (R,) triangles that the peer hit; no triangle's number for none.
    """
    inside = (triangles >= 0) & (triangles < len(mesh.triangles))
    others = np.where(inside, mesh.voxel[np.where(inside, triangles, 0)], -1)
    differ = np.flatnonzero(hits != others)
    both = differ[(hits[differ] >= 0) & (others[differ] >= 0)]
    entries = [_entry(flat, origins[both], directions[both], voxels[both]) for voxels in (hits, others)]
    same_place = int((np.abs(entries[0] - entries[1]) < SAME_HIT).sum())
    text = check_share("hits", len(differ) - same_place, len(hits), GRAZING_SHARE)
    return f"{text}; {same_place} pass between two voxels; {int((others < 0).sum())} hit nothing"


def _entry(flat: Flat, origins: F32, directions: F32, voxels: NDArray[np.integer]) -> NDArray[np.float64]:
    """Where rays enter (the planes of) voxels, metres along them."""
    size = flat.gt_map.grid.voxel_size
    o, d = origins.astype(np.float64), directions.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (((flat.gt_map.ijk[voxels] + side) * size - o) / d for side in (-0.5, 0.5))
    return np.asarray(np.nanmax(np.minimum(a, b), axis=1, initial=0.0))
