"""`maomaps-warp merge`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from maomaps_warp.cli.options import Debug, JsonFile, YawCorrection, yaw_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from maomaps_warp.jobs.merge import MergedSource

TRANSFORMS, MERGED = "transforms.txt", "merged.pcd"


def merge(
    method: Annotated[
        Literal["start-poses", "correlation-2d", "registration-3d"],
        typer.Option(
            help="start-poses: as the runs began. correlation-2d: projections, by every yaw and shift. "
            "registration-3d: features and ICP; needs pip install 'maomaps-warp[merge]'."
        ),
    ],
    source: Annotated[
        list[Path], typer.Option(metavar="FILE", help="A map in its own frame, z up; the first stays; repeatable.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help=f"Writes {TRANSFORMS} and {MERGED} into it.")
    ],
    sample: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Start poses of the runs, for --method start-poses.")
    ] = None,
    yaw_correction: YawCorrection = None,
    voxel_size: Annotated[
        float, typer.Option(metavar="M", help="Edge of the voxels that maps are compared in.")
    ] = 0.05,
    json_file: JsonFile = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the files if they exist.")] = False,
    debug: Debug = False,
) -> None:
    """Merge maps by a baseline, to have something to compare with; score the outcome with score-merge.

    A map that finds no place gets a matrix of zeros. Exit code 3: none found one; then there is no merged map.
    """
    from maomaps_warp.cli.project import check_voxel_size
    from maomaps_warp.cli.terminal import progress_clock, user_errors
    from maomaps_warp.io.file_sets import check_file_set

    with user_errors(debug):
        check_voxel_size(voxel_size)
        yaw = yaw_of(yaw_correction)
        check_file_set(output, (TRANSFORMS, MERGED), overwrite=overwrite)
        _check_apart(output, json_file, source)
        from maomaps_warp.jobs import merge as job

        with progress_clock() as clock:
            with clock.stage("read"):
                clouds, starts = job.read_sources(source, method, sample, yaw)
            merged = job.merge(clouds, method, voxel_size=voxel_size, T_world_source=starts, clock=clock)
            notes = _write(output, merged, overwrite=overwrite)
        _report(merged, notes, method, voxel_size, json_file, output)


def _check_apart(output: Path, json_file: Path | None, sources: Sequence[Path]) -> None:
    """Refuse outputs that would replace a source or one another, and a document that cannot be written."""
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.outputs import check_writable

    taken = {path.resolve(): "is an input" for path in sources}
    for name in (TRANSFORMS, MERGED):
        if (output / name).resolve() in taken:
            raise InputError(output / name, "is an input", "choose another --output")
        taken[(output / name).resolve()] = "is an output of its own"
    if json_file is None:
        return
    if json_file.resolve() in taken:
        raise InputError(f"--json {json_file}", taken[json_file.resolve()], "give it a file of its own")
    if json_file.parent.resolve() != output.resolve() or output.exists():
        check_writable(json_file)  # else the folder comes into being with the other files


def _write(output: Path, merged: Sequence[MergedSource], *, overwrite: bool) -> tuple[str, ...]:
    from maomaps_warp.io.cloud_writing import write_cloud
    from maomaps_warp.io.file_sets import write_file_set
    from maomaps_warp.io.transforms import write_transforms
    from maomaps_warp.jobs.merge import union

    notes: tuple[str, ...] = ()
    with write_file_set(output, (TRANSFORMS, MERGED), overwrite=overwrite) as folder:
        write_transforms(folder / TRANSFORMS, [source.placement.T_merged_source for source in merged])
        if _is_any_merged(merged):
            points, colors, notes = union(merged)
            write_cloud(folder / MERGED, points, colors)
    return notes


def _report(
    merged: Sequence[MergedSource],
    notes: tuple[str, ...],
    method: str,
    voxel_size: float,
    json_file: Path | None,
    output: Path,
) -> None:
    """Write the document, then print; exit 3 if nothing was merged."""
    from maomaps_warp.cli.terminal import EXIT_NO_SCORE, complain, console
    from maomaps_warp.io.outputs import write_whole
    from maomaps_warp.report.merging import merging_document, merging_table

    names = [source.cloud.source for source in merged]
    placements, seconds = [source.placement for source in merged], [source.seconds for source in merged]
    if json_file is not None:
        document = merging_document(method, voxel_size, names, placements, seconds)
        with write_whole(json_file) as file:
            file.write(json.dumps(document, indent=2, allow_nan=False) + "\n")
    out = console()
    out.print(f"{method}, voxels of {voxel_size:g} m; poses of the sources in the merged map, the first source's frame")
    out.print(merging_table(names, placements, seconds))
    unplaced = [f"{name} was not merged: {p.reason}" for name, p in zip(names, placements, strict=True) if p.reason]
    for note in (*(note for source in merged for note in source.cloud.notes), *notes, *unplaced):
        out.print(f"note   {note}", soft_wrap=True)
    for name in (TRANSFORMS, MERGED) if _is_any_merged(merged) else (TRANSFORMS,):
        out.print(f"wrote  {output / name}", soft_wrap=True)
    if not _is_any_merged(merged):
        complain("nothing could be merged: " + "; ".join(unplaced))
        raise typer.Exit(EXIT_NO_SCORE)


def _is_any_merged(merged: Sequence[MergedSource]) -> bool:
    return any(source.placement.T_merged_source is not None for source in merged[1:])
