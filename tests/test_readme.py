"""The README's examples do what they say."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"<!-- run by tests/test_readme.py -->\n```python\n(.*?)```", README, re.DOTALL)


def _run(code: str, folder: Path) -> str:
    # A file, not -c: Warp reads a kernel's source.
    (folder / "example.py").write_text(code)
    done = subprocess.run([sys.executable, "example.py"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_both_examples_are_found():
    assert len(EXAMPLES) == 2


def test_the_kernel_example_measures_its_wall(tmp_path):
    lines = _run(EXAMPLES[1], tmp_path).splitlines()
    ranges = [float(r) for r in lines[-1].strip("[]").split()]
    assert ranges == pytest.approx([2.0, 2.000625, 2.000625], abs=1e-6)  # sqrt(4 + 0.05^2), as it is printed


@pytest.mark.slow
def test_the_python_example_scores_the_demonstration(tmp_path):
    command = [sys.executable, "-m", "maomaps_warp", "demo", "--output", "demo"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    printed = _run(EXAMPLES[0], tmp_path)
    assert re.search(r"AME along camera rays: 0\.\d+ m, median 0\.\d+ m", printed)
    assert "'out_of_view'" in printed
