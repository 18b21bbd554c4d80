"""The job of `score-2d`: an estimated map of the ground against the ground truth's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from maomaps_warp.errors import InputError
from maomaps_warp.io.occupancy_maps import holds_occupancy, read_occupancy
from maomaps_warp.io.source import Side, Source, SourceOptions, option
from maomaps_warp.jobs.project import SpatialMap, open_map, spatial_map
from maomaps_warp.mapping.projection import Ground, find_ground, ground_height, project
from maomaps_warp.model.occupancy import OccupancyGrid
from maomaps_warp.model.occupancy_results import OccupancyReport
from maomaps_warp.model.results import InputSummary
from maomaps_warp.scoring.occupancy_errors import occupancy_errors
from maomaps_warp.stopwatch import Stopwatch

#: A side as it was opened: a map of the ground, or what a 3D map is made of.
Opened = OccupancyGrid | Source


@dataclass(frozen=True)
class ProjectionRules:
    """How 3D maps are projected.

    Attributes:
        voxel_size: metres.
        ground: "robust", "original", or a height in metres as text.
        device: "auto", "cpu" or "cuda:N".
    """

    voxel_size: float
    ground: str
    device: str


def open_side(path: Path, options: SourceOptions, side: Side, *, trajectory_path: Path | None = None) -> Opened:
    """Open a side: the YAML of a map_server pair, a bag with an OccupancyGrid, or a 3D map.

    A bag that holds both a grid and a 3D map is taken for the grid, unless a topic of the 3D map is named.

    Raises:
        InputError: it is none of these or cannot be read.
    """
    if holds_occupancy(path, options.topics, option(side, "topic")):
        if trajectory_path is not None:
            found = f"{path} is a map of the ground, which needs no poses"
            raise InputError(f"{option(side, 'trajectory')} {trajectory_path}", found, "leave it away")
        return read_occupancy(path, options.topics, option(side, "topic"))
    return open_map(path, options, side, trajectory_path=trajectory_path)


def score_2d(gt: Opened, est: Opened, rules: ProjectionRules, clock: Stopwatch) -> OccupancyReport:
    """Compare two maps of the ground; 3D maps are projected first, both on the ground truth's ground.

    Args:
        gt, est: opened by `open_side`, in one world.
        rules: how 3D maps are projected.
        clock: collects the stages' times.

    Raises:
        InputError: as `project_map`, or the maps lie absurdly far apart.
    """
    ground_height(rules.ground)
    gt_grid, gt_summary, plane = _projected(gt, rules, None, clock)
    est_grid, est_summary, est_plane = _projected(est, rules, plane, clock)
    with clock.stage("score"):
        score = occupancy_errors(est_grid, gt_grid)
    return OccupancyReport(score, gt_summary, est_summary, _described(plane, est_plane), dict(clock.milliseconds))


def _projected(
    side: Opened, rules: ProjectionRules, plane: Ground | None, clock: Stopwatch
) -> tuple[OccupancyGrid, InputSummary, Ground | None]:
    """The map of the ground of a side, and the ground that it was projected on: `plane`, else its own."""
    if isinstance(side, OccupancyGrid):
        return side, _summary(side, side.source, "map of the ground", side.notes), None
    found: SpatialMap = spatial_map(side, rules.voxel_size, device=rules.device, clock=clock)
    with clock.stage("project"):
        own = plane or find_ground(found.points, rules.voxel_size, rules.ground, found.camera_heights)
        grid = project(found.points, rules.voxel_size, own, found.name)
    notes = found.notes + (() if plane is not None else grid.notes)
    return grid, _summary(grid, found.name, f"{found.kind}, projected", notes), own


def _summary(grid: OccupancyGrid, name: str, kind: str, notes: tuple[str, ...]) -> InputSummary:
    rows, columns = grid.cells.shape
    facts: dict[str, float | int | str] = {"columns": columns, "rows": rows, "resolution_m": grid.resolution}
    return InputSummary(name, kind, facts | {k: v for k, v in grid.counts.items() if k != "total"}, notes)


def _described(gt: Ground | None, est: Ground | None) -> str:
    plane, whose = (gt, "ground truth") if gt is not None else (est, "estimate")
    if plane is None:
        return ""
    found = "" if plane.is_found else ", not found"
    return f"{plane.z:.3f} m ({plane.rule}{found}), of the {whose}"
