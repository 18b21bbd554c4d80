"""Which device the stages run on, and their kernels on it."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from maomaps_warp.errors import InputError

#: Jobs with kernels of their own: comparing maps, nearest neighbours of free points, making maps from depth images,
#: rendering the demonstration.
Job = Literal["score", "nearest", "map", "render"]


def resolve_device(name: str, *jobs: Job) -> str:
    """Warp's name of the device to use, with the kernels of jobs loaded on it.

    Args:
        name: "auto" (the first CUDA device if there is one, else the CPU), "cpu", "cuda" or "cuda:N".
        jobs: what is to be done there, see `prepare_kernels`.

    Raises:
        InputError: no such device here.
    """
    import warp as wp

    start_warp()
    available = [device.alias for device in wp.get_devices()]
    wanted = name
    if name == "auto":
        wanted = "cuda:0" if wp.is_cuda_available() else "cpu"
    elif name == "cuda":
        wanted = "cuda:0"
    if wanted not in available:
        raise InputError(f"--device {name}", "no such device", f"available: auto, {', '.join(available)}")
    prepare_kernels(wanted, *jobs)
    return wanted


def start_warp() -> None:
    """Start Warp; where its cache cannot be written, what it compiles is kept for this process alone."""
    import warp as wp

    try:
        wp.init()
        usable = os.access(str(wp.config.kernel_cache_dir), os.W_OK)
    except OSError:
        usable = False
    if not usable:
        wp.config.kernel_cache_dir = tempfile.mkdtemp(prefix="maomaps-warp-")
        atexit.register(shutil.rmtree, wp.config.kernel_cache_dir, ignore_errors=True)
        wp.init()


def prepare_kernels(device: str, *jobs: Job) -> None:
    """Load the kernels of jobs: as a release compiled them, from Warp's cache, or by compiling, side by side.

    Stages work without; a module is then compiled when it is launched, and again when another of its files is imported.

    Args:
        device: Warp device. On a GPU the kernels are only imported: which of them run there is known at their launch.
        jobs: each loads its modules of `maomaps_warp.kernels.modules`.
    """
    import warp as wp

    from maomaps_warp.kernels.modules import JOBS, import_functions, import_kernels
    from maomaps_warp.mapping.kernel_objects import load_cached, load_objects

    modules = [module for job in jobs for module in JOBS[job]]
    for module in modules:
        import_kernels(module)
    if device != "cpu":
        for module in modules:
            import_functions(module)
        return
    left = [module for module in modules if not load_objects(module)]
    with _headers_parsed_once():
        missing = [module for module in left if not load_cached(module)]
        for module in missing:
            import_functions(module)
        if missing:
            wp.force_load(device, modules=[wp.get_module(module) for module in missing], max_workers=len(missing))


@contextmanager
def _headers_parsed_once() -> Iterator[None]:
    """Without a precompiled header: making one takes twice as long as parsing, and pays from the third module on."""
    import warp as wp

    before = wp.config.use_precompiled_headers
    wp.config.use_precompiled_headers = False
    try:
        yield
    finally:
        wp.config.use_precompiled_headers = before
