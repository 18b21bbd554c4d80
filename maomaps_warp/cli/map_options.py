"""Options of the commands that make maps of recordings, and the protocol that they add up to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from maomaps_warp.cli.options import camera_of

if TYPE_CHECKING:
    from maomaps_warp.map_protocol import MapProtocol

ProtocolName = Annotated[str, typer.Option(help="maomaps, gt_map_creator, or a .toml file; see `explain`.")]
VoxelSize = Annotated[float | None, typer.Option(metavar="M", help="Edge of a voxel.", show_default="0.05")]
MinRange = Annotated[float | None, typer.Option(metavar="M", help="Nearest depth, exclusive.", show_default="0.01")]
MaxRange = Annotated[float | None, typer.Option(metavar="M", help="Farthest depth, exclusive.", show_default="10")]
Stride = Annotated[
    int | None, typer.Option(metavar="N", help="Every n-th pixel of each row and column.", show_default="1")
]
Ceiling = Annotated[
    str | None,
    typer.Option(metavar="RULE", help="keep, layer (the original's rule), or a height in m.", show_default="keep"),
]
StampGap = Annotated[
    float | None, typer.Option(metavar="S", help="Largest gap between poses around an image.", show_default="0.2")
]
ColorGap = Annotated[
    float | None, typer.Option(metavar="S", help="Largest gap of depth and colours.", show_default="0.02")
]
Colors = Annotated[bool, typer.Option("--colors/--no-colors", help="Colours of the map.")]


def map_protocol_of(name: str, ceiling: str | None, camera: str | None, **given: float | int | None) -> MapProtocol:
    """The protocol of that name with what the options say instead.

    Args:
        name: a preset, or a TOML file.
        ceiling: text of `--ceiling`, or None.
        camera: text of `--camera`, which may be a file, or None.
        given: values of further fields by the name of the option; None where it was not given.

    Raises:
        InputError: naming the option with a value that it cannot take.
    """
    from maomaps_warp.protocol_files import load_map_protocol, with_overrides

    rules = load_map_protocol(name)
    if ceiling is not None:
        rules = with_overrides(rules, _ceiling(ceiling), f"--ceiling {ceiling}")
    options = {"camera": _camera_text(camera), **given}
    said = {option: value for option, value in options.items() if value is not None}
    if not said:
        return rules
    # Together: the two ranges are only right or wrong as a pair.
    fields = {"pixel_stride" if option == "stride" else option: value for option, value in said.items()}
    return with_overrides(rules, fields, ", ".join(f"--{option.replace('_', '-')}" for option in said))


def _ceiling(text: str) -> dict[str, str | float]:
    from maomaps_warp.errors import InputError

    if text in ("keep", "layer"):
        return {"ceiling": text}
    try:
        return {"ceiling": "height", "ceiling_height": float(text)}
    except ValueError:
        raise InputError(f"--ceiling {text}", "is no rule", "keep, layer, or a height in metres") from None


def _camera_text(text: str | None) -> str | None:
    """The camera of `--camera` as a protocol writes it."""
    camera = camera_of(text)
    if camera is None:
        return None
    return f"{camera.width}x{camera.height}:{camera.fx!r},{camera.fy!r},{camera.cx!r},{camera.cy!r}"
