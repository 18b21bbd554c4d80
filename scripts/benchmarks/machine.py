"""What it was measured on and with, without dates or names of hosts."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path

PACKAGES = ("maomaps-warp", "warp-lang", "numpy", "scipy", "numba", "open3d", "open3d-cpu", "embreex", "pykdtree")


def machine() -> dict[str, str]:
    """Processor, cores, system, widest vectors."""
    facts = {"processor": platform.processor() or platform.machine(), "cores": str(os.cpu_count())}
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() == "model name":
            facts["processor"] = value.strip()
        if name.strip() == "flags":
            flags = set(value.split())
            widest = "AVX-512" if "avx512f" in flags else "AVX2" if "avx2" in flags else "narrower than AVX2"
            facts["vectors"] = widest
    return facts | {"system": f"{platform.system()} {platform.machine()}"}


def gpu(device: str) -> dict[str, str]:
    """The name of a Warp device that is no CPU."""
    if device == "cpu":
        return {}
    import warp as wp

    return {"gpu": wp.get_device(device).name}


def versions() -> dict[str, str]:
    """Of Python and the packages that are there."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found
