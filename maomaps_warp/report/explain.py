"""A protocol in words: formulas, constants and their sources."""

from __future__ import annotations

import dataclasses

from maomaps_warp.map_protocol import MapProtocol
from maomaps_warp.protocol import Protocol

_FORMULAS = """\
T_a_b takes b-coordinates to a. Camera frame: optical (x right, y down, z forward). * marks the estimate.

ATE       sqrt(mean |p_t - p*_t|^2) over the paired poses; rotation: angle of R*_t^-1 R_t     (paper, eq. ATE)
RPE       sqrt(mean |R_t^-1 (p_t' - p_t) - R*_t^-1 (p*_t' - p*_t)|^2), t' = t + {rpe_frames}         (paper, eq. RPE)
AME nn    distance of every point of the estimate to the nearest point of the ground truth, no cut-off;
          completeness is the same the other way
AME rays  for a predicted element c and a pose pair t that sees it:
            q = T*_t^-1 c                      the camera-frame direction
            m = first ground-truth voxel on the ray from p_t along R_t q          (the transferred ray)
            m* = {est_point}
            abs error |m* - m|, rel error |T*_t^-1 m* - T_t^-1 m|
          c is seen from t if q lies in the image, {front}, within {view_range},
          and the first predicted voxel on the ray from p*_t along R*_t q has its centre nearer than
          {occlusion_tolerance} m to c. A camera inside an occupied voxel sees that voxel.
          Of the poses that see c: {pose_choice}.
          Every element ends in one class: associated, out of view (of every pose), occluded (in view of some,
          seen from none), no ground truth (the transferred ray meets nothing). They add up to the total.
          The paper prints the direction as R*^-1 R (m* - p*); geometry and the original's code want R R*^-1.
Headline  {headline} of the AME; every statistic is printed beside it.
"""


_MAP_FORMULAS = """\
T_a_b takes b-coordinates to a. Camera frame: optical (x right, y down, z forward).

A pixel (u, v) of depth d becomes the point  p = T_world_camera (d (u - cx) / fx, d (v - cy) / fy, d).
It counts if min_range < its distance to the camera < max_range; its voxel is round(p / voxel_size).
"""


def explain(protocol: Protocol) -> str:
    """Formulas with this protocol's choices filled in, then every constant with value, unit, meaning and source."""
    return "\n".join([f"Protocol {protocol.name}", "", _formulas(protocol), *_constants(protocol)]) + "\n"


def explain_map(protocol: MapProtocol) -> str:
    """The same for a protocol of ground-truth maps."""
    return "\n".join([f"Map protocol {protocol.name}", "", _MAP_FORMULAS, *_constants(protocol)]) + "\n"


def _constants(protocol: Protocol | MapProtocol) -> list[str]:
    text = ["Constants", ""]
    for f in dataclasses.fields(protocol):
        if f.name == "name":
            continue
        value = getattr(protocol, f.name)
        if f.name == "max_stamp_gap":
            value = protocol.stamp_gap
        unit = f" {f.metadata['unit']}" if f.metadata["unit"] else ""
        shown = ", ".join(str(v) for v in value) if isinstance(value, tuple) else str(value)
        shown = "unset" if value in (None, "") else shown
        text += [f"  {f.name} = {shown}{unit}", f"      {f.metadata['meaning']}"]
        text += [f"      source: {f.metadata['source']}"]
    return text


def _formulas(protocol: Protocol) -> str:
    choice = {
        "nearest": "the one nearest to it",
        "first": "the first",
        "last": "the last",
        "all": "all of them, one correspondence each",
    }
    return _FORMULAS.format(
        est_point={
            "first-surface": "first predicted voxel on the ray from p*_t along R*_t q",
            "element": "c itself",
        }[protocol.est_point],
        front="before OR BEHIND the camera" if protocol.two_sided_view else f"more than {protocol.near} m in front",
        view_range="any range" if protocol.view_range == float("inf") else f"{protocol.view_range} m",
        occlusion_tolerance=protocol.occlusion_tolerance,
        pose_choice=choice[protocol.pose_choice],
        headline=protocol.headline,
        rpe_frames=protocol.rpe_frames,
    )
