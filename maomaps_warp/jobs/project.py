"""The job of `project`: a 3D map seen from above; and what `score-2d` needs to do the same."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.sample_directories import MERGED, is_sample_directory, read_merged, read_sample, runs_of
from maomaps_warp.io.source import Side, Source, SourceOptions, option
from maomaps_warp.io.sources import AS_IT_COMES, open_source
from maomaps_warp.map_protocol import MAP_PRESETS
from maomaps_warp.mapping.projection import Ground, find_ground, project
from maomaps_warp.model.occupancy import OccupancyGrid
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.stopwatch import Stopwatch


@dataclass(frozen=True, eq=False)
class SpatialMap:
    """A 3D map on the lattice of multiples of the voxel size.

    Attributes:
        name, kind: what the user gave, and what it was recognised as.
        points: (N, 3) float64, metres, world with z up: voxel centres; N >= 1.
        camera_heights: (M,) float64, metres, of the cameras that saw it; None if they are not known.
        notes: what was decided or left out, one short sentence each.
    """

    name: str
    kind: str
    points: NDArray[np.float64]
    camera_heights: NDArray[np.float64] | None
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Projection:
    """A projected map.

    Attributes:
        map: what was projected.
        ground: on which height.
        grid: the result.
    """

    map: SpatialMap
    ground: Ground
    grid: OccupancyGrid


def open_map(
    path: Path, options: SourceOptions = AS_IT_COMES, side: Side = "one", *, trajectory_path: Path | None = None
) -> Source:
    """Open a map: a cloud, a sample directory, or depth images with poses.

    Args:
        path: any source of a map; of a sample directory the run "merged" is the map of all runs, with the poses of all
            runs that have some.
        options: how to read it.
        side: whose it is, to name the options in errors.
        trajectory_path: take the poses from here.

    Raises:
        InputError: it cannot be read, holds no map, or a run was named where there is none.
    """
    if options.run == MERGED and is_sample_directory(path):
        return _merged(path)
    source = open_source(path, options, side, trajectory_path=trajectory_path)
    if source.cloud is None and source.frames is None:
        found = f"holds no map (it was read as: {source.kind})"
        raise InputError(path, found, f"a map is points or depth images; see {option(side, 'format')}")
    return source


def spatial_map(source: Source, voxel_size: float, *, device: str, clock: Stopwatch) -> SpatialMap:
    """The voxels of a source: of its cloud, or of its depth images, which are mapped as by `map`.

    Args:
        source: opened by `open_map`.
        voxel_size: metres.
        device: "auto", "cpu" or "cuda:N"; clouds need none.
        clock: collects the stages' times.

    Raises:
        InputError: points beyond the reach of the lattice, an empty map, or as `build_ground_truth`.
    """
    if source.cloud is None:
        from maomaps_warp.jobs.ground_truth import build_ground_truth

        rules = replace(MAP_PRESETS["maomaps"], voxel_size=voxel_size)
        truth = build_ground_truth(source, rules, device=device, clock=clock, with_colors=False)
        heights = truth.trajectory.positions[:, 2]
        return SpatialMap(source.name, source.kind, truth.voxels.points, heights, truth.notes)
    from maomaps_warp.mapping.cloud_map import check_extent, voxelise

    points = source.cloud.points
    if not len(points):
        raise InputError(source.name, "the map has no points")
    with clock.stage("voxelise"):
        grid = VoxelGrid.around(points, voxel_size)
        check_extent(points, grid, source.name)
        centers = voxelise(points, grid).points
    camera_heights, notes = _camera_heights(source)
    return SpatialMap(source.name, source.kind, centers, camera_heights, source.notes + notes)


def project_map(source: Source, voxel_size: float, ground: str, *, device: str, clock: Stopwatch) -> Projection:
    """Project the map of a source.

    Args:
        source: opened by `open_map`.
        voxel_size: metres; one cell of the grid is one voxel.
        ground: "robust", "original", or a height in metres as text; see `find_ground`.
        device: as in `spatial_map`.
        clock: collects the stages' times.

    Raises:
        InputError: `ground` is no rule, or as `spatial_map`, or the map is too wide for an image.
    """
    found = spatial_map(source, voxel_size, device=device, clock=clock)
    with clock.stage("project"):
        plane = find_ground(found.points, voxel_size, ground, found.camera_heights)
        return Projection(found, plane, project(found.points, voxel_size, plane, found.name))


def _camera_heights(source: Source) -> tuple[NDArray[np.float64] | None, tuple[str, ...]]:
    """Heights of the cameras, if they are known to be in the world of the cloud."""
    if source.trajectory is None or source.cloud is None:
        return None, ()
    worlds = source.cloud.frame_id, source.trajectory.frame_id
    if all(worlds) and worlds[0].strip("/") != worlds[1].strip("/"):
        note = f"the poses are in the frame {worlds[1]!r}, the cloud in {worlds[0]!r}: their heights are not used"
        return None, (note,)
    return source.trajectory.positions[:, 2], ()


def _merged(folder: Path) -> Source:
    cloud = read_merged(folder)
    poses: list[NDArray[np.float64]] = []
    notes = cloud.notes
    for run in runs_of(folder):
        try:
            trajectory = read_sample(folder, run, part="trajectory").trajectory
        except InputError as error:
            notes += (f"cameras of the run {run} not used: {error.found}",)
            continue
        assert trajectory is not None, "a trajectory was asked for"
        poses.append(trajectory.T_world_camera)
    cameras = Trajectory(np.concatenate(poses), source=f"{folder}, all runs") if poses else None
    return Source(str(folder), "MAOMaps sample directory, merged map", cameras, cloud, notes=notes)
