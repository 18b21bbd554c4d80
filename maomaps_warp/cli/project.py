"""`maomaps-warp project`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from maomaps_warp.cli.options import CameraText, Debug, Device, Format, PoseFrame, Topics, camera_of

VoxelSize = Annotated[float, typer.Option(metavar="M", help="Edge of a voxel, and of a cell.")]
GroundRule = Annotated[
    str,
    typer.Option(
        metavar="RULE",
        help="robust: the lowest level layer, below the cameras if there are poses; original: the fullest layer of the "
        "lower half; or a height in m.",
    ),
]
MapRun = Annotated[str | None, typer.Option(help="Run of a MAOMaps sample directory: first, second, ..., merged.")]


def project(
    source: Annotated[
        Path, typer.Argument(metavar="MAP", help="Cloud, sample directory, or bag or RGB-D folder with depth images.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="NAME", help="Writes NAME.png, NAME.yaml and NAME.pgm.")
    ],
    run: MapRun = None,
    ground: GroundRule = "robust",
    voxel_size: VoxelSize = 0.05,
    trajectory: Annotated[Path | None, typer.Option(metavar="FILE", help="Take the poses from here.")] = None,
    topic: Topics = None,
    format: Format = "auto",
    pose_frame: PoseFrame = "auto",
    camera: CameraText = None,
    device: Device = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the files if they exist.")] = False,
    debug: Debug = False,
) -> None:
    """Project a map on the ground plane: an image, and the pair of files that ROS's map_server reads.

    Occupied: something from 0.1 to 1.5 m above the ground. Free: only ground, within 0.1 m. One pixel is one voxel.
    """
    from maomaps_warp.cli.terminal import check_device_name, console, progress_clock, quiet_warp, user_errors
    from maomaps_warp.io.occupancy_maps import check_projection, write_projection
    from maomaps_warp.io.sources import SourceOptions
    from maomaps_warp.jobs.project import open_map, project_map
    from maomaps_warp.mapping.projection import ground_height

    with user_errors(debug):
        check_device_name(device)
        check_voxel_size(voxel_size)
        ground_height(ground)
        check_projection(output, overwrite=overwrite)
        check_apart(output, (source, trajectory))
        options = SourceOptions(run, tuple(topic or ()), format, pose_frame, camera_of(camera))
        with progress_clock() as clock:
            with clock.stage("read"):
                opened = open_map(source, options, trajectory_path=trajectory)
            check_run(run, (opened.kind,))
            if opened.frames is not None:
                quiet_warp()
            made = project_map(opened, voxel_size, ground, device=device, clock=clock)
            files = write_projection(output, made.grid, overwrite=overwrite)
        out = console()
        rows, columns = made.grid.cells.shape
        counts = made.grid.counts
        found = "" if made.ground.is_found else ", not found"
        size = f"{columns * voxel_size:.6g} x {rows * voxel_size:.6g} m"
        lines = [
            ("map", f"{made.map.name} ({made.map.kind}), {len(made.map.points)} voxels of {voxel_size:g} m"),
            *(("note", note) for note in (*made.map.notes, *made.grid.notes)),
            ("ground", f"{made.ground.z:.3f} m ({made.ground.rule}{found})"),
            ("size", f"{columns} x {rows} cells, {size} from {made.grid.origin[0]:.6g} {made.grid.origin[1]:.6g}"),
            ("cells", ", ".join(f"{counts[kind]} {kind}" for kind in ("free", "occupied", "unknown"))),
            *(("wrote", str(file)) for file in files),
        ]
        for label, text in lines:
            out.print(f"{label:<8} {text}", soft_wrap=True)


def check_voxel_size(voxel_size: float) -> None:
    """Refuse a size that is not above 0.

    Raises:
        InputError: it is 0, negative, or not finite.
    """
    import math

    from maomaps_warp.errors import InputError

    if not (math.isfinite(voxel_size) and voxel_size > 0):
        raise InputError(f"--voxel-size {voxel_size:g}", "must be above 0", "metres")


def check_run(run: str | None, kinds: tuple[str, ...]) -> None:
    """Refuse a run where no side is a sample directory.

    Raises:
        InputError: `run` was given, and of the kinds of all sides none has runs.
    """
    from maomaps_warp.errors import InputError

    if run is not None and not any("sample" in kind for kind in kinds):
        raise InputError(f"--run {run}", "there is no MAOMaps sample directory", "leave it away")


def check_apart(stem: Path, inputs: tuple[Path | None, ...]) -> None:
    """Refuse outputs that would replace an input.

    Raises:
        InputError: one of the files that `stem` stands for is an input.
    """
    from maomaps_warp.errors import InputError
    from maomaps_warp.io.occupancy_maps import projection_files

    taken = {path.resolve() for path in inputs if path is not None}
    for file in projection_files(stem):
        if file.resolve() in taken:
            raise InputError(f"--output {stem}", f"{file} is an input", "choose another name")
