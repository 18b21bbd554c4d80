"""Runs `maomaps-warp score` in this process and collects all that it left."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from maomaps_warp.cli.app import app

#: What becomes of a predicted map element.
CLASSES = ("associated", "out_of_view", "occluded", "no_ground_truth")


@dataclass(frozen=True)
class Outcome:
    """What a run of the command left.

    Attributes:
        exit_code: 1 stands for an exception that the command did not catch.
        stdout, stderr: what it printed.
        document: the content of its --json file; None if it wrote none.
    """

    exit_code: int
    stdout: str
    stderr: str
    document: dict[str, Any] | None

    @property
    def metrics(self) -> dict[str, Any]:
        """The metrics of a run that must have gone well."""
        assert self.exit_code == 0, self.stderr
        assert self.document is not None
        metrics: dict[str, Any] = self.document["metrics"]
        return metrics


def score(folder: Path, *arguments: object) -> Outcome:
    """Run `maomaps-warp score --json FILE ARGUMENTS`, FILE being a new one in `folder`; a later --json replaces it."""
    output = folder / "score of this run.json"
    output.unlink(missing_ok=True)
    result = CliRunner().invoke(app, ["score", "--json", str(output), *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    document = json.loads(output.read_text()) if output.exists() else None
    return Outcome(result.exit_code, result.stdout, result.stderr, document)


def assert_counts_add_up(metrics: dict[str, Any]) -> None:
    """Of a run with all four metrics: nothing is lost."""
    for name in ("ate", "rpe"):
        counts = metrics[name]["counts"]
        assert counts["matched"] + counts["unmatched"] == counts["poses"]
    counts = metrics["ame_ray"]["counts"]
    assert sum(counts[name] for name in CLASSES) == counts["total"] > 0
    assert metrics["ame_ray"]["count"] == counts["correspondences"]
    assert metrics["ame_nn"]["count"] == metrics["ame_nn"]["counts"]["est_points"]


def lines_of(outcome: Outcome) -> list[str]:
    lines = outcome.stderr.splitlines()
    assert lines and all(line.startswith("maomaps-warp: error: ") for line in lines), outcome.stderr
    return lines


def assert_refused(outcome: Outcome, folder: Path, *words: str) -> None:
    """Exit code 2, one line that says all of `words`, and no output of any kind."""
    assert outcome.exit_code == 2, (outcome.exit_code, outcome.stderr)
    (line,) = lines_of(outcome)
    for word in words:
        assert word in line
    assert outcome.stdout == ""
    assert outcome.document is None
    assert not list(folder.glob(".*"))


def assert_without_value(outcome: Outcome, *metrics: str) -> None:
    """Exit code 3, and these metrics are null with a reason."""
    assert outcome.exit_code == 3, (outcome.exit_code, outcome.stderr)
    reasons = {line.removeprefix("maomaps-warp: error: ") for line in lines_of(outcome)}
    assert outcome.document is not None
    for name in metrics:
        metric = outcome.document["metrics"][name]
        assert metric["value"] is None
        assert " ".join(metric["reason"].split()) in reasons
