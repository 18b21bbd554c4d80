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

FOLDER = Path(source_digest.__file__).parent
FILE = "association_packets"


def _run(code, cache):
    environment = {**os.environ, "WARP_CACHE_PATH": str(cache)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_the_digest_is_of_exactly_the_files_that_are_imported_to_compile(tmp_path):
    code = """
import json, sys
from maomaps_warp.kernels.modules import PACKETS, import_functions
import_functions(PACKETS)
prefix = "maomaps_warp.kernels."
print(json.dumps([name.removeprefix(prefix) for name in sys.modules if name.startswith(prefix)]))
"""
    assert set(_run(code, tmp_path)) == source_digest.sources_of(FILE).keys()


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


@pytest.mark.parametrize(("setting", "value"), [("mode", "debug"), ("version", "0.0.0"), ("optimization_level", 1)])
def test_the_digest_differs_with_warp_and_its_settings(monkeypatch, setting, value):
    own = source_digest.source_digest(FILE)
    monkeypatch.setattr(wp.config, setting, value)
    assert source_digest.source_digest(FILE) != own


#: Associates two small maps; `prepare` comes first or does not. Says what was imported, and a digest of the answer.
_ASSOCIATE = """
import hashlib, json, sys
import numpy as np
import warp as wp
wp.config.log_level = wp.LOG_ERROR
from maomaps_warp.mapping.device import prepare_kernels
if {prepare}:
    prepare_kernels("cpu", "score")
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


@pytest.mark.slow
def test_kernels_that_were_compiled_before_do_without_the_functions_and_give_the_same(tmp_path):
    compiling = _run(_ASSOCIATE.format(prepare=True), tmp_path)
    assert compiling[0]
    assert compiling[1] > 1000
    objects = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*packets*.o")}
    assert _run(_ASSOCIATE.format(prepare=True), tmp_path) == [False, *compiling[1:]]
    # A program that launches them without preparing gets the functions along.
    assert _run(_ASSOCIATE.format(prepare=False), tmp_path) == compiling
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*packets*.o")} == objects
