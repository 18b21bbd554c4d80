"""Exposed faces of occupied voxels, and the first surface on a ray."""

from typing import Any

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.voxel_hash import build_voxel_index, cell_of
from maomaps_warp.kernels.voxel_keys import EMPTY_KEY, find_slot, pack_key

# No fused multiply-adds: CPU and CUDA must agree on the rays that pass an edge.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NO_HIT = wp.constant(wp.int32(-1))


@wp.struct
class Surface:
    """A voxel map as rays see it: closed cubes of edge `voxel_size`.

    Coordinates are metres relative to the grid's origin. `mesh` is an id and keeps nothing alive: hold on to the
    wp.Mesh that `build_surface` returns beside this.
    """

    mesh: wp.uint64  # id of a wp.Mesh of the exposed faces, two triangles a face
    face_voxel: wp.array(dtype=wp.int32)  # (F,) triangle -> voxel
    centers: wp.array(dtype=wp.vec3)  # (N,) voxel centres
    keys: wp.array(dtype=wp.int64)  # (capacity,) hash of the occupied voxels ...
    values: wp.array(dtype=wp.int32)  # (capacity,) ... to their positions in `centers`
    inv_voxel_size: wp.float32
    center_offset: wp.float32


@wp.func
def neighbour_step(side: wp.int32) -> wp.vec3i:
    """Step to the neighbour behind face `side`: -x, +x, -y, +y, -z, +z."""
    sign = 2 * (side & 1) - 1
    axis = side >> 1
    step = wp.vec3i(0, 0, 0)
    step[axis] = sign
    return step


@wp.func
def is_occupied(keys: wp.array(dtype=wp.int64), ijk: wp.vec3i) -> wp.bool:
    """Whether the hash holds voxel `ijk`; voxels outside the key range are free."""
    key = pack_key(ijk)
    occupied = False
    if key != EMPTY_KEY:
        occupied = find_slot(keys, key) >= 0
    return occupied


@wp.func
def first_surface(surface: Surface, origin: wp.vec3, direction: wp.vec3, max_distance: wp.float32) -> wp.int32:
    """First occupied voxel on a ray, or NO_HIT.

    Args:
        surface: the map.
        origin: metres, map frame. If it lies inside an occupied voxel, that voxel is the hit.
        direction: unit vector, map frame.
        max_distance: metres.
    """
    hit = NO_HIT
    key = pack_key(cell_of(origin, surface.inv_voxel_size, surface.center_offset))
    if key != EMPTY_KEY:
        slot = find_slot(surface.keys, key)
        if slot >= 0:
            hit = surface.values[slot]
    if hit < 0:
        query = wp.mesh_query_ray(surface.mesh, origin, direction, max_distance)
        if query.result:
            hit = surface.face_voxel[query.face]
    return hit


@wp.kernel
def _count_faces_kernel(
    # In:
    ijk: wp.array(dtype=wp.vec3i),
    keys: wp.array(dtype=wp.int64),
    # Out:
    out_faces: wp.array(dtype=wp.int32),
):
    voxel = wp.tid()
    faces = int(0)
    for side in range(6):
        if not is_occupied(keys, ijk[voxel] + neighbour_step(side)):
            faces += 1
    out_faces[voxel] = faces


@wp.func
def _corner(center: wp.vec3, side: wp.int32, turn: wp.int32) -> wp.vec3:
    # In half voxels: corners of face `side`, counter-clockwise seen from outside.
    sign = wp.float32(2 * (side & 1) - 1)
    axis = side >> 1
    a = wp.float32(2 * (((turn + 1) >> 1) & 1) - 1)
    b = wp.float32(2 * (turn >> 1) - 1)
    half = wp.vec3(0.0, 0.0, 0.0)
    half[axis] = sign
    # Swapping the two in-plane axes turns the winding over for the faces that look along -axis.
    half[(axis + 1) % 3] = wp.where(sign > 0.0, a, b)
    half[(axis + 2) % 3] = wp.where(sign > 0.0, b, a)
    return center + half * 0.5


@wp.kernel
def _write_faces_kernel(
    # In:
    ijk: wp.array(dtype=wp.vec3i),
    keys: wp.array(dtype=wp.int64),
    first_face: wp.array(dtype=wp.int32),
    voxel_size: wp.float32,
    center_offset: wp.float32,
    # Out:
    out_centers: wp.array(dtype=wp.vec3),
    out_vertices: wp.array(dtype=wp.vec3),
    out_indices: wp.array(dtype=wp.int32),
    out_face_voxel: wp.array(dtype=wp.int32),
):
    voxel = wp.tid()
    cell = ijk[voxel]
    # Exact in float32: the same corner gets the same bits from every voxel, so the surface is watertight.
    center = wp.vec3(wp.float32(cell[0]), wp.float32(cell[1]), wp.float32(cell[2])) + wp.vec3(
        center_offset, center_offset, center_offset
    )
    out_centers[voxel] = center * voxel_size
    face = first_face[voxel]
    for side in range(6):
        if not is_occupied(keys, cell + neighbour_step(side)):
            for turn in range(4):
                out_vertices[4 * face + turn] = _corner(center, side, turn) * voxel_size
            for triangle in range(2):
                index = 6 * face + 3 * triangle
                out_indices[index] = 4 * face
                out_indices[index + 1] = 4 * face + triangle + 1
                out_indices[index + 2] = 4 * face + triangle + 2
                out_face_voxel[2 * face + triangle] = voxel
            face += 1


