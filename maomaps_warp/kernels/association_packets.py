"""Association on a CPU: sixteen elements and one pose at a time, and thirty-two rays.

Elements lie in bricks; the poses that may see a brick are listed once (`association_culling`). They look at it one
after the other, at a packet of sixteen elements at a time (`association_sight`): one pass of vector operations decides
which of them are in view and may still be improved. Their rays stand in line (`ray_line`) until two full packets can
be cast, and what they met is told to their elements (`association_answers`). For the nearest, poses are sorted by how
near one can be to the brick, and end where that is further than the worst of the elements' best; for the first and the
last they end when all elements are decided.

Most rays of the `first`, `last` and `all` end at a wall in front of the element, for pose after pose of a path the same
wall. So each element keeps a trail: where its ray was last stopped. A ray whose point nearest to the trail lies in an
occupied cell, well off its faces and further than the tolerance from the element, is certainly stopped there or before,
and need not be cast; all that is asked of a hidden element is that it is hidden.

That rays wait changes when an answer is known, and so how many needless rays are cast, but no answer: the best of all
poses that see an element is the same in whatever order they are asked.

Cost on a flat of 300,000 voxels and 600 poses: for the nearest, sixteen elements take twenty looks and eighty rays,
which are cast thirty at a time. Limit: a launch is one serial loop that uses its memory for one brick after the other,
so this is for CPUs.
"""

from threading import Lock

import numpy as np
import warp as wp

from maomaps_warp.kernels.association_memory import Workspace, create_workspace
from maomaps_warp.kernels.association_types import Bricks, Pairs, Sight
from maomaps_warp.kernels.modules import PACKETS, is_as_named

_importing = Lock()


def import_called_functions() -> None:
    """Import what the kernels call, to be compiled."""
    global associate_brick
    with _importing:
        if "associate_brick" in globals():
            return
        from maomaps_warp.kernels.association_bricks import associate_brick

        # Files or settings that changed since the module was named go by Warp's hash. And whatever Warp has found out
        # about the module without the functions, it forgets.
        wp.set_module_options({"strip_hash": is_as_named(PACKETS)}, module=PACKETS)


@wp.kernel(module=PACKETS)
def _associate_kernel(
    # In:
    bricks: Bricks,
    sight: Sight,
    choice: wp.int32,
    # Memory:
    space: Workspace,
    # Out:
    out_status: wp.array(dtype=wp.int32),
    out_count: wp.array(dtype=wp.int32),
    out_pairs: Pairs,
):
    associate_brick(wp.tid(), bricks, sight, choice, space, out_status, out_count, out_pairs)


@wp.kernel(module=PACKETS)
def _in_order_kernel(
    # In:
    pairs: Pairs,
    first_element: wp.int32,
    # In and out:
    next_pair: wp.array(dtype=wp.int32),
    # Out:
    out_element: wp.array(dtype=wp.int32),
    out_pose: wp.array(dtype=wp.int32),
    out_est_voxel: wp.array(dtype=wp.int32),
    out_gt_voxel: wp.array(dtype=wp.int32),
):
    found = wp.tid()
    element = pairs.element[found]
    pair = next_pair[element]
    next_pair[element] = pair + 1
    out_element[pair] = first_element + element
    out_pose[pair] = pairs.pose[found]
    out_est_voxel[pair] = pairs.est_voxel[found]
    out_gt_voxel[pair] = pairs.gt_voxel[found]


def associate_packets(
    bricks: Bricks, sight: Sight, choice: int, elements: int, pairs: Pairs
) -> tuple[wp.array, wp.array]:
    """Find the correspondences that `association.associate` and `associate_all` find, bit for bit.

    One serial launch; for several threads call it with several sets of bricks.

    Args:
        bricks: elements, on the CPU.
        sight: poses, view and maps.
        choice: NEAREST, FIRST or LAST of the poses that see an element, or EVERY one of them (`association_types`).
        elements: how many.
        pairs: room for one correspondence of each element, for EVERY one from each pose; filled for `in_order`.

    Returns:
        Best status of each element, (N,) int32; its number of correspondences, (N,) int32.
    """
    if not wp.get_module(PACKETS).execs:  # not loaded, whether compiled before or not
        import_called_functions()
    pairs.used.zero_()
    status, count = (make(elements, dtype=wp.int32, device="cpu") for make in (wp.empty, wp.zeros))
    largest = int(np.diff(bricks.first.numpy()).max(initial=0))
    wp.launch(
        _associate_kernel,
        dim=len(bricks.first) - 1,
        inputs=[bricks, sight, choice, create_workspace(len(sight.poses.est_position), largest)],
        outputs=[status, count, pairs],
        device="cpu",
    )
    return status, count


def in_order(pairs: Pairs, first_element: int, next_pair: wp.array) -> tuple[wp.array, ...]:
    """Correspondences in ascending order of element and pose.

    Args:
        pairs: as `associate_packets` filled them.
        first_element: number of the first element.
        next_pair: (N,) int32, where the correspondences of each element begin; moved to where they end.

    Returns:
        Element, pose, predicted voxel, ground-truth voxel, (M,) int32 each.
    """
    count = int(pairs.used.numpy()[0])
    outs = tuple(wp.empty(count, dtype=wp.int32, device="cpu") for _ in range(4))
    wp.launch(_in_order_kernel, dim=count, inputs=[pairs, first_element, next_pair], outputs=list(outs), device="cpu")
    return outs
