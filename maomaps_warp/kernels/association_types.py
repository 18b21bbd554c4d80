"""What association's kernels are given and what they give: structs, and the numbers that stand for choices and answers.

Apart from the functions that work on it, so that a host needs none of those (see `modules`).
"""

from typing import Any

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.distance_field import DistanceField
from maomaps_warp.kernels.lanes import lanes_f

NO_POSE = wp.constant(-1)
# What became of an element, by pose or over all of them.
OUT_OF_VIEW = wp.constant(0)
OCCLUDED = wp.constant(1)
VISIBLE = wp.constant(2)

# Which of the poses that see an element are taken.
NEAREST = wp.constant(0)
FIRST = wp.constant(1)
LAST = wp.constant(2)
EVERY = wp.constant(3)

#: Rows of a block of poses: position, four normals of the view's borders, optical axis; x, y, z of each.
BLOCK_ROWS = 18


@wp.struct
class View:
    """Which camera-frame points an image shows."""

    x_min: wp.float32  # borders as slopes x/z and y/z
    x_max: wp.float32
    y_min: wp.float32
    y_max: wp.float32
    near: wp.float32  # metres along the optical axis, exclusive
    max_range: wp.float32  # metres, distance to the camera; inf = no limit
    two_sided: wp.bool  # also the mirrored cone behind the camera (the original's defect)


@wp.struct
class PosePairs:
    """Matched poses, camera to map: rotation matrices, and positions in metres relative to the grid's origin."""

    est_rotation: wp.array(dtype=wp.mat33)  # (P,)
    est_position: wp.array(dtype=wp.vec3)  # (P,)
    gt_rotation: wp.array(dtype=wp.mat33)  # (P,)
    gt_position: wp.array(dtype=wp.vec3)  # (P,)


@wp.struct
class Sight:
    """All that decides whether a pose sees an element."""

    poses: PosePairs
    est_origin: wp.array(dtype=wp.vec3)  # (P,) where the rays of each pose begin, coordinates of the field `est` ...
    gt_origin: wp.array(dtype=wp.vec3)  # (P,) ... and of `gt`, see `ray_origin`
    blocks: wp.array2d(dtype=lanes_f)  # the estimated poses for culling, see BLOCK_ROWS
    view: View
    est: DistanceField
    gt: DistanceField
    tolerance: wp.float32  # metres


@wp.struct
class Bricks:
    """Elements in bricks: those of brick b are first[b] to first[b + 1] - 1; metres relative to the grid's origin."""

    first: wp.array(dtype=wp.int32)  # (B + 1,)
    x: wp.array(dtype=wp.float32)  # (N,)
    y: wp.array(dtype=wp.float32)  # (N,)
    z: wp.array(dtype=wp.float32)  # (N,)
    element: wp.array(dtype=wp.int32)  # (N,) where an element's answer goes


@wp.struct
class Pairs:
    """Correspondences of a launch, in the order in which they are found: of one element, in that of its poses."""

    used: wp.array(dtype=wp.int32)  # (1,) how many
    element: wp.array(dtype=wp.int32)
    pose: wp.array(dtype=wp.int32)
    est_voxel: wp.array(dtype=wp.int32)
    gt_voxel: wp.array(dtype=wp.int32)


def check_poses(poses: PosePairs, device: Any) -> None:
    """Raise unless the arrays of pose pairs fit together and lie on `device`."""
    check_array("poses.est_position", poses.est_position, wp.vec3, (None,), device)
    count = len(poses.est_position)
    check_array("poses.est_rotation", poses.est_rotation, wp.mat33, (count,), device)
    check_array("poses.gt_rotation", poses.gt_rotation, wp.mat33, (count,), device)
    check_array("poses.gt_position", poses.gt_position, wp.vec3, (count,), device)
