"""A sample of a dataset out of the recordings of its runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from maomaps_warp.errors import InputError
from maomaps_warp.io.sample_writing import SamplePlace, SampleRun, check_sample_writable, heading_notes, write_sample
from maomaps_warp.io.sources import Source
from maomaps_warp.jobs.describe import RunData, sample_figures
from maomaps_warp.jobs.ground_truth import GroundTruth, build_ground_truth
from maomaps_warp.map_protocol import MapProtocol
from maomaps_warp.mapping.merging import merge_maps
from maomaps_warp.mapping.projection import ground_height
from maomaps_warp.model.dataset import SampleFigures
from maomaps_warp.stopwatch import Stopwatch


@dataclass(frozen=True, eq=False)
class MadeSample:
    """A sample that was made.

    Attributes:
        files: what was written.
        figures: its row of the paper's Table II.
        counts: of each run, what became of its frames and samples.
        notes: of each run, what was decided or left out.
    """

    files: tuple[Path, ...]
    figures: SampleFigures
    counts: Mapping[str, dict[str, int]]
    notes: Mapping[str, tuple[str, ...]]


def make_sample(
    place: SamplePlace,
    sources: Mapping[str, Source],
    protocol: MapProtocol,
    *,
    ground: str = "robust",
    with_colors: bool = True,
    device: str = "cpu",
    clock: Stopwatch | None = None,
) -> MadeSample:
    """Map every run, merge the maps, and write the sample directory: complete, or not at all.

    Args:
        place: where, and what becomes of the recordings.
        sources: the recordings, by name of run, all in one world; two or more.
        protocol: how each is mapped.
        ground: how the ground of the projections is found; see `find_ground`.
        with_colors: colour the maps; depth images without colours are then left out.
        device: Warp device.
        clock: collects the stages' times.

    Raises:
        InputError: a recording cannot be mapped, or the directory cannot be written.
    """
    clock = clock or Stopwatch()
    ground_height(ground)
    check_sample_writable(place)
    built: dict[str, GroundTruth] = {}
    for run, source in sources.items():
        built[run] = build_ground_truth(source, protocol, device=device, clock=clock, with_colors=with_colors)
    _check_one_convention(sources, built)
    with clock.stage("merge"):
        merged = merge_maps([truth.voxels for truth in built.values()], color_mean=protocol.color_mean)
        runs = [RunData(run, truth.voxels.points, truth.trajectory) for run, truth in built.items()]
        name = place.folder.resolve().name
        figures = sample_figures(name, runs, merged.points, protocol.voxel_size, ground)
    with clock.stage("write sample"):
        written = {run: SampleRun(truth.voxels, truth.trajectory) for run, truth in built.items()}
        files = write_sample(place, written, merged)
    return MadeSample(
        files,
        figures,
        {run: truth.counts for run, truth in built.items()},
        {run: (*truth.notes, *heading_notes(truth.trajectory)) for run, truth in built.items()},
    )


def _check_one_convention(sources: Mapping[str, Source], built: Mapping[str, GroundTruth]) -> None:
    """Refuse runs of which one was proved to mean something else than another: one recorder made them."""
    proved = {run: built[run].trajectory.pose_frame for run, source in sources.items() if _is_assumed(source)}
    if len(set(proved.values())) > 1:
        found = ", ".join(f"{run}: {name}" for run, name in proved.items())
        places = " and ".join(sources[run].name for run in proved)
        raise InputError(places, f"the poses of the runs mean different things ({found})", "declare it by --pose-frame")


def _is_assumed(source: Source) -> bool:
    return source.trajectory is not None and source.trajectory.is_assumed
