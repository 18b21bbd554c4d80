"""The rooms of the house: imports point down, and heavy packages load where they are used."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import maomaps_warp

ROOT = Path(maomaps_warp.__file__).parent

#: What each room may import of ours; `docs/design.md` draws it.
ALLOWED = {
    "errors": set(),
    "protocol": {"model"},
    "protocol_files": {"protocol", "map_protocol", "errors"},
    "stopwatch": set(),
    "threads": {"errors"},
    "model": {"errors", "protocol"},
    "kernels": set(),
    "io": {"kernels", "model", "protocol", "errors", "threads"},
    "report": {"model", "protocol", "map_protocol", "errors"},
    "mapping": {"kernels", "model", "protocol", "errors", "threads"},
    "scoring": {"mapping", "kernels", "model", "protocol", "errors", "threads"},
    "sim": {"kernels", "io", "model", "protocol", "errors", "threads"},
    "pipeline": {
        "map_building",
        "io",
        "mapping",
        "scoring",
        "sim",
        "report",
        "model",
        "protocol",
        "errors",
        "stopwatch",
    },
    "checking": {"scoring", "model", "protocol", "errors"},
    "merging": {"mapping", "kernels", "model", "protocol", "errors"},
    "map_protocol": {"protocol", "model"},
    "map_building": {"io", "mapping", "scoring", "model", "protocol", "errors", "stopwatch"},
    "jobs": {
        "map_building",
        "map_protocol",
        "checking",
        "io",
        "mapping",
        "merging",
        "scoring",
        "sim",
        "model",
        "protocol",
        "errors",
        "stopwatch",
    },
    "cli": {
        "pipeline",
        "jobs",
        "protocol_files",
        "map_protocol",
        "io",
        "mapping",
        "report",
        "model",
        "protocol",
        "errors",
        "stopwatch",
    },
    "__init__": {"pipeline", "protocol_files", "io", "report", "model", "protocol", "errors"},
    "__main__": {"cli"},
}

#: Packages that only the named rooms may import, and only inside functions (kernels apart).
THIRD_PARTY_ROOMS = {"warp": {"kernels", "mapping", "scoring", "merging", "sim", "cli", "io"}}
ALWAYS_LAZY = {"warp", "scipy", "rosbags", "mcap", "PIL", "trimesh", "ruamel", "rich", "small_gicp", "viser"}


def _modules():
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        yield parts[0], path, ast.parse(path.read_text(encoding="utf-8"))


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, "relative imports hide where they point to"
        if node.module == "maomaps_warp":
            return [f"maomaps_warp.{alias.name}" for alias in node.names]
        return [node.module or ""]
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return []


def test_imports_point_down():
    wrong = []
    for room, path, tree in _modules():
        for node in ast.walk(tree):
            for name in _imported(node):
                if name.split(".")[0] == "maomaps_warp" and "." in name:
                    target = name.split(".")[1]
                    if target != room and target not in ALLOWED[room]:
                        wrong.append(f"{path.relative_to(ROOT)} imports {name}")
    assert not wrong, "\n".join(wrong)


def test_heavy_packages_are_imported_where_they_are_used():
    wrong = []
    for room, path, tree in _modules():
        top = [n for n in tree.body if isinstance(n, ast.Import | ast.ImportFrom)]
        for node in ast.walk(tree):
            for name in _imported(node):
                package = name.split(".")[0]
                if room not in THIRD_PARTY_ROOMS.get(package, {room}):
                    wrong.append(f"{path.relative_to(ROOT)}: {room} may not import {package}")
                if node in top and package in ALWAYS_LAZY and room != "kernels":
                    wrong.append(f"{path.relative_to(ROOT)} imports {package} at the top")
    assert not wrong, "\n".join(wrong)


def test_one_reader_alone_knows_the_kernels():
    """Large maps are parsed by a kernel; no other input or output waits for Warp."""
    found = {
        path.name
        for room, path, tree in _modules()
        for node in ast.walk(tree)
        for name in _imported(node)
        if room == "io" and (name == "warp" or name.startswith("maomaps_warp.kernels"))
    }
    assert found == {"plain_tables.py"}


def test_importing_the_package_starts_nothing():
    code = (
        "import sys, maomaps_warp, maomaps_warp.pipeline, maomaps_warp.cli; "
        "print([m for m in ('warp', 'scipy', 'rosbags', 'mcap', 'PIL', 'trimesh', 'small_gicp') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_command_line_loads_no_numpy_before_a_command_runs():
    code = "import sys, maomaps_warp.cli; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
