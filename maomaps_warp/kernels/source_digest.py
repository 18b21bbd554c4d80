"""A digest of all that kernels are made of, which is known before they are registered with Warp."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import warp as wp

#: What of Warp and its settings changes the code of a kernel on a CPU, beside the options of its module.
SETTINGS = (
    "version",
    "mode",
    "optimization_level",
    "verify_fp",
    "line_directives",
    "enable_vector_component_overwrites",
    "enable_tiles_in_stack_memory",
    "default_grid_stride",
)

_IMPORT = re.compile(r"^ *from maomaps_warp\.kernels\.(\w+) import ", re.MULTILINE)


def source_digest(file: str) -> str:
    """Eight hexadecimal digits for the sources of a file's kernels, and for Warp with its settings."""
    digest = hashlib.sha256(repr([getattr(wp.config, setting) for setting in SETTINGS]).encode())
    for name, source in sorted(sources_of(file).items()):
        digest.update(f"\n{name} {len(source)}\n".encode() + source)
    return digest.hexdigest()[:8]


def sources_of(file: str) -> dict[str, bytes]:
    """A file of this folder and all of the folder's that it imports, by name."""
    sources: dict[str, bytes] = {}
    left = [file]
    while left:
        name = left.pop()
        if name not in sources:
            sources[name] = Path(__file__).with_name(f"{name}.py").read_bytes()
            left += _IMPORT.findall(sources[name].decode())
    return sources
