"""What a command loads before it works, and how it ends when it is interrupted meanwhile."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from scenes import cluttered_room

from maomaps_warp.cli import app as application
from maomaps_warp.io.cloud_writing import write_xyz


def _python(code, *arguments, **environment):
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        check=False,
    )


#: Runs a command, and says last which of the named packages were loaded, and whether masked arrays were.
_LOADED = """
import sys
from pathlib import Path
from maomaps_warp.cli import main
try:
    main()
except SystemExit as end:
    print(end.code, [name for name in ("warp", "maomaps_warp.cli.check", "maomaps_warp.kernels",
          "maomaps_warp.kernels.nearest_packets") if name in sys.modules], "numpy.ma" in sys.modules)
"""


def _trajectory(path, shift=0.0):
    rows = [f"{stamp} {0.1 * stamp + shift} {0.01 * stamp**2} 0 0 0 0 1" for stamp in range(20)]
    path.write_text("\n".join(rows) + "\n")
    return path


def test_scoring_trajectories_never_loads_warp(tmp_path):
    sides = [_trajectory(tmp_path / "gt.txt"), _trajectory(tmp_path / "est.txt", 0.1)]
    done = _python(_LOADED, "score", "--gt-trajectory", sides[0], "--est-trajectory", sides[1])
    assert done.stdout.splitlines()[-1].startswith("0 []"), done.stderr


def test_scoring_voxels_loads_no_kernels_of_free_points_and_no_masked_arrays(tmp_path):
    points, poses = cluttered_room(0), [f"{0.8 + 0.1 * i} 1 0.7 0 0 {0.5 * i}" for i in range(6)]
    for side in ("gt", "slam"):
        write_xyz(tmp_path / f"{side}_points.txt", points)
        (tmp_path / f"{side}_poses.txt").write_text("\n".join(poses) + "\n")
    done = _python(_LOADED, "score", tmp_path)
    assert done.stdout.splitlines()[-1] == "0 ['warp', 'maomaps_warp.kernels'] False", done.stderr
    moved = _python(_LOADED, "score", tmp_path, "--align", "se3")
    assert "nearest_packets" in moved.stdout.splitlines()[-1], moved.stderr


def test_the_help_of_a_command_loads_no_other_command():
    done = _python(_LOADED, "score", "--help")
    assert done.stdout.splitlines()[-1].startswith("0 []"), done.stderr


def test_every_command_is_listed_and_has_its_help():
    whole = _python(_LOADED, "--help").stdout
    for name, command in application._LoadedOnUse().items():
        assert f"  {name} " in whole
        assert command.name == name
        assert command.help.split()[0] in whole


def test_a_misspelt_command_is_told_its_likely_name():
    done = _python(_LOADED, "scor")
    assert "'score'" in done.stderr
    assert done.stdout.splitlines()[-1].startswith("2 ")


#: Ctrl-C while the module that is named first is imported.
_INTERRUPTED = """
import sys
from pathlib import Path
interrupted = sys.argv.pop(1)
class Interrupt:
    def find_spec(self, name, *rest):
        if name == interrupted:
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupt())
from maomaps_warp.cli import main
main()
"""


@pytest.mark.parametrize("module", ["maomaps_warp.cli.app", "maomaps_warp.cli.explain", "maomaps_warp.protocol_files"])
def test_an_interrupt_while_loading_ends_in_one_line(module):
    done = _python(_INTERRUPTED, module, "explain")
    assert done.returncode == 130
    assert done.stdout == ""
    assert done.stderr == "maomaps-warp: interrupted\n"


def test_warp_starts_where_its_cache_cannot_be_written_and_leaves_nothing_behind(tmp_path):
    code = (
        "import warp as wp; from maomaps_warp.cli.terminal import quiet_warp; from pathlib import Path;"
        "quiet_warp(); folder = Path(wp.config.kernel_cache_dir); print(folder, folder.is_dir())"
    )
    (tmp_path / "file").touch()
    done = _python(code, WARP_CACHE_PATH=str(tmp_path / "file" / "cache"), TMPDIR=str(tmp_path))
    folder, exists = done.stdout.split()
    assert exists == "True"
    assert folder.startswith(str(tmp_path))
    assert [file.name for file in tmp_path.iterdir()] == ["file"]
    assert done.stderr == ""


def test_a_command_ends_without_a_last_search_through_all_that_it_imported():
    code = """
import atexit, gc
atexit.register(lambda: print(gc.get_threshold()[0], gc.get_freeze_count() > 1000))
from maomaps_warp.cli import main
main()
"""
    done = _python(code, "--version")
    assert done.stdout.splitlines()[-1] == "100000 True", done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("option", ["--help", "--version"])
def test_a_full_output_is_one_line(option):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "maomaps_warp", option], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 2
    assert done.stderr == "maomaps-warp: error: standard output: No space left on device\n"
