"""Output files are written whole or not at all."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from maomaps_warp.errors import InputError
from maomaps_warp.io.outputs import check_writable, write_whole

is_root = hasattr(os, "geteuid") and os.geteuid() == 0


def names(folder):
    return [path.name for path in folder.iterdir()]


@pytest.mark.parametrize(("mode", "content"), [("w", "grün\n"), ("wb", b"\x00\n\xff")])
def test_a_file_appears_with_its_content_and_nothing_else(tmp_path, mode, content):
    path = tmp_path / "out.txt"
    with write_whole(path, mode) as file:
        file.write(content)
    assert path.read_bytes() == (content.encode("utf-8") if mode == "w" else content)
    assert names(tmp_path) == ["out.txt"]


def test_a_failure_midway_keeps_the_old_file_and_leaves_no_remains(tmp_path):
    path = tmp_path / "out.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), write_whole(path, "w") as file:
        file.write("half of the n")
        raise RuntimeError
    assert path.read_text() == "old"
    assert names(tmp_path) == ["out.txt"]


def test_the_old_file_stands_until_the_new_one_is_complete(tmp_path):
    path = tmp_path / "out.txt"
    path.write_text("old")
    with write_whole(path, "w") as file:
        file.write("new")
        file.flush()
        assert path.read_text() == "old"
    assert path.read_text() == "new"


def test_an_error_about_another_file_is_not_taken_for_ours(tmp_path):
    with pytest.raises(FileNotFoundError), write_whole(tmp_path / "out.txt", "w"):
        (tmp_path / "input").read_text()
    assert names(tmp_path) == []


def test_rights_of_a_replaced_file_are_kept_and_links_are_followed(tmp_path):
    path, link = tmp_path / "out.txt", tmp_path / "link.txt"
    path.write_text("old")
    path.chmod(0o640)
    link.symlink_to(path)
    with write_whole(link, "w") as file:
        file.write("new")
    assert link.is_symlink()
    assert path.read_text() == "new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no /dev/null here")
def test_a_device_is_written_to_and_not_replaced():
    with write_whole(Path("/dev/null"), "w") as file:
        file.write("gone")
    check_writable(Path("/dev/null"))
    assert Path("/dev/null").is_char_device()


def _in_a_missing_folder(tmp_path):
    return tmp_path / "nowhere" / "out.txt", "create the folder"


def _a_folder(tmp_path):
    return tmp_path, "a folder stands there"


def _below_a_file(tmp_path):
    (tmp_path / "file").write_text("")
    return tmp_path / "file" / "out.txt", "no folder"


def _protected(tmp_path):
    path = tmp_path / "protected.txt"
    path.write_text("keep")
    path.chmod(0o444)
    return path, "permission denied"


@pytest.mark.parametrize(
    "case",
    [
        _in_a_missing_folder,
        _a_folder,
        _below_a_file,
        pytest.param(_protected, marks=pytest.mark.skipif(is_root, reason="root may write everything")),
    ],
)
def test_a_path_that_cannot_be_written_is_refused_early_and_late_alike(tmp_path, case):
    path, words = case(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match=words) as early:
        check_writable(path)
    with pytest.raises(InputError, match=words), write_whole(path, "w") as file:
        file.write("x")
    assert str(path) in str(early.value)
    assert sorted(tmp_path.rglob("*")) == before


def test_checking_leaves_nothing_behind_and_touches_nothing(tmp_path):
    path = tmp_path / "out.txt"
    check_writable(path)
    assert names(tmp_path) == []
    path.write_text("old")
    check_writable(path)
    assert path.read_text() == "old"
    assert names(tmp_path) == ["out.txt"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_is_told_as_such():
    with pytest.raises(InputError, match="No space left"), write_whole(Path("/dev/full"), "w") as file:
        file.write("x" * 100_000)
