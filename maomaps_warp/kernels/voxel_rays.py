"""First occupied voxels on many rays: the launcher. How they are cast is told in `ray_cast` and in `ray_packets`."""

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.distance_field import DistanceField, check_field
from maomaps_warp.kernels.field_cells import ray_origin, voxel_at
from maomaps_warp.kernels.lanes import LANES, lanes_f
from maomaps_warp.kernels.modules import OPTIONS
from maomaps_warp.kernels.ranges import launch_ranges
from maomaps_warp.kernels.ray_cast import cast_ray
from maomaps_warp.kernels.ray_packets import Packet, cast_packets

# Loops over lanes are left to LLVM, see `modules`.
wp.set_module_options(OPTIONS)
wp.set_module_options({"max_unroll": 1})

#: Rays of a task on a CPU.
_TWO_PACKETS = wp.constant(2 * LANES)


@wp.func(inline=True)
def _load_rays(field: DistanceField, origins: wp.array(dtype=wp.vec3), directions: wp.array(dtype=wp.vec3), first: int):
    """Sixteen rays from `first` on; beyond the last there are none."""
    last = origins.shape[0] - 1
    ox = lanes_f()
    oy = lanes_f()
    oz = lanes_f()
    dx = lanes_f()
    dy = lanes_f()
    dz = lanes_f()
    active = lanes_f()
    for lane in range(LANES):
        ray = wp.min(first + lane, last)
        origin = ray_origin(field, origins[ray])
        ox[lane] = origin[0]
        oy[lane] = origin[1]
        oz[lane] = origin[2]
        direction = directions[ray]
        dx[lane] = direction[0]
        dy[lane] = direction[1]
        dz[lane] = direction[2]
        active[lane] = wp.where(first + lane <= last, 1.0, 0.0)
    return Packet(ox, oy, oz, dx, dy, dz, active)


@wp.kernel
def _cast_packets_kernel(
    # In:
    start: wp.int32,
    field: DistanceField,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    # Out:
    out_voxel: wp.array(dtype=wp.int32),
):
    first = _TWO_PACKETS * (start + wp.tid())
    second = first + LANES
    rays = _load_rays(field, origins, directions, first)
    rays2 = _load_rays(field, origins, directions, second)
    x, y, z, x2, y2, z2 = cast_packets(field, rays, rays2)
    for lane in range(wp.min(wp.int32(LANES), origins.shape[0] - first)):
        out_voxel[first + lane] = voxel_at(field, x[lane], y[lane], z[lane])
    for lane in range(wp.min(wp.int32(LANES), origins.shape[0] - second)):
        out_voxel[second + lane] = voxel_at(field, x2[lane], y2[lane], z2[lane])


@wp.kernel
def _cast_rays_kernel(
    # In:
    start: wp.int32,
    field: DistanceField,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    # Out:
    out_voxel: wp.array(dtype=wp.int32),
):
    ray = start + wp.tid()
    cell = cast_ray(field, ray_origin(field, origins[ray]), directions[ray])
    out_voxel[ray] = voxel_at(field, cell[0], cell[1], cell[2])


def cast_voxel_rays(
    field: DistanceField,
    origins: wp.array,
    directions: wp.array,
    *,
    out_voxel: wp.array | None = None,
    packets: bool = True,
    threads: int = 1,
) -> wp.array:
    """First occupied voxel on each ray.

    Args:
        field: the map.
        origins: (R,) vec3, metres relative to the grid's origin.
        directions: (R,) vec3, of any length from 1e-18 to 1e18.
        out_voxel: (R,) int32. None: allocated.
        packets: sixteen rays at a time where the device is a CPU; False: one by one, with the same answers.
        threads: on a CPU.

    Returns:
        out_voxel: position of the hit voxel in the map; -1 where the ray meets nothing or has no direction.
    """
    device = origins.device
    check_field("field", field, device)
    check_array("origins", origins, wp.vec3, (None,), device)
    check_array("directions", directions, wp.vec3, (len(origins),), device)
    if out_voxel is None:
        out_voxel = wp.empty(len(origins), dtype=wp.int32, device=device)
    check_array("out_voxel", out_voxel, wp.int32, (len(origins),), device)
    in_packets = packets and device.is_cpu
    launch_ranges(
        _cast_packets_kernel if in_packets else _cast_rays_kernel,
        -(-len(origins) // int(_TWO_PACKETS)) if in_packets else len(origins),
        inputs=[field, origins, directions],
        outputs=[out_voxel],
        device=device,
        threads=threads,
        grain=64,
    )
    return out_voxel
