"""`maomaps-warp pack`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from maomaps_warp.cli.options import Debug, Format, PoseFrame, Run


def pack(
    cloud: Annotated[Path, typer.Argument(metavar="CLOUD", help="A cloud, or a sample directory with --run.")],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="BAG", help="NAME.bag (ROS 1), NAME.mcap (ROS 2), or a ROS 2 folder."),
    ],
    topic: Annotated[str, typer.Option(help="Of the PointCloud2.")] = "/map",
    frame_id: Annotated[str, typer.Option(help="Name of the world.")] = "map",
    stamp: Annotated[
        str | None,
        typer.Option(metavar="SECONDS", help="Of all messages.", show_default="the trajectory's last, else 1"),
    ] = None,
    trajectory: Annotated[Path | None, typer.Option(metavar="FILE", help="Poses with stamps: a Path.")] = None,
    path_topic: Annotated[str, typer.Option(help="Of the Path.")] = "/path",
    grid: Annotated[
        Path | None, typer.Option(metavar="YAML", help="Map of the ground (map_server): an OccupancyGrid.")
    ] = None,
    grid_topic: Annotated[str, typer.Option(help="Of the OccupancyGrid.")] = "/grid",
    run: Run = None,
    format: Format = "auto",
    pose_frame: PoseFrame = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a file, or a folder that is a bag.")] = False,
    debug: Debug = False,
) -> None:
    """Write a cloud as a bag, so that RViz and Foxglove show it.

    Points are float32, colours packed as PCL does; poses are those of the camera (z forward). Nothing is latched.
    """
    from maomaps_warp.cli.terminal import console, user_errors
    from maomaps_warp.io.sources import SourceOptions
    from maomaps_warp.io.stamp_order import seconds_text
    from maomaps_warp.jobs import pack as job

    with user_errors(debug):
        options = job.PackOptions(topic, path_topic, grid_topic, frame_id, _stamp_ns(stamp), overwrite)
        source_options = SourceOptions(run=run, format=format, pose_frame=pose_frame)
        packed = job.pack(cloud, output, options, source_options, trajectory=trajectory, grid=grid)
        out = console()
        for note in packed.notes:
            out.print(f"note   {note}", soft_wrap=True)
        for name, message_type, size in packed.contents:
            out.print(f"packed {name}  {message_type}  {size}", soft_wrap=True)
        out.print(f"wrote  {output}  frame {frame_id}, stamp {seconds_text(packed.stamp_ns)} s", soft_wrap=True)


def _stamp_ns(text: str | None) -> int | None:
    """Nanoseconds of `--stamp`, exactly."""
    from decimal import Decimal, InvalidOperation

    from maomaps_warp.errors import InputError

    if text is None:
        return None
    try:
        stamp = Decimal(text)
    except InvalidOperation:
        stamp = Decimal("NaN")
    if not (stamp.is_finite() and 0 < stamp < 2**32):
        raise InputError(f"--stamp {text}", "is no stamp", "seconds above 0, and below 2^32 (ROS 1) or 2^31 (ROS 2)")
    return max(int(stamp.scaleb(9).to_integral_value()), 1)
