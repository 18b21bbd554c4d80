"""Kernels compiled ahead: object files that a release carries, so that nothing is compiled on a user's machine for
the usual jobs; kernels of maps too large for a dense field, and the references, still are.

`kernels/compiled/<Warp version>/` holds a folder for each kind of processor, with the objects as Warp names them, and
`manifest.json` with the SHA-256 of every file. `scripts/build_kernels.py` makes them; the repository holds none.

An object is used only if all of this fits, else Warp compiles as usual: the version of Warp; the processor's features;
the digest of each file of its folder; and the name, which Warp derives from its hash of the kernels' source, constants
and options (in one module ours of the source files, see `modules`), and from the version and target of its LLVM.
"""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import maomaps_warp

#: Where the objects lie in an installed package.
SHIPPED = Path(maomaps_warp.__file__).parent / "kernels" / "compiled"

_MANIFEST = "manifest.json"
_CPU_INFO = Path("/proc/cpuinfo")


@dataclass(frozen=True)
class Target:
    """A kind of processor that objects are made for, on Linux.

    Attributes:
        name: of its folder.
        machine: as `platform.machine` says it.
        flags: Warp's `cpu_compiler_flags`.
        features: what the processor must have, as `/proc/cpuinfo` names it.
    """

    name: str
    machine: str
    flags: str
    features: frozenset[str]


_V3 = frozenset({"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe", "xsave"})
_V4 = _V3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}

#: Best first; the levels are those of the x86-64 psABI.
TARGETS = (
    Target("x86-64-v4", "x86_64", "-target-cpu x86-64-v4 -mprefer-vector-width=512", _V4),
    Target("x86-64-v3", "x86_64", "-target-cpu x86-64-v3", _V3),
    Target("aarch64", "aarch64", "", frozenset()),
)


def fitting_targets() -> list[Target]:
    """The targets whose objects run on this machine, best first."""
    if sys.platform != "linux":
        return []
    features = _processor_features()
    return [t for t in TARGETS if t.machine == platform.machine() and t.features <= features]


def load_objects(module: str, folder: Path | None = None) -> bool:
    """Load a kernel module on the CPU from an object compiled ahead; False, with the module as it was, if none fits.

    Args:
        module: name of a Warp module; all its kernels are registered.
        folder: with a folder for each version of Warp; None: that of the installed package.
    """
    import warp as wp

    versioned = (folder or SHIPPED) / wp.config.version
    if not versioned.is_dir():
        return False
    flags = wp.get_module_options(module)["cpu_compiler_flags"]
    for target in fitting_targets():
        if flags == target.flags:
            return True  # loaded before
        if not _is_intact(versioned, target):
            continue
        wp.set_module_options({"cpu_compiler_flags": target.flags}, module=module)
        if _load(module, versioned / target.name):
            return True
        # Of other kernels, or for another LLVM.
        wp.set_module_options({"cpu_compiler_flags": flags}, module=module)
    return False


def load_cached(module: str) -> bool:
    """Load a kernel module on the CPU from Warp's cache; False if it is not there.

    To be asked on one thread before modules are compiled on several: whoever asks first finds out for Warp which
    compiler and processor this is. Threads that ask side by side may read half of the answer (seen with 1.19), look for
    another file than the cached one, and compile again.
    """
    return _load(module, None)


def _load(module: str, folder: Path | None) -> bool:
    import warp as wp

    from maomaps_warp.kernels.modules import is_as_named

    if not is_as_named(module):
        return False
    try:
        wp.load_aot_module(module, device="cpu", module_dir=folder)
        return True
    except FileNotFoundError:
        return False


def build_objects(modules: Sequence[str], folder: Path) -> list[Path]:
    """Compile modules for every target that this machine can check, below `folder`, beside those of other machines.

    Raises:
        RuntimeError: this machine fits no target.
    """
    import warp as wp

    targets = fitting_targets()
    if not targets:
        raise RuntimeError(f"no target for {sys.platform} on {platform.machine()} with this processor")
    versioned = folder / wp.config.version
    built: list[Path] = []
    for target in targets:
        place = versioned / target.name
        for old in place.glob("*"):
            old.unlink()
        for module in modules:
            flags = wp.get_module_options(module)["cpu_compiler_flags"]
            wp.set_module_options({"cpu_compiler_flags": target.flags}, module=module)
            built += wp.compile_aot_module(module, device="cpu", module_dir=place)
            wp.set_module_options({"cpu_compiler_flags": flags}, module=module)
        for source in place.glob("*.cpp"):
            source.unlink()
    digests = {file.relative_to(versioned).as_posix(): _digest(file) for file in sorted(versioned.glob("*/*"))}
    (versioned / _MANIFEST).write_text(json.dumps(digests, indent=1) + "\n", encoding="utf-8")
    return built


def _is_intact(versioned: Path, target: Target) -> bool:
    """Whether a target's folder holds exactly the files of the manifest."""
    try:
        manifest = json.loads((versioned / _MANIFEST).read_text(encoding="utf-8"))
        expected = {name: digest for name, digest in manifest.items() if name.startswith(f"{target.name}/")}
        files = sorted((versioned / target.name).glob("*"))
        return bool(expected) and {f.relative_to(versioned).as_posix(): _digest(f) for f in files} == expected
    except (OSError, ValueError, AttributeError):
        return False


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _processor_features() -> frozenset[str]:
    try:
        lines = _CPU_INFO.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return frozenset()
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() == "flags":
            return frozenset(value.split())
    return frozenset()
