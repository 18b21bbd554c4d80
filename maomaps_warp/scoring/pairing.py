"""From two trajectories to paired, aligned poses."""

from __future__ import annotations

import numpy as np

from maomaps_warp.errors import InputError, NoScoreError
from maomaps_warp.model.alignment import Alignment
from maomaps_warp.model.paired_poses import PairedPoses
from maomaps_warp.model.results import NoValue
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.protocol import Protocol
from maomaps_warp.scoring.alignment import align
from maomaps_warp.scoring.stamps import match_stamps

StartPose = tuple[float, float, float, float]


def pair_and_align(
    gt: Trajectory | None, est: Trajectory | None, protocol: Protocol, start_pose: StartPose | None = None
) -> tuple[PairedPoses | NoValue, Alignment | None]:
    """Pair two trajectories in time and find the one transform of the estimate.

    Args:
        gt, est: either may be missing; then only alignments that need no pairs can be found.
        protocol: pairing and alignment.
        start_pose: (x, y, z, yaw), metres and radians, of a MAOMaps sample, for `align = start-pose`.

    Returns:
        The pairs, or why there are none; the alignment, None if it could not be found for want of pairs.

    Raises:
        InputError: the alignment needs a trajectory that is missing, or the paths do not determine it.
    """
    start = start_pose if protocol.align == "start-pose" else None
    correction = protocol.yaw_correction if protocol.align == "start-pose" else 0.0
    if protocol.yaw_correction and protocol.align != "start-pose":
        raise InputError("--yaw-correction", "belongs to --align start-pose", f"--align is {protocol.align}")
    if gt is None or est is None:
        side = "ground truth" if gt is None else "estimate"
        if protocol.align != "none" and start is None:
            found = f"the {side} has no trajectory to find the transform from"
            raise InputError(f"--align {protocol.align}", found, "give one, or use --align none")
        nothing = np.empty((0, 4, 4))
        alignment = align(protocol.align, nothing, nothing, start_pose=start, yaw_correction=correction)
        return NoValue(f"the {side} has no trajectory", asked=False), alignment
    try:
        matches = match_stamps(
            gt, est, method=protocol.match, max_gap_s=protocol.stamp_gap, t_offset_s=protocol.t_offset
        )
    except NoScoreError as error:
        counts = {"poses": len(est), "matched": 0, "unmatched": len(est), "pairs": 0}
        no_pairs = NoValue(str(error), asked=True, counts=counts)
        return no_pairs, Alignment() if protocol.align == "none" else None
    T_est = est.T_world_camera[matches.est_index]
    alignment = align(protocol.align, matches.T_world_camera_gt, T_est, start_pose=start, yaw_correction=correction)
    stamps_ns = None
    if matches.method != "index" and est.stamps_ns is not None:
        stamps_ns = est.stamps_ns[matches.est_index]
    pairs = PairedPoses(
        alignment.apply_poses(T_est),
        matches.T_world_camera_gt,
        stamps_ns,
        len(est),
        matches.unmatched,
        matches.method,
        float(matches.gaps_ns.max()) * 1e-9,
    )
    return pairs, alignment
