"""Association on a CPU: sixteen elements and one pose at a time.

Elements lie in bricks; the poses that may see a brick are listed once (`association_culling`). A packet of sixteen
elements tries them one after the other: one pass of vector operations decides which elements are in view, one packet of
rays what they meet. For the nearest the list is sorted by how near a pose can be to the brick, and ends where that is
further than the worst of the packet's best; for the first and the last it ends when all elements are decided.

Most rays of the `first`, `last` and `all` end at a wall in front of the element, for pose after pose of a path the same
wall. So a packet keeps a trail: where its rays were last stopped. A ray whose point nearest to the trail lies in an
occupied cell, well off its faces and further than the tolerance from the element, is certainly stopped there or before,
and need not be cast; all that is asked of a hidden element is that it is hidden.

Cost on a flat of 300,000 voxels and 600 poses: nine rays an element for the nearest, ten in a packet. Limit: a launch
is one serial loop that uses its memory for one brick after the other, so this is for CPUs.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from maomaps_warp.kernels.association_bricks import FIRST, LAST, NEAREST, choose_poses, look_from_every_pose
from maomaps_warp.kernels.association_culling import PoseLists, create_pose_lists
from maomaps_warp.kernels.association_sight import Bricks, Rows, Sight
from maomaps_warp.kernels.modules import PACKETS
from maomaps_warp.kernels.voxel_rays import lanes_i

__all__ = ["FIRST", "LAST", "NEAREST", "associate_packets", "associate_packets_all", "collect_rows", "create_rows"]


@wp.kernel(module=PACKETS)
def _one_pose_kernel(
    # In:
    start: wp.int32,
    bricks: Bricks,
    sight: Sight,
    choice: wp.int32,
    lists: PoseLists,
    # Out:
    out_status: wp.array(dtype=wp.int32),
    out_pose: wp.array(dtype=wp.int32),
    out_est_voxel: wp.array(dtype=wp.int32),
    out_gt_voxel: wp.array(dtype=wp.int32),
):
    brick = start + wp.tid()
    choose_poses(brick, bricks, sight, choice, lists, out_status, out_pose, out_est_voxel, out_gt_voxel)


@wp.kernel(module=PACKETS)
def _every_pose_kernel(
    # In:
    start: wp.int32,
    bricks: Bricks,
    sight: Sight,
    lists: PoseLists,
    # Out:
    out_status: wp.array(dtype=wp.int32),
    out_count: wp.array(dtype=wp.int32),
    out_rows: Rows,
):
    look_from_every_pose(start + wp.tid(), bricks, sight, lists, out_status, out_count, out_rows)


@wp.kernel(module=PACKETS)
def _collect_kernel(
    # In:
    start: wp.int32,
    rows: Rows,
    bricks: Bricks,
    first_element: wp.int32,
    # In and out:
    next_pair: wp.array(dtype=wp.int32),
    # Out:
    out_element: wp.array(dtype=wp.int32),
    out_pose: wp.array(dtype=wp.int32),
    out_est_voxel: wp.array(dtype=wp.int32),
    out_gt_voxel: wp.array(dtype=wp.int32),
):
    row = start + wp.tid()
    place = rows.place[row]
    for k in range(16):
        gt_voxel = rows.gt_voxel[row][k]
        if gt_voxel >= 0:
            element = bricks.element[place + k]
            pair = next_pair[element]
            next_pair[element] = pair + 1
            out_element[pair] = first_element + element
            out_pose[pair] = rows.pose[row]
            out_est_voxel[pair] = rows.est_voxel[row][k]
            out_gt_voxel[pair] = gt_voxel


def associate_packets(bricks: Bricks, sight: Sight, choice: int, elements: int) -> tuple[wp.array, ...]:
    """Choose one pose for each element and transfer its ray: what `association.associate` gives, bit for bit.

    One serial launch; for several threads call it with several sets of bricks.

    Args:
        bricks: elements, on the CPU.
        sight: poses, view and maps.
        choice: NEAREST, FIRST or LAST of the poses that see an element.
        elements: how many.

    Returns:
        Status, pose, first predicted voxel and first ground-truth voxel of each element, (N,) int32, as `associate`.
    """
    outs = tuple(wp.empty(elements, dtype=wp.int32, device="cpu") for _ in range(4))
    wp.launch(
        _one_pose_kernel,
        dim=len(bricks.first) - 1,
        inputs=[0, bricks, sight, choice, _create_lists(bricks, sight)],
        outputs=list(outs),
        device="cpu",
    )
    return outs


def create_rows(room: int) -> Rows:
    """Memory for so many pairs of a packet and a pose, on the CPU; a launch after the other may use it."""
    rows = Rows()
    rows.used = wp.zeros(1, dtype=wp.int32, device="cpu")
    rows.place, rows.pose = (wp.empty(room, dtype=wp.int32, device="cpu") for _ in range(2))
    rows.est_voxel, rows.gt_voxel = (wp.empty(room, dtype=lanes_i, device="cpu") for _ in range(2))
    return rows


def associate_packets_all(bricks: Bricks, sight: Sight, rows: Rows, elements: int) -> tuple[wp.array, wp.array]:
    """Transfer the ray of every element from every pose that sees it.

    Args:
        bricks, sight, elements: see `associate_packets`.
        rows: room for each pose and each packet of sixteen elements that the bricks fill; filled for `collect_rows`.

    Returns:
        Best status of each element, (N,) int32; its number of correspondences, (N,) int32.
    """
    rows.used.zero_()
    status, count = (wp.empty(elements, dtype=wp.int32, device="cpu") for _ in range(2))
    wp.launch(
        _every_pose_kernel,
        dim=len(bricks.first) - 1,
        inputs=[0, bricks, sight, _create_lists(bricks, sight)],
        outputs=[status, count, rows],
        device="cpu",
    )
    return status, count


def collect_rows(
    rows: Rows, bricks: Bricks, first_element: int, next_pair: wp.array, pairs: int
) -> tuple[wp.array, ...]:
    """Correspondences of rows in ascending order of element and pose.

    Args:
        rows: as `associate_packets_all` filled them.
        bricks: the same.
        first_element: number of the first element.
        next_pair: (N,) int32, where the correspondences of each element begin; moved to where they end.
        pairs: how many there are.

    Returns:
        Element, pose, predicted voxel, ground-truth voxel, (M,) int32 each.
    """
    outs = tuple(wp.empty(pairs, dtype=wp.int32, device="cpu") for _ in range(4))
    wp.launch(
        _collect_kernel,
        dim=int(rows.used.numpy()[0]),
        inputs=[0, rows, bricks, first_element, next_pair],
        outputs=list(outs),
        device="cpu",
    )
    return outs


def _create_lists(bricks: Bricks, sight: Sight) -> PoseLists:
    largest = int(np.diff(bricks.first.numpy()).max(initial=0))
    return create_pose_lists(len(sight.poses.est_position), largest)
