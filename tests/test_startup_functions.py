"""Functions that are registered only to be compiled: never a stale kernel, never a missing function."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import warp as wp

from maomaps_warp.kernels import modules, source_digest
from maomaps_warp.mapping.kernel_objects import fitting_targets

FOLDER = Path(source_digest.__file__).parent
FILE = "association_packets"

#: Settings and options that do not change what PACKETS becomes on a CPU.
WITHOUT_EFFECT = {
    *("block_dim", "cuda_output", "fast_math", "lineinfo", "llvm_cuda", "compile_time_trace", "extra_cuda_preamble"),
    *("extra_cuda_include_dirs", "enable_mathdx_gemm", "enable_mathdx_solver", "enable_mathdx_fft"),
    *("use_precompiled_headers", "verify_autograd_array_access", "deterministic_max_records"),
}
#: What only an option of the module itself changes; ours has none.
NOT_GIVEN = {"extra_cpu_include_dirs", "extra_cpu_preamble", "extra_build_dependencies"}


def _run(code, cache):
    environment = {**os.environ, "WARP_CACHE_PATH": str(cache)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


#: Names of our files that were imported.
_OURS = "print(json.dumps([name for name in sys.modules if name.startswith('maomaps_warp')]))"


def test_the_digest_is_of_exactly_the_files_that_are_imported_to_compile(tmp_path):
    imports = "import json, sys\nfrom maomaps_warp.kernels.modules import PACKETS, import_functions\n"
    # Of other packages of ours nothing at all: a constant from there would not be in the digest.
    expected = {f"maomaps_warp.kernels.{name}" for name in source_digest.sources_of(FILE)}
    found = _run(f"{imports}import_functions(PACKETS)\n{_OURS}", tmp_path)
    assert set(found) - {"maomaps_warp", "maomaps_warp.kernels"} == expected


def test_kernels_are_registered_without_what_they_call(tmp_path):
    code = f"import json, sys\nimport maomaps_warp.kernels.{FILE}\n{_OURS}"
    names = {name.removeprefix("maomaps_warp.kernels.") for name in _run(code, tmp_path)}
    host = {"association_memory", "association_types", "distance_field", "lanes"}
    assert names == {"maomaps_warp", "maomaps_warp.kernels", FILE, "modules", "source_digest", "checks", *host}


def test_the_digest_differs_with_each_of_these_files_and_with_no_other(tmp_path, monkeypatch):
    own = source_digest.source_digest(FILE)
    assert modules.PACKETS.endswith(own)
    for file in FOLDER.glob("*.py"):
        shutil.copy(file, tmp_path)
    monkeypatch.setattr(source_digest, "__file__", str(tmp_path / "source_digest.py"))
    assert source_digest.source_digest(FILE) == own
    seen = {own}
    for name in source_digest.sources_of(FILE):
        with (tmp_path / f"{name}.py").open("a") as file:
            file.write("#")
        seen.add(source_digest.source_digest(FILE))
    assert len(seen) == 1 + len(source_digest.sources_of(FILE))
    before = source_digest.source_digest(FILE)
    (tmp_path / "render.py").write_text("")
    assert source_digest.source_digest(FILE) == before


@pytest.mark.parametrize("setting", source_digest.SETTINGS)
def test_the_digest_differs_with_warp_and_its_settings(monkeypatch, setting):
    own = source_digest.source_digest(FILE)
    assert modules.is_as_named(modules.PACKETS)
    monkeypatch.setattr(wp.config, setting, "another")
    assert source_digest.source_digest(FILE) != own
    assert not modules.is_as_named(modules.PACKETS)


def test_nothing_else_that_warp_compiles_by_changes_these_kernels():
    packets = wp.get_module_options(modules.PACKETS)
    pinned = {*modules.OPTIONS, "strip_hash", "deterministic", "max_unroll"}
    known = {*source_digest.SETTINGS, *pinned, *WITHOUT_EFFECT, *NOT_GIVEN}
    assert set(wp.get_module(modules.PACKETS).resolve_options(wp.config)) <= known
    assert packets["extra_build_options"] is None


#: Associates two small maps after whatever `first` does. Says whether the functions were imported, and what the answer
#: is.
_ASSOCIATE = """
import hashlib, json, sys
from pathlib import Path
import numpy as np
import warp as wp
wp.config.log_level = wp.LOG_ERROR
from maomaps_warp.kernels import modules
from maomaps_warp.mapping import kernel_objects
from maomaps_warp.mapping.device import prepare_kernels
kernel_objects.SHIPPED = Path({shipped!r})
wp.init()
{first}
from maomaps_warp.mapping.distance_field import build_voxel_fields
from maomaps_warp.io.cameras import parse_camera
from maomaps_warp.model.voxels import VoxelGrid, VoxelMap
from maomaps_warp.scoring.association import ViewRules, associate_maps
side = np.arange(40)
wall = np.stack(np.meshgrid([60], side, side, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.int32)
ones = np.ones(len(wall), dtype=np.int64)
grid = VoxelGrid(0.05, np.zeros(3, dtype=np.int64))
gt, est = (VoxelMap(grid, wall + [shift, 0, 0], ones) for shift in (0, 2))
T = np.tile(np.eye(4), (20, 1, 1))
T[:, :3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
T[:, :3, 3] = [[0.0, 1.0, 0.05 * i] for i in range(20)]
gt_field, est_field = build_voxel_fields(gt, est, "cpu")
rules = ViewRules(parse_camera("320x240@90"))
found = associate_maps(est.points, est_field, gt_field, T, T, rules)
pairs = np.stack([found.element, found.pose, found.est_index, found.gt_index])
name = "maomaps_warp.kernels.association_bricks"
print(json.dumps([name in sys.modules, len(found), hashlib.sha256(pairs.tobytes()).hexdigest()]))
"""
_PREPARE = 'prepare_kernels("cpu", "score")'
#: Each is followed by an association whose functions have to be there.
_AND_COMPILE = {
    "not prepared": "",
    "other settings": f"wp.config.optimization_level = 1\n{_PREPARE}",
    "unloaded": f"{_PREPARE}\nwp.get_module(modules.PACKETS).unload()",
    "failed before": f"""
import maomaps_warp.kernels.{FILE}
try:
    wp.compile_aot_module(modules.PACKETS, device="cpu", module_dir={{folder!r}})
    raise SystemExit("it compiled without the functions")
except Exception as error:  # Warp exports no name for it
    assert "associate_brick" in str(error), error
""",
}


def _associate(cache, first, shipped=""):
    return _run(_ASSOCIATE.format(first=first, shipped=str(shipped or cache / "none")), cache)


def _objects(cache):
    found = {path: path.stat().st_mtime_ns for path in cache.rglob("*packets*.o")}
    assert found
    return found


@pytest.mark.slow
def test_kernels_that_were_compiled_before_do_without_the_functions_and_give_the_same(tmp_path):
    compiling = _associate(tmp_path, _PREPARE)
    assert compiling[0]
    assert compiling[1] > 1000
    objects = _objects(tmp_path)
    assert _associate(tmp_path, _PREPARE) == [False, *compiling[1:]]
    for case, first in _AND_COMPILE.items():
        assert _associate(tmp_path, first.format(folder=str(tmp_path / "aot"))) == compiling, case
    # Whatever was compiled beside went by another name.
    assert objects.items() <= _objects(tmp_path).items()
    assert _associate(tmp_path, _PREPARE) == [False, *compiling[1:]]


@pytest.mark.slow
@pytest.mark.skipif(not fitting_targets(), reason="no objects are made for this kind of machine")
def test_kernels_that_a_release_carries_do_without_the_functions(tmp_path):
    build = f"""
import json
import warp as wp
from maomaps_warp.kernels.modules import PACKETS, import_functions
from maomaps_warp.mapping import kernel_objects
wp.config.log_level = wp.LOG_ERROR
wp.init()
kernel_objects.TARGETS = tuple(kernel_objects.fitting_targets()[:1])
import_functions(PACKETS)
print(json.dumps(len(kernel_objects.build_objects([PACKETS], kernel_objects.Path({str(tmp_path / "shipped")!r})))))
"""
    assert _run(build, tmp_path) == 1
    assert not list(tmp_path.glob("*/*packets*"))
    assert _associate(tmp_path, _PREPARE, tmp_path / "shipped")[0] is False
    assert not list(tmp_path.glob("*/*packets*"))
