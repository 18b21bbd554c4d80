"""Back-projection: every pixel of a depth image becomes a sample of a voxel hash.

Paper, section III-A: m = p + d * r. Here with the full pinhole camera (K of camera_info) and the full pose. This is the
plain way, one pixel a thread, for CUDA, and what `voxel_bricks` must equal bit for bit: both compute, in float32 and in
this order,

    a = (u - cx) / fx,  b = (v - cy) / fy
    distance squared = (z z) ((1 + b b) + a a)
    coordinate_i = T_i3 + z ((T_i2 + T_i1 b) + a T_i0)          in cells
    voxel_i = coordinate_i rounded, halves to even                (its floor where cells start at multiples)

with T the pose that takes metres of the camera to cells of the grid.
"""

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.voxel_hash import VoxelHash, add_sample, cell_of, check_table

# No fused multiply-adds: CPU and CUDA, and lanes of a vector, must put a point on a face into the same cell.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class Pinhole:
    """Intrinsics, pixels. Pixel (0, 0) is the centre of the first pixel; optical frame."""

    fx: wp.float32
    fy: wp.float32
    cx: wp.float32
    cy: wp.float32


@wp.struct
class DepthSampling:
    """What becomes of a pixel."""

    min_range: wp.float32  # metres, distance to the camera, exclusive
    max_range: wp.float32  # metres, exclusive
    center_offset: wp.float32  # 0: cells centred on multiples of the voxel size; 0.5: starting there
    stride: wp.int32  # take every stride-th pixel of each row and column, from pixel 0


@wp.func
def color_at(colors: wp.array3d(dtype=wp.uint8), v: wp.int32, u: wp.int32) -> wp.vec3i:
    """RGB of a pixel; (0, 0, 0) where there are no colours, (0, 0, 3)."""
    color = wp.vec3i(0, 0, 0)
    if colors.shape[0] > 0:
        color = wp.vec3i(wp.int32(colors[v, u, 0]), wp.int32(colors[v, u, 1]), wp.int32(colors[v, u, 2]))
    return color


@wp.func
def _coordinate(T: wp.mat44, axis: wp.int32, a: wp.float32, b: wp.float32, depth: wp.float32) -> wp.float32:
    return T[axis, 3] + depth * ((T[axis, 2] + T[axis, 1] * b) + a * T[axis, 0])


@wp.kernel
def _integrate_depth_kernel(
    # In:
    depth: wp.array2d(dtype=wp.float32),
    colors: wp.array3d(dtype=wp.uint8),
    camera: Pinhole,
    T_cells_camera: wp.array(dtype=wp.mat44),
    sampling: DepthSampling,
    # Out:
    table: VoxelHash,
):
    row, column = wp.tid()
    v = row * sampling.stride
    u = column * sampling.stride
    z = depth[v, u]
    a = (wp.float32(u) - camera.cx) / camera.fx
    b = (wp.float32(v) - camera.cy) / camera.fy
    distance_squared = (z * z) * ((1.0 + b * b) + a * a)
    least = sampling.min_range * sampling.min_range
    most = sampling.max_range * sampling.max_range
    if z > 0.0 and distance_squared > least and distance_squared < most:
        T = T_cells_camera[0]
        cells = wp.vec3(_coordinate(T, 0, a, b, z), _coordinate(T, 1, a, b, z), _coordinate(T, 2, a, b, z))
        add_sample(table, cell_of(cells, 1.0, sampling.center_offset), color_at(colors, v, u), wp.int64(1))


def check_depth_image(depth: wp.array, colors: wp.array | None, stride: int, table: VoxelHash) -> wp.array:
    """Raise unless a depth image, its colours and the table that takes them fit together; the colours, or (0, 0, 3)."""
    device = depth.device
    check_array("depth", depth, wp.float32, (None, None), device)
    check_table("out_table", table, device)
    if stride < 1:
        raise ValueError(f"sampling.stride: expected at least 1, got {stride}")
    if (colors is None) != (table.color_sums.shape[0] == 0):
        raise ValueError("colors: expected exactly if out_table keeps colours")
    if colors is None:
        return wp.empty((0, 0, 3), dtype=wp.uint8, device=device)
    check_array("colors", colors, wp.uint8, (*depth.shape, 3), device)
    return colors


def integrate_depth(
    depth: wp.array,
    camera: Pinhole,
    T_cells_camera: wp.array,
    sampling: DepthSampling,
    *,
    colors: wp.array | None = None,
    out_table: VoxelHash,
) -> None:
    """Add one depth image to a voxel hash.

    Args:
        depth: (H, W) float32, metres along the optical axis; values <= 0 and NaN are missing.
        camera: intrinsics of the image.
        T_cells_camera: (1,) mat44, takes camera-frame metres to cells of the grid: [s R | (p - origin) / voxel_size]
            with R and p the camera's rotation and position (metres, world) and s = 1 / voxel_size, times the scale of
            a Sim(3) alignment; best computed in float64. An array, so that a captured graph can be replayed for the
            next frame.
        sampling: ranges, which are tested before any scale; kind of cells; stride.
        colors: (H, W, 3) uint8 RGB, or None; the table must keep colours exactly if they are given.
        out_table: takes the samples; those it could not take are counted in its `rejected`.
    """
    device = depth.device
    colors = check_depth_image(depth, colors, sampling.stride, out_table)
    check_array("T_cells_camera", T_cells_camera, wp.mat44, (1,), device)
    height, width = depth.shape
    wp.launch(
        _integrate_depth_kernel,
        dim=(-(-height // sampling.stride), -(-width // sampling.stride)),
        inputs=[depth, colors, camera, T_cells_camera, sampling],
        outputs=[out_table],
        device=device,
    )
