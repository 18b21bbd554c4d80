"""Whether depth is in the unit that the source declares: only then do views agree from different places."""

from __future__ import annotations

import numpy as np

from maomaps_warp.checking.pairs import choose_pairs
from maomaps_warp.checking.proof import (
    CLEAR_AGREEMENT_OF_LANDED,
    CLEAR_LEAD,
    CLEAR_PAIRS,
    OVERLAP,
)
from maomaps_warp.checking.recorded import camera_poses, select_posed
from maomaps_warp.checking.reprojection import reproject_pairs
from maomaps_warp.checking.sampling import FrameSample
from maomaps_warp.model.check_results import ConventionProof, DepthUnit
from maomaps_warp.model.pose_convention import CONVENTIONS
from maomaps_warp.model.trajectory import Trajectory

#: What depth may have been multiplied by in error: TUM's 1/5000 m taken for millimetres, millimetres for metres.
FACTORS = (1.0, 5.0, 0.2, 1000.0, 0.001)


def prove_depth_unit(sample: FrameSample, recorded: Trajectory, proof: ConventionProof) -> DepthUnit:
    """Carry depth times each factor from frame to frame.

    Where the convention is proved, under that one; else under each of them, for a wrong unit may be why it is not.
    """
    valid = sample.depth[sample.depth > 0].astype(np.float64)
    extent = (float(np.median(valid)), float(valid.min()), float(valid.max())) if len(valid) else (float("nan"),) * 3
    missing = 1.0 - len(valid) / max(1, sample.depth.size)
    agreements, of_landed, pairs = _agreements(sample, recorded, proof)
    fits, factor, reason = _verdict(agreements, of_landed, pairs)
    return DepthUnit(*extent, missing, agreements, fits, factor, reason)


def _agreements(
    sample: FrameSample, recorded: Trajectory, proof: ConventionProof
) -> tuple[dict[float, float], dict[float, float], int]:
    """Agreement of all pixels, that of those that land on depth, and the pairs that overlap."""
    posed, near = select_posed(sample, recorded)
    if len(posed) < 2:
        return {}, {}, 0
    unlike = [candidate.convention for candidate in proof.candidates] or list(CONVENTIONS.values())
    conventions = [proof.best] if proof.best else unlike
    T = np.stack([camera_poses(posed, near, convention) for convention in conventions])
    pairs = choose_pairs(posed, camera_poses(posed, near, CONVENTIONS["optical"]))
    seen = {factor: reproject_pairs(posed, pairs, T, depth_factor=factor) for factor in FACTORS}
    overlap = np.max([one.agreement.max(axis=0, initial=0.0) for one in seen.values()], axis=0) >= OVERLAP
    if not overlap.any():
        return {}, {}, 0
    agreements, of_landed = {}, {}
    for factor, one in seen.items():
        mean = one.agreement[:, overlap].mean(axis=1)
        best = int(np.argmax(mean))
        agreements[factor] = float(mean[best])
        landed = one.landed[best, overlap].sum()
        of_landed[factor] = float(one.agreeing[best, overlap].sum() / max(1, landed))
    return agreements, of_landed, int(overlap.sum())


def _verdict(
    agreements: dict[float, float], of_landed: dict[float, float], pairs: int
) -> tuple[bool | None, float, str]:
    if pairs < CLEAR_PAIRS:
        return None, 1.0, f"only {pairs} pairs of frames overlap, of {CLEAR_PAIRS} that a proof needs"
    ranked = sorted(agreements, key=lambda factor: -agreements[factor])
    best, second = ranked[:2]
    shown = f"x {best:g} agrees on {agreements[best]:.1%} of the pixels, x {second:g} on {agreements[second]:.1%}"
    if of_landed[best] < CLEAR_AGREEMENT_OF_LANDED:
        return None, 1.0, f"depth agrees in no unit: {shown}"
    if agreements[best] - agreements[second] < CLEAR_LEAD:
        return None, 1.0, f"cannot be told, for the camera moves too little from place to place: {shown}"
    return best == 1.0, best, f"depth {shown}"
