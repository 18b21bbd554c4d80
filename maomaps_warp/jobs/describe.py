"""The figures of a dataset's samples: the paper's Table II."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.sample_directories import RUN_NAMES, read_merged, read_sample, runs_of, sample_directories
from maomaps_warp.io.source import Part, Source
from maomaps_warp.mapping.cloud_map import check_extent, lattice_of
from maomaps_warp.mapping.projection import find_ground, ground_height, project
from maomaps_warp.model.dataset import DatasetFigures, OverlapFigures, RunFigures, SampleFigures
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.scoring.overlap import map_overlap
from maomaps_warp.stopwatch import Stopwatch


@dataclass(frozen=True, eq=False)
class RunData:
    """One run of a sample.

    Attributes:
        name: "first", "second", ...
        points: (N, 3) float64, metres: voxel centres of its map; None if there is none.
        trajectory: None if there is none.
    """

    name: str
    points: NDArray[np.float64] | None
    trajectory: Trajectory | None


def describe_dataset(folder: Path, *, voxel_size: float, ground: str, clock: Stopwatch) -> DatasetFigures:
    """Figures of every sample directory in a folder, or of the one that the folder is.

    Args:
        folder: the dataset.
        voxel_size: of its maps, metres.
        ground: "robust", "original", or a height in metres as text; see `find_ground`.
        clock: collects the time, and progress by samples.

    Raises:
        InputError: the folder cannot be read or holds no sample directory; `ground` is no rule. What is wrong with
            single samples stands in their rows.
    """
    ground_height(ground)
    folders, others = sample_directories(folder)
    if not folders:
        hint = "give a folder of sample directories, or one of them; `sample` and `map` make some"
        raise InputError(folder, "holds no sample directory of the MAOMaps layout", hint)
    rows = []
    with clock.stage("describe") as progress:
        for number, entry in enumerate(folders, 1):
            rows.append(_describe_sample(entry, voxel_size, ground))
            progress(number, len(folders))
    names = ", ".join(entry.name for entry in others)
    notes = (f"no sample directories: {names}",) if others else ()
    return DatasetFigures(str(folder), tuple(rows), voxel_size, ground, notes)


def sample_figures(
    name: str,
    runs: Sequence[RunData],
    merged: NDArray[np.float64] | None,
    voxel_size: float,
    ground: str,
) -> SampleFigures:
    """Figures of one sample; what is None is left out of them.

    The ground is that of the merged map below the cameras of all runs, so that all projections are on one plane.

    Args:
        name: of the sample.
        runs: in order.
        merged: (N, 3) float64, metres: voxel centres of the merged map.
        voxel_size: metres.
        ground: see `describe_dataset`.

    Raises:
        InputError: a map is too wide to be projected.
    """
    figures = tuple(_run_figures(run) for run in runs)
    if merged is None:
        return SampleFigures(name, figures)
    heights = [run.trajectory.positions[:, 2] for run in runs if run.trajectory is not None]
    plane = find_ground(merged, voxel_size, ground, np.concatenate(heights) if heights else None)
    rows, columns = project(merged, voxel_size, plane, name).cells.shape
    maps = [run.points for run in runs if run.points is not None]
    notes = [plane.note] if plane.note else []
    overlap = None
    if len(maps) == len(runs) >= 2:
        overlap = map_overlap(maps, voxel_size, plane)
        notes += _overlap_notes(overlap, len(merged))
    return SampleFigures(name, figures, overlap, len(merged), (columns, rows), plane.z, notes=tuple(notes))


def _run_figures(run: RunData) -> RunFigures:
    elements = None if run.points is None else len(run.points)
    if run.trajectory is None:
        return RunFigures(run.name, elements=elements)
    path = run.trajectory
    return RunFigures(run.name, path.path_length, path.duration_s, len(path), elements)


def _overlap_notes(overlap: OverlapFigures, elements: int) -> list[str]:
    notes = []
    if not overlap.counts["voxel_common"]:
        notes.append("the maps of the runs do not overlap: not one voxel is in two of them")
    if overlap.counts["voxel_any"] != elements:
        union = overlap.counts["voxel_any"]
        notes.append(f"the merged map holds {elements} elements, the maps of the runs together {union} voxels")
    return notes


def _describe_sample(folder: Path, voxel_size: float, ground: str) -> SampleFigures:
    name = folder.resolve().name
    problems: list[str] = []
    present = runs_of(folder)
    runs = [_read_run(folder, run, problems) for run in RUN_NAMES if run in present or run in RUN_NAMES[:2]]
    merged = None
    try:
        merged = read_merged(folder).points
    except InputError as error:
        problems.append(_problem(error, folder))
    clouds = {run.name: run.points for run in runs} | {"merged": merged}
    notes: list[str] = []
    try:
        notes = _lattice_notes(clouds, voxel_size)
        figures = sample_figures(name, runs, merged, voxel_size, ground)
    except InputError as error:
        problems.append(_problem(error, folder))
        figures = SampleFigures(name, tuple(_run_figures(run) for run in runs))
    return replace(figures, problems=tuple(dict.fromkeys(problems)), notes=(*notes, *figures.notes))


def _read_run(folder: Path, run: str, problems: list[str]) -> RunData:
    """What can be had of a run; what stands against the rest is appended to `problems`."""
    parts: tuple[Part, ...] = ("all", "map", "trajectory")
    found: dict[Part, Source] = {}
    for part in parts:
        try:
            found[part] = read_sample(folder, run, part=part)
        except InputError as error:
            # What is missing for "all" is missing for its parts too.
            if part == "all" or not error.found.startswith("missing"):
                problems.append(_problem(error, folder))
        if "all" in found:
            break
    clouds = [source.cloud for source in found.values() if source.cloud is not None]
    paths = [source.trajectory for source in found.values() if source.trajectory is not None]
    return RunData(run, clouds[0].points if clouds else None, paths[0] if paths else None)


def _problem(error: InputError, folder: Path) -> str:
    """What is wrong, with the file's name if it is about one."""
    where = error.where.removeprefix(str(folder)).lstrip("/\\")
    return f"{where}: {error.found}" if where else error.found


def _lattice_notes(clouds: dict[str, NDArray[np.float64] | None], voxel_size: float) -> list[str]:
    """Whether the points of the maps are the centres of voxels of this size.

    Raises:
        InputError: points too far from the others for an index.
    """
    present = {name: points for name, points in clouds.items() if points is not None}
    if not present:
        return []
    grid = VoxelGrid.around(np.concatenate(list(present.values())), voxel_size)
    notes = []
    for name, points in present.items():
        check_extent(points, grid, f"map {name}")
        off, stride = lattice_of(points, voxel_size)
        if off:
            notes.append(f"map {name}: {off} points are no multiples of {voxel_size:g} m and were rounded")
        elif stride > 1:
            notes.append(f"map {name}: its points lie {stride * voxel_size:g} m apart: is that the --voxel-size?")
    return notes