@wp.kernel
def _cast_rays_kernel(
    # In:
    surface: Surface,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    max_distance: wp.float32,
    # Out:
    out_voxel: wp.array(dtype=wp.int32),
):
    ray = wp.tid()
    out_voxel[ray] = first_surface(surface, origins[ray], directions[ray], max_distance)


def build_surface(ijk: wp.array, voxel_size: float, center_offset: float = 0.0) -> tuple[wp.Mesh, Surface]:
    """The surface of occupied voxels: their exposed faces as a mesh, normals outwards, and a hash of the voxels.

    Unlike the launchers this reads the number of faces back from the device.

    Args:
        ijk: (N,) vec3i, occupied voxels, unique, N >= 1.
        voxel_size: metres.
        center_offset: 0 if cells are centred on multiples of the voxel size, 0.5 if they start there.

    Returns:
        The mesh (four vertices and two triangles a face, metres), which the caller keeps alive, and the Surface.
    """
    device = ijk.device
    check_array("ijk", ijk, wp.vec3i, (None,), device)
    if not len(ijk):
        raise ValueError("ijk: expected at least one voxel, got none")
    surface = Surface()
    surface.keys, surface.values = build_voxel_index(ijk)
    surface.inv_voxel_size, surface.center_offset = 1.0 / voxel_size, center_offset
    surface.centers = wp.empty(len(ijk), dtype=wp.vec3, device=device)
    counts = wp.empty(len(ijk), dtype=wp.int32, device=device)
    wp.launch(_count_faces_kernel, dim=len(ijk), inputs=[ijk, surface.keys], outputs=[counts], device=device)
    first_face = wp.empty_like(counts)
    wp.utils.array_scan(counts, first_face, inclusive=False)
    faces = int(first_face[-1:].numpy()[0]) + int(counts[-1:].numpy()[0])
    vertices = wp.empty(4 * faces, dtype=wp.vec3, device=device)
    indices = wp.empty(6 * faces, dtype=wp.int32, device=device)
    surface.face_voxel = wp.empty(2 * faces, dtype=wp.int32, device=device)
    wp.launch(
        _write_faces_kernel,
        dim=len(ijk),
        inputs=[ijk, surface.keys, first_face, voxel_size, center_offset],
        outputs=[surface.centers, vertices, indices, surface.face_voxel],
        device=device,
    )
    mesh = wp.Mesh(points=vertices, indices=indices)
    surface.mesh = mesh.id
    return mesh, surface


def check_surface(name: str, surface: Surface, device: Any) -> None:
    """Raise unless the arrays of a surface fit together and lie on `device`."""
    check_array(f"{name}.face_voxel", surface.face_voxel, wp.int32, (None,), device)
    check_array(f"{name}.centers", surface.centers, wp.vec3, (None,), device)
    check_array(f"{name}.keys", surface.keys, wp.int64, (None,), device)
    check_array(f"{name}.values", surface.values, wp.int32, (len(surface.keys),), device)


def cast_rays(
    surface: Surface,
    origins: wp.array,
    directions: wp.array,
    max_distance: float = 1.0e6,
    *,
    out_voxel: wp.array | None = None,
) -> wp.array:
    """First occupied voxel on each ray.

    Args:
        surface: the map.
        origins: (R,) vec3, metres relative to the grid's origin.
        directions: (R,) vec3, unit vectors.
        max_distance: metres.
        out_voxel: (R,) int32. None: allocated.

    Returns:
        out_voxel: position of the hit voxel in the map; -1 where the ray meets nothing.
    """
    device = origins.device
    check_surface("surface", surface, device)
    check_array("origins", origins, wp.vec3, (None,), device)
    check_array("directions", directions, wp.vec3, (len(origins),), device)
    if out_voxel is None:
        out_voxel = wp.empty(len(origins), dtype=wp.int32, device=device)
    check_array("out_voxel", out_voxel, wp.int32, (len(origins),), device)
    wp.launch(
        _cast_rays_kernel,
        dim=len(origins),
        inputs=[surface, origins, directions, max_distance],
        outputs=[out_voxel],
        device=device,
    )
    return out_voxel
