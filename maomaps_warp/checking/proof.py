"""What recorded poses mean, proved: depth carried from frame to frame agrees under the right convention alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.checking.mounting import TURN_RAD, better_turned
from maomaps_warp.checking.pairs import choose_pairs
from maomaps_warp.checking.recorded import camera_poses, recorded_poses, select_posed
from maomaps_warp.checking.reprojection import Reprojection, reproject_pairs
from maomaps_warp.checking.sampling import FrameSample, sample_frames
from maomaps_warp.checking.yaw import PUBLISHED_WITHIN_RAD, YawSearch, search_yaw, turned, turns_about
from maomaps_warp.model.check_results import Candidate, ConventionProof
from maomaps_warp.model.frame import FrameStream
from maomaps_warp.model.pose_convention import CONVENTIONS, PoseConvention, inverse_poses
from maomaps_warp.model.trajectory import Trajectory

__all__ = ["Candidate", "ConventionProof", "prove", "prove_convention", "recorded_poses", "says_the_same"]

F64 = NDArray[np.float64]

#: A proof is clear if of the best convention's pixels that land on depth at least this share agree,
CLEAR_AGREEMENT_OF_LANDED = 2.0 / 3.0
#: its agreement leads that of every other one by at least this much in the mean over the pairs,
CLEAR_LEAD = 0.05
#: it is ahead in at least this share of the pairs,
CLEAR_AHEAD = 2.0 / 3.0
#: there are at least so many pairs that overlap,
CLEAR_PAIRS = 4
#: and a yaw correction, where one was searched for, is known to this, radians.
CLEAR_YAW_SPREAD_RAD = 0.03
RULE = (
    f"clear: at least {CLEAR_PAIRS} pairs of frames overlap, {CLEAR_AGREEMENT_OF_LANDED:.0%} of the pixels that land "
    f"on depth agree, the agreement leads by {CLEAR_LEAD:.0%} of the pixels in the mean and is ahead in "
    f"{CLEAR_AHEAD:.0%} of the pairs, a yaw correction is known to {CLEAR_YAW_SPREAD_RAD} rad, and a camera turned by "
    f"{TURN_RAD} rad fits no better"
)
#: Two frames overlap if under some convention at least this share of their pixels agrees.
OVERLAP = 0.1
#: Conventions are the same if all relative poses are, to a thousandth of a radian and a millimetre.
SAME_POSE = 1e-3

#: Conventions that differ by a yaw alone, the plainest first, and the axis that poses recorded so turn about: as
#: robots on a floor do. Where they do, the yaw is searched for; where they do not, MAOMaps' are out of question.
_YAW_FAMILIES = {"z": ("body", "maomaps-b", "maomaps-c"), "y": ("maomaps-a",)}


def prove_convention(
    stream: FrameStream, recorded: Trajectory, *, progress: Callable[[int, int | None], None] | None = None
) -> ConventionProof:
    """Find what the recorded poses mean, from the depth images.

    Args:
        stream: the frames; at most the first sampling.FRAMES_LOOKED_AT are read.
        recorded: the poses as they stand in the source, read as camera-to-world with x y z w
            (pose_frame="optical"; see `recorded_poses`). Pose i is that of frame i if either has no stamps.
        progress: progress(frames done, frames in all or None).
    """
    return prove(sample_frames(stream, progress=progress), recorded)


def prove(sample: FrameSample, recorded: Trajectory, *, also: PoseConvention | None = None) -> ConventionProof:
    """The same of frames that were sampled already; `also` is a candidate beside those that are known by name."""
    posed, near = select_posed(sample, recorded)
    lost = len(sample) - len(posed)
    if len(posed) < 2:
        found = f"{len(posed)} of {len(sample)} frames have a pose at their stamp"
        return ConventionProof((), None, False, f"nothing to compare: {found}", len(posed), lost)
    T_recorded = camera_poses(posed, near, CONVENTIONS["optical"])
    pairs = choose_pairs(posed, T_recorded)
    families = [names for axis, names in _YAW_FAMILIES.items() if turns_about(T_recorded, axis)]
    searches = tuple(search for names in families if (search := _searched(posed, near, pairs, names)))
    conventions = {name: c for name, c in CONVENTIONS.items() if not _is_out_of_question(name, families)}
    conventions |= {also.name: also} if also else {}
    conventions |= {search.convention.name: search.convention for search in searches}
    poses = {name: camera_poses(posed, near, convention) for name, convention in conventions.items()}
    groups = _groups(poses)
    seen = reproject_pairs(posed, pairs, np.stack([poses[name] for name in groups]))
    candidates = _candidates(conventions, groups, searches, seen)
    reason, is_clear = _verdict(candidates)
    if is_clear and (falls := better_turned(posed, pairs, poses[candidates[0].convention.name])):
        is_clear = False
        reason = (
            f"the camera is mounted otherwise than {candidates[0].convention.name} supposes, or tilted: turned by "
            f"{TURN_RAD} rad it fits better, by {falls:.1%}; else {reason}"
        )
    best = candidates[0].convention if is_clear else None
    return ConventionProof(candidates, best, is_clear, reason, len(posed), lost)


def says_the_same(proof: ConventionProof, convention: PoseConvention) -> bool:
    """Whether a convention is the best candidate, or says the same of the recording."""
    best = proof.candidates[0]
    if convention.name in (best.convention.name, *best.equivalents):
        return True
    turn = math.remainder(convention.yaw - best.convention.yaw, 2.0 * math.pi)
    return _differ_by_yaw(convention, best.convention) and abs(turn) <= PUBLISHED_WITHIN_RAD


def _is_out_of_question(name: str, families: list[tuple[str, ...]]) -> bool:
    return name in ("maomaps-a", "maomaps-b") and not any(name in names for names in families)


def _searched(
    posed: FrameSample, near: Trajectory, pairs: NDArray[np.int64], names: tuple[str, ...]
) -> YawSearch | None:
    """The yaw of a kind of conventions; None if the camera turns on the spot, where every yaw says the same."""
    T = camera_poses(posed, near, replace(CONVENTIONS[names[0]], yaw=0.0))
    if _are_same(*turned(T, np.array([0.0, 1.0]))):
        return None
    return search_yaw(posed, pairs, T, names)


def _groups(poses: dict[str, F64]) -> dict[str, tuple[str, ...]]:
    """Names by the first of their equals."""
    groups: dict[str, tuple[str, ...]] = {}
    for name, T in poses.items():
        same = next((first for first in groups if _are_same(poses[first], T)), None)
        groups[same or name] = (*groups[same], name) if same else ()
    return groups


def _are_same(T_a: F64, T_b: F64) -> bool:
    """Whether poses, (N, 4, 4), are the same up to one transform of the world."""
    first_a, first_b = (inverse_poses(T[:1]) @ T for T in (T_a, T_b))
    return bool(np.abs(first_a - first_b).max() < SAME_POSE)


def _candidates(
    conventions: dict[str, PoseConvention],
    groups: dict[str, tuple[str, ...]],
    searches: tuple[YawSearch, ...],
    seen: Reprojection,
) -> tuple[Candidate, ...]:
    overlap = seen.agreement.max(axis=0, initial=0.0) >= OVERLAP
    if not overlap.any():
        return ()
    agreement = seen.agreement[:, overlap]
    mean = agreement.mean(axis=1)
    order = np.argsort(-mean, kind="stable").tolist()
    names = list(groups)
    found = []
    for k in order:
        convention = conventions[names[k]]
        search = next((s for s in searches if _differ_by_yaw(s.convention, convention)), None)
        landed = seen.landed[k, overlap]
        found.append(
            Candidate(
                convention=convention,
                equivalents=groups[names[k]],
                agreement=float(mean[k]),
                agreement_of_landed=float(seen.agreeing[k, overlap].sum() / max(1, landed.sum())),
                landed=float((landed / seen.valid[overlap]).mean()),
                residual_m=_median(seen.residual_m[k, overlap]),
                residual_share=_median(seen.residual_share[k, overlap]),
                ahead=float((agreement[order[0]] > agreement[k]).mean()),
                pairs=int(overlap.sum()),
                pixels=int(seen.valid[overlap].sum()),
                yaw_found_rad=search.found_rad if search else None,
                yaw_spread_rad=search.spread_rad if search else None,
            )
        )
    return tuple(found)


def _verdict(candidates: tuple[Candidate, ...]) -> tuple[str, bool]:
    """The reason, and whether it is one for a clear proof."""
    if not candidates:
        return "under no convention do two frames show the same place", False
    best = candidates[0]
    name = best.convention.name
    # A yaw that was searched for is settled by how far it scatters, not by its neighbours.
    searched = best.yaw_spread_rad is not None
    rivals = [c for c in candidates[1:] if not (searched and _differ_by_yaw(c.convention, best.convention))]
    if not rivals:
        return "the camera does not move: every convention fits", False
    if best.pairs < CLEAR_PAIRS:
        return f"only {best.pairs} pairs of frames overlap, of {CLEAR_PAIRS} that a proof needs", False
    if best.agreement_of_landed < CLEAR_AGREEMENT_OF_LANDED:
        agreeing = f"under the best, {name}, {best.agreement_of_landed:.0%} of the pixels that land on depth agree"
        return f"no convention fits: {agreeing}, of {CLEAR_AGREEMENT_OF_LANDED:.0%} that a proof needs", False
    second, ahead = rivals[0], min(rival.ahead for rival in rivals)
    shown = (
        f"{name} agrees on {best.agreement:.1%} of the pixels, {second.convention.name} on {second.agreement:.1%}; "
        f"ahead in {ahead:.0%} of {best.pairs} pairs of frames"
    )
    if best.agreement - second.agreement < CLEAR_LEAD or ahead < CLEAR_AHEAD:
        return f"too close to call: {shown}", False
    spread = best.yaw_spread_rad
    if spread is not None and spread > CLEAR_YAW_SPREAD_RAD:
        moves = "the camera moves too little from place to place"
        return f"the yaw correction is only known to {spread:.2f} rad, for {moves}; else {shown}", False
    return shown, True


def _differ_by_yaw(a: PoseConvention, b: PoseConvention) -> bool:
    """Whether two conventions differ by their yaw at most."""
    return (a.axes, a.is_inverse, a.order) == (b.axes, b.is_inverse, b.order)


def _median(values: F64) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else float("nan")
