"""The maps of a run, from clouds or from depth frames, on one grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.sources import Source
from maomaps_warp.mapping import cloud_map
from maomaps_warp.model.alignment import Alignment
from maomaps_warp.model.results import NoValue
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap
from maomaps_warp.protocol import Protocol
from maomaps_warp.stopwatch import Stopwatch


@dataclass(frozen=True, eq=False)
class SideMap:
    """The map of one side.

    Attributes:
        points: (N, 3) float64, metres, the ground truth's world: the points of a cloud as they are, or the voxel
            centres of a map built from frames. Nearest neighbours are taken between these.
        voxels: the occupied cells.
        facts: sizes and what was left out, for the report.
    """

    points: NDArray[np.float64]
    voxels: VoxelMap
    facts: dict[str, int]


def build_both(
    gt: Source, est: Source, alignment: Alignment, protocol: Protocol, device: str, clock: Stopwatch
) -> tuple[SideMap, SideMap] | NoValue:
    """Both maps in the ground truth's world on one grid, or why a map is empty.

    Raises:
        InputError: frames without poses, points beyond the reach of the grid.
    """
    place = _middle(gt)
    if place is None:
        return NoValue(f"{gt.name}: the ground truth's map is empty", asked=True)
    grid = VoxelGrid.around(place, protocol.voxel_size, protocol.center_offset)
    gt_map = build_side("ground-truth map", gt, Alignment(), grid, protocol, device, clock)
    # One recording has one clock; a trajectory file beside it may have another, which the offset is for.
    offset = 0.0 if est.one_clock else protocol.t_offset
    est_map = build_side("estimated map", est, alignment, grid, protocol, device, clock, t_offset_s=offset)
    for source, side_map in ((gt, gt_map), (est, est_map)):
        if not len(side_map.voxels):
            return NoValue(f"{source.name}: {_why_empty(side_map.facts)}", asked=True, counts=side_map.facts)
    return gt_map, est_map


def build_side(
    stage: str,
    source: Source,
    alignment: Alignment,
    grid: VoxelGrid,
    protocol: Protocol,
    device: str,
    clock: Stopwatch,
    *,
    t_offset_s: float = 0.0,
    with_colors: bool = False,
) -> SideMap:
    """The map of a side, moved by `alignment`: of its cloud, or of its frames through its trajectory.

    `t_offset_s`, seconds, is added to the trajectory's stamps before frames look for their poses.

    Raises:
        InputError: as `build_both`.
    """
    with clock.stage(stage) as progress:
        if source.cloud is not None:
            points = alignment.apply_points(source.cloud.points)
            cloud_map.check_extent(points, grid, source.name)
            # OctoMap holds points in float32; that decides the cell of a point on a cell's face.
            exact = points if protocol.cells == "rounded" else points.astype(np.float32).astype(np.float64)
            voxels = cloud_map.voxelise(exact, grid, source.cloud.colors if with_colors else None)
            facts = {"points": len(points), "dropped_nonfinite": source.cloud.dropped_nonfinite}
            return SideMap(points, voxels, facts | {"voxels": len(voxels)})
        if source.frames is None or source.trajectory is None:
            raise InputError(source.name, "depth frames without poses", "give a trajectory file for them")
        from maomaps_warp.mapping import voxel_map  # which loads more than clouds need
        from maomaps_warp.scoring.frame_poses import pose_of_frame
        from maomaps_warp.scoring.stamps import shifted

        limits = voxel_map.DepthLimits(protocol.min_range, protocol.max_range, protocol.pixel_stride, alignment.scale)
        trajectory = alignment.apply_trajectory(source.trajectory)
        if trajectory.stamps_ns is not None:
            trajectory = replace(trajectory, stamps_ns=shifted(trajectory.stamps_ns, t_offset_s))
        build = voxel_map.build_voxel_map(
            source.frames,
            pose_of_frame(trajectory, source.frames, method=protocol.match, max_gap_s=protocol.stamp_gap),
            grid,
            limits,
            colors="rounded" if with_colors else None,
            device=device,
            progress=progress,
        )
        return SideMap(build.voxels.points, build.voxels, build.counts | {"voxels": len(build.voxels)})


def _why_empty(facts: dict[str, int]) -> str:
    if "frames" not in facts:
        return "the map has no points"
    if facts["frames_without_pose"] == facts["frames"]:
        return f"not one of {facts['frames']} depth frames has a pose at its stamp: see --max-stamp-gap and --t-offset"
    return f"not one of {facts['pixels']} depth samples lies within the protocol's range limits"


def _middle(source: Source) -> NDArray[np.float64] | None:
    """Points that the map lies around, (N, 3) float64; None if there are none."""
    points = None
    if source.cloud is not None:
        points = source.cloud.points
    elif source.trajectory is not None:
        points = source.trajectory.positions
    return points if points is not None and len(points) else None
