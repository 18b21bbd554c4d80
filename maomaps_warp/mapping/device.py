"""Which device the stages run on."""

from __future__ import annotations

from maomaps_warp.errors import InputError


def resolve_device(name: str) -> str:
    """Warp's name of the device to use.

    Args:
        name: "auto" (the first CUDA device if there is one, else the CPU), "cpu", "cuda" or "cuda:N".

    Raises:
        InputError: no such device here.
    """
    import warp as wp

    wp.init()
    if name == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    available = [device.alias for device in wp.get_devices()]
    wanted = "cuda:0" if name == "cuda" else name
    if wanted not in available:
        raise InputError(f"--device {name}", "no such device", f"available: auto, {', '.join(available)}")
    return wanted
