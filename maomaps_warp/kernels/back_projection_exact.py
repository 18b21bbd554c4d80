"""Back-projection in float64, for maps that another program must reproduce voxel for voxel.

As `back_projection`, but points are taken in the world and divided by the voxel size, so that nothing but the order of
these operations, which is written here, decides the voxel of a sample:

    x = d (u - cx) / fx,  y = d (v - cy) / fy,  z = d             left to right
    distance = sqrt(x x + y y + z z)
    p_i = R_i0 x + R_i1 y + R_i2 z + t_i                           left to right
    voxel = rint(p / voxel_size), halves to even                   (floor(p / voxel_size) where center_offset is 0.5)
"""

import warp as wp

from maomaps_warp.kernels.back_projection import check_depth_image, color_at
from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.voxel_hash import VoxelHash, add_sample
from maomaps_warp.kernels.voxel_keys import KEY_BIAS

# No fused multiply-adds: they round once where the definition above rounds twice.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class ExactPinhole:
    """Intrinsics, pixels. Pixel (0, 0) is the centre of the first pixel; optical frame."""

    fx: wp.float64
    fy: wp.float64
    cx: wp.float64
    cy: wp.float64


@wp.struct
class ExactSampling:
    """What becomes of a pixel."""

    min_range: wp.float64  # metres, distance to the camera, exclusive
    max_range: wp.float64  # metres, exclusive
    depth_scale: wp.float64  # multiplies points in the camera frame AFTER the range test (a Sim(3) alignment)
    voxel_size: wp.float64  # metres
    center_offset: wp.float64  # 0: cells centred on multiples of the voxel size; 0.5: starting there
    stride: wp.int32  # take every stride-th pixel of each row and column, from pixel 0
    origin_ijk: wp.vec3l  # the world's index of the cell that the table calls (0, 0, 0)


@wp.func
def back_project_exact(camera: ExactPinhole, u: wp.float64, v: wp.float64, depth: wp.float64) -> wp.vec3d:
    """Camera-frame point (metres, optical) of pixel (u, v) at `depth` metres along the optical axis."""
    return wp.vec3d(depth * (u - camera.cx) / camera.fx, depth * (v - camera.cy) / camera.fy, depth)


@wp.func
def _relative_cell(scaled: wp.float64, center_offset: wp.float64, origin: wp.int64) -> wp.int32:
    cell = wp.floor(scaled)
    if center_offset == wp.float64(0.0):
        cell = wp.rint(scaled)
    # Converting NaN or a huge number to an integer is undefined: these get an index that no key holds.
    index = 2 * KEY_BIAS
    if wp.abs(cell) < wp.float64(9.0e15):
        relative = wp.int64(cell) - origin
        if wp.abs(relative) < wp.int64(2 * KEY_BIAS):
            index = wp.int32(relative)
    return index


@wp.func
def cell_of_exact(point: wp.vec3d, sampling: ExactSampling) -> wp.vec3i:
    """Voxel that holds `point` (metres, world), relative to the grid's origin."""
    return wp.vec3i(
        _relative_cell(point[0] / sampling.voxel_size, sampling.center_offset, sampling.origin_ijk[0]),
        _relative_cell(point[1] / sampling.voxel_size, sampling.center_offset, sampling.origin_ijk[1]),
        _relative_cell(point[2] / sampling.voxel_size, sampling.center_offset, sampling.origin_ijk[2]),
    )


@wp.kernel
def _integrate_depth_exact_kernel(
    # In:
    depth: wp.array2d(dtype=wp.float32),
    colors: wp.array3d(dtype=wp.uint8),
    camera: ExactPinhole,
    T_world_camera: wp.array(dtype=wp.mat44d),
    sampling: ExactSampling,
    # Out:
    table: VoxelHash,
):
    row, column = wp.tid()
    v = row * sampling.stride
    u = column * sampling.stride
    z = wp.float64(depth[v, u])
    if z > wp.float64(0.0):
        q = back_project_exact(camera, wp.float64(u), wp.float64(v), z)
        distance = wp.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
        if distance > sampling.min_range and distance < sampling.max_range:
            q = q * sampling.depth_scale
            T = T_world_camera[0]
            p = wp.vec3d(
                T[0, 0] * q[0] + T[0, 1] * q[1] + T[0, 2] * q[2] + T[0, 3],
                T[1, 0] * q[0] + T[1, 1] * q[1] + T[1, 2] * q[2] + T[1, 3],
                T[2, 0] * q[0] + T[2, 1] * q[1] + T[2, 2] * q[2] + T[2, 3],
            )
            add_sample(table, cell_of_exact(p, sampling), color_at(colors, v, u), wp.int64(1))


def integrate_depth_exact(
    depth: wp.array,
    camera: ExactPinhole,
    T_world_camera: wp.array,
    sampling: ExactSampling,
    *,
    colors: wp.array | None = None,
    out_table: VoxelHash,
) -> None:
    """Add one depth image to a voxel hash, in float64.

    Args:
        depth: (H, W) float32, metres along the optical axis; values <= 0 and NaN are missing.
        camera: intrinsics of the image.
        T_world_camera: (1,) mat44d, camera frame to the world, metres; an array, so that a captured graph can be
            replayed for the next frame.
        sampling: ranges, voxel size, stride, and the grid's origin.
        colors: (H, W, 3) uint8 RGB, or None; the table must keep colours exactly if they are given.
        out_table: takes the samples; those it could not take are counted in its `rejected`.
    """
    device = depth.device
    colors = check_depth_image(depth, colors, sampling.stride, out_table)
    check_array("T_world_camera", T_world_camera, wp.mat44d, (1,), device)
    height, width = depth.shape
    wp.launch(
        _integrate_depth_exact_kernel,
        dim=(-(-height // sampling.stride), -(-width // sampling.stride)),
        inputs=[depth, colors, camera, T_world_camera, sampling],
        outputs=[out_table],
        device=device,
    )
