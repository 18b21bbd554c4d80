"""Compile the kernels ahead, for a release: `python scripts/build_kernels.py [FOLDER]`.

Warp compiles kernels on the user's machine when they are first used, which takes seconds. A wheel that carries them as
object files loads them in milliseconds. They are no part of the repository; a release makes them so:

1. On an x86-64 Linux machine with AVX-512 (it makes the objects for machines without, too) run this script, in an
   environment with the version of Warp that the wheel is to be used with.
2. On an aarch64 Linux machine do the same; Warp's compiler makes code for its own processor family only. Copy what lies
   below FOLDER/<Warp version>/ to the first machine, and run the script there again: it completes the manifest.
3. `python -m build --wheel`. The wheel takes the objects along if they are there, and remains one for every platform.

Objects of other Warp versions may lie side by side. On machines, and with Warp versions, that no object fits, Warp
compiles as usual; see `maomaps_warp/mapping/kernel_objects.py` for what is checked.
"""

from __future__ import annotations

import sys
from pathlib import Path

import warp as wp

from maomaps_warp.kernels.modules import FILES, import_functions, import_kernels
from maomaps_warp.mapping.kernel_objects import SHIPPED, build_objects


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else SHIPPED
    wp.config.log_level = wp.LOG_ERROR
    wp.init()
    for module in FILES:
        import_kernels(module)
        import_functions(module)
    for path in build_objects(list(FILES), folder):
        print(f"{path.stat().st_size:8d} bytes  {path}")


if __name__ == "__main__":
    main()
