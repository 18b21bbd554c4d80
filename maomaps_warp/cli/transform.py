"""`maomaps-warp transform`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from maomaps_warp.cli.options import Debug, Format, PoseFrame, YawCorrection, yaw_of


def transform(
    path: Annotated[Path, typer.Argument(metavar="INPUT", help="A cloud or a trajectory, recognised by its content.")],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Clouds: .pcd, .ply, .txt, .xyz or .npz; trajectories: any .txt."
        ),
    ],
    start_pose: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="MAOMaps start pose: turn about z by its yaw + pi, then add its position."),
    ] = None,
    yaw_correction: YawCorrection = None,
    matrix: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A rigid 4x4 (or 3x3 of the plane, or a line x y yaw).")
    ] = None,
    tum: Annotated[str | None, typer.Option(metavar="LINE", help='"t x y z qx qy qz qw"; t is not used.')] = None,
    inverse: Annotated[bool, typer.Option("--inverse", help="Take the move back, its scale too.")] = False,
    scale: Annotated[float, typer.Option(metavar="S", help="p becomes S R p + t.")] = 1.0,
    to: Annotated[
        Literal["tum", "maomaps"] | None,
        typer.Option(help="Write a trajectory as this.", show_default="as the input, or tum"),
    ] = None,
    format: Format = "auto",
    pose_frame: PoseFrame = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output if it exists.")] = False,
    debug: Debug = False,
) -> None:
    """Move a cloud or a trajectory by one of --start-pose, --matrix and --tum.

    Colours and stamps stay. TUM is written as poses of the camera (z forward), MAOMaps as those of the body.
    """
    from maomaps_warp.cli.terminal import console, user_errors
    from maomaps_warp.jobs import transform as job

    with user_errors(debug):
        move = job.read_move(
            start_pose=start_pose,
            yaw_correction=yaw_of(yaw_correction),
            matrix=matrix,
            tum=tum,
            scale=scale,
            inverse=inverse,
        )
        moved = job.transform(path, output, move, format=format, pose_frame=pose_frame, to=to, overwrite=overwrite)
        out = console()
        for note in moved.notes:
            out.print(f"note   {note}", soft_wrap=True)
        out.print(f"moved  {moved.count} {moved.unit} of {path} ({moved.kind}) by", soft_wrap=True)
        for row in move.T_gt_est.tolist():
            out.print("       " + " ".join(f"{value:>14.9f}" for value in row))
        if move.scale != 1.0:
            out.print(f"       with scale {move.scale:.9g}: scale * R p + t")
        for file in moved.written:
            out.print(f"wrote  {file}", soft_wrap=True)
