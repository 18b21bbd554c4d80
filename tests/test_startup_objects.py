"""Kernels compiled ahead: a fitting object is loaded, and nothing else ever is."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import warp as wp

from maomaps_warp.mapping import kernel_objects
from maomaps_warp.mapping.device import prepare_kernels
from maomaps_warp.mapping.kernel_objects import build_objects, fitting_targets, load_objects

MODULE = "maomaps_warp.tests.objects"
wp.set_module_options(
    {"enable_backward": False, "fuse_fp": False, "block_dim": 1, "cpu_compiler_flags": "-march=native"}, module=MODULE
)


@wp.kernel(module=MODULE)
def _tenth_of_square(values: wp.array(dtype=wp.float32)):
    i = wp.tid()
    values[i] = values[i] * values[i] / 10.0


def _launched(values):
    on_device = wp.array(values, dtype=wp.float32, device="cpu")
    wp.launch(_tenth_of_square, dim=len(values), inputs=[on_device], device="cpu")
    return on_device.numpy()


VALUES = np.random.default_rng(0).normal(size=1000).astype(np.float32)

pytestmark = pytest.mark.skipif(not fitting_targets(), reason="no objects are made for this kind of machine")


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Objects of MODULE, for the best target only: each takes seconds to compile."""
    folder = tmp_path_factory.mktemp("objects")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernel_objects, "TARGETS", tuple(fitting_targets()[:1]))
        patch.setattr(wp.config, "use_precompiled_headers", False)
        build_objects([MODULE], folder)
    return folder


@pytest.fixture
def objects(built, tmp_path, monkeypatch):
    """A copy of the objects to spoil; and options as before, whatever is loaded."""
    folder = tmp_path / "objects"
    shutil.copytree(built, folder)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "cache"))
    monkeypatch.setattr(wp.config, "use_precompiled_headers", False)
    options = dict(wp.get_module_options(MODULE))
    yield folder
    wp.set_module_options(options, module=MODULE)


def _only(folder, pattern):
    (file,) = folder.rglob(pattern)
    return file


def _assert_left_alone(folder):
    options = dict(wp.get_module_options(MODULE))
    assert not load_objects(MODULE, folder)
    assert wp.get_module_options(MODULE) == options


def test_an_object_that_fits_is_loaded_and_nothing_is_compiled(objects, tmp_path):
    assert load_objects(MODULE, objects)
    np.testing.assert_array_equal(_launched(VALUES), VALUES * VALUES / np.float32(10))
    assert not (tmp_path / "cache").exists()


def test_only_objects_are_shipped_and_no_source(built):
    assert {file.suffix for file in built.rglob("*") if file.is_file()} == {".o", ".meta", ".json"}


@pytest.mark.parametrize("pattern", ["*.o", "*.meta"])
def test_a_damaged_file_is_left_alone(objects, pattern):
    file = _only(objects, pattern)
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    _assert_left_alone(objects)


@pytest.mark.parametrize("pattern", ["*.o", "*.meta", "manifest.json"])
def test_a_missing_file_is_noticed(objects, pattern):
    _only(objects, pattern).unlink()
    _assert_left_alone(objects)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"x86-64-v3/a.o": 1}', "\x00"])
def test_a_damaged_manifest_is_no_manifest(objects, text):
    _only(objects, "manifest.json").write_text(text)
    _assert_left_alone(objects)


def test_a_file_that_the_manifest_does_not_know_spoils_the_folder(objects):
    (_only(objects, "*.o").parent / "wp_other.o").write_bytes(b"no object")
    _assert_left_alone(objects)


def test_objects_of_another_version_of_warp_are_left_alone(objects):
    (objects / wp.config.version).rename(objects / "1.18.0")
    _assert_left_alone(objects)


def test_a_processor_without_the_features_takes_no_object(objects, monkeypatch):
    monkeypatch.setattr(kernel_objects, "_processor_features", lambda: frozenset({"avx", "f16c"}))
    monkeypatch.setattr(kernel_objects.platform, "machine", lambda: "x86_64")
    assert fitting_targets() == []
    _assert_left_alone(objects)


def test_another_machine_or_system_takes_no_object(objects, monkeypatch):
    monkeypatch.setattr(kernel_objects.platform, "machine", lambda: "riscv64")
    _assert_left_alone(objects)
    monkeypatch.undo()
    monkeypatch.setattr(kernel_objects.sys, "platform", "darwin")
    _assert_left_alone(objects)


def test_a_processor_that_tells_nothing_has_no_features(objects, monkeypatch, tmp_path):
    monkeypatch.setattr(kernel_objects.platform, "machine", lambda: "x86_64")
    for content in (b"", b"flags", b"model name : x\n", b"flags : \xff\n"):
        (tmp_path / "cpuinfo").write_bytes(content)
        monkeypatch.setattr(kernel_objects, "_CPU_INFO", tmp_path / "cpuinfo")
        assert fitting_targets() == []
    monkeypatch.setattr(kernel_objects, "_CPU_INFO", tmp_path / "none")
    assert fitting_targets() == []


def test_objects_of_other_kernels_or_options_are_left_alone(objects):
    wp.set_module_options({"fuse_fp": True}, module=MODULE)
    _assert_left_alone(objects)


def test_what_no_object_fits_is_compiled_and_gives_the_same(objects, tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_objects, "SHIPPED", tmp_path / "nothing shipped")
    monkeypatch.setattr("maomaps_warp.kernels.modules.FILES", {MODULE: ()})
    monkeypatch.setattr("maomaps_warp.kernels.modules.JOBS", {"score": (MODULE,)})
    prepare_kernels("cpu", "score")
    assert any((tmp_path / "cache").rglob("*.o"))
    np.testing.assert_array_equal(_launched(VALUES), VALUES * VALUES / np.float32(10))


def test_what_is_cached_is_loaded_on_one_thread_and_not_compiled_again(objects, tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_objects, "SHIPPED", tmp_path / "nothing shipped")
    monkeypatch.setattr("maomaps_warp.kernels.modules.FILES", {MODULE: ()})
    monkeypatch.setattr("maomaps_warp.kernels.modules.JOBS", {"score": (MODULE,)})
    wp.get_module(MODULE).unload()
    prepare_kernels("cpu", "score")
    cached = {file: file.stat().st_mtime_ns for file in (tmp_path / "cache").rglob("*")}
    assert any(file.suffix == ".o" for file in cached)
    wp.get_module(MODULE).unload()
    monkeypatch.delattr(wp, "force_load")
    prepare_kernels("cpu", "score")
    np.testing.assert_array_equal(_launched(VALUES), VALUES * VALUES / np.float32(10))
    assert {file: file.stat().st_mtime_ns for file in (tmp_path / "cache").rglob("*")} == cached


def test_the_manifest_covers_the_objects_of_every_machine(built):
    manifest = json.loads(_only(built, "manifest.json").read_text())
    assert sorted(manifest) == sorted(
        file.relative_to(built / wp.config.version).as_posix()
        for file in built.rglob("*")
        if file.suffix in (".o", ".meta")
    )
