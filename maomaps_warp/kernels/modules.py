"""Which kernels are compiled together.

Warp compiles whole modules, by default one for each file. Parsing Warp's headers takes longer than all kernels of a job
together, so the kernels of a job share a module, whichever file they are in: `@wp.kernel(module=SCORE)`. What stands
beside them as a reference, or for other devices, stays in its file's own module and is compiled when it is launched.

Warp's hash of a module covers all kernels that are registered in it, so all its files are imported before it is loaded.

Registering takes a millisecond a function, so files with kernels leave their annotations as they are: as texts, which
`from __future__ import annotations` makes of them, Warp would have to evaluate each twice. And the seventy functions
that hang on the two kernels of PACKETS are imported only where these have to be compiled: their module is named by a
digest of its sources, under which Warp finds what was compiled before. `wp.force_load` and `wp.compile_aot_module` of
that module want `import_functions` first.
"""

from __future__ import annotations

import platform
from importlib import import_module

import warp as wp

from maomaps_warp.kernels.source_digest import source_digest

#: Comparing maps, on every device: distance fields and transforms, errors of pairs.
SCORE = "maomaps_warp.score"

#: Association on a CPU, 16 elements at a time. Apart, so that no GPU compiles it; and it takes as long as the others
#: together, while two modules compile side by side. Its name ends with a digest of its sources, in place of Warp's hash
#: (option `strip_hash`), which is made of all that the kernels call, and so wants it registered. The digest does not
#: know of options that are set for the module later: who sets one takes `strip_hash` back.
PACKETS = f"maomaps_warp.packets_{source_digest('association_packets')}"

#: Nearest neighbours of free points on a CPU. Apart, because maps of voxels on one lattice seldom need it.
NEAREST = "maomaps_warp.nearest"

#: Voxel maps from depth images, on a CPU.
MAP = "maomaps_warp.map"

#: Reading large maps, on a CPU. Apart, because files are read before anything else is known to be needed.
TEXT = "maomaps_warp.text"

#: The virtual robot: what its camera sees, and where it fits.
RENDER = "maomaps_warp.render"

#: The files of `maomaps_warp.kernels` with kernels in each module.
FILES: dict[str, tuple[str, ...]] = {
    SCORE: (
        "distance_field_building",
        "distance_transform",
        "lattice",
        "pair_errors",
    ),
    PACKETS: ("association_packets",),
    NEAREST: (
        "nearest_packets",
        "point_cells",
    ),
    MAP: (
        "voxel_bricks",
        "voxel_bricks_export",
    ),
    TEXT: ("text_tables",),
    RENDER: ("render", "robot_space", "triangle_tree"),
}

#: What each job launches on a CPU as a rule; Warp compiles the rest where it is launched after all.
JOBS: dict[str, tuple[str, ...]] = {
    "score": (PACKETS, SCORE, TEXT),
    "nearest": (NEAREST,),
    "map": (MAP,),
    "render": (RENDER,),
}

#: No gradients; no fused multiply-adds, so that vectors, scalars and other machines round alike; and LLVM's own limits,
#: because Warp's lower one for superword vectors halves the speed of kernels on 16 lanes.
#: On x86 LLVM takes half of AVX-512's width of its own accord, for the sake of older processors' clocks.
WIDE_VECTORS = "-mprefer-vector-width=512"
_IS_X86 = platform.machine().lower() in ("x86_64", "amd64")
OPTIONS = {
    "enable_backward": False,
    "fuse_fp": False,
    "block_dim": 1,  # of launches on a CPU, under which objects are looked for; launches on CUDA have their own
    "cpu_compiler_flags": f"-march=native {WIDE_VECTORS}" if _IS_X86 else "-march=native",
}

for _name in FILES:
    wp.set_module_options(OPTIONS, module=_name)

# Loops over lanes are left to LLVM: unrolled by Warp they take several times as long to compile, and run no faster.
for _name in (PACKETS, NEAREST, RENDER):
    wp.set_module_options({"max_unroll": 1}, module=_name)
# What Warp makes of `deterministic` it works out anew when it loads a module, from the functions.
wp.set_module_options({"strip_hash": True, "deterministic": wp.DeterministicMode.NOT_GUARANTEED}, module=PACKETS)


def import_kernels(module: str) -> None:
    """Import every file with kernels in a module of FILES."""
    for file in FILES[module]:
        import_module(f"maomaps_warp.kernels.{file}")


def import_functions(module: str) -> None:
    """Import what the kernels of a module call and their file leaves out, before Warp compiles them."""
    if module == PACKETS:
        import_module("maomaps_warp.kernels.association_packets").import_called_functions()


def is_as_named(module: str) -> bool:
    """Whether a module's sources, and Warp's settings, are still what its name says."""
    return module != PACKETS or module.endswith(source_digest("association_packets"))
