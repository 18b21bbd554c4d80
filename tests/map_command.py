"""A small simulated recording as a bag, and runs of `maomaps-warp map` in this process."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bags
import numpy as np
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.model.camera import Camera
from maomaps_warp.sim.agent import drive
from maomaps_warp.sim.render import render_frames
from maomaps_warp.sim.scene import furnished_flat

SIZE = (80, 60)
CAMERA = Camera.from_fov(*SIZE, 90.0)
DEPTH, RGB, INFO, POSE = "/depth/image", "/rgb/image", "/depth/camera_info", "/pose"
RUN_FILES = {
    "gt_points_{run}.txt",
    "gt_points_{run}.pcd",
    "gt_colors_{run}.txt",
    "gt_poses_{run}.txt",
    "gt_poses_{run}_timestamps.txt",
    "start_pose_{run}.txt",
    "goal_pose_{run}.txt",
}


@dataclass(frozen=True)
class Outcome:
    """What a run of the command left: `document` is the content of its --json file, `files` names in its folder."""

    code: int
    stdout: str
    stderr: str
    document: dict[str, Any] | None
    files: set[str]


@dataclass(frozen=True)
class Drive:
    """Images and poses of a simulated drive, by stamp."""

    depths: dict[int, np.ndarray]
    colors: dict[int, np.ndarray]
    poses: dict[int, np.ndarray]


@functools.cache
def recorded_drive() -> Drive:
    """Thirty frames of a drive through a flat."""
    scene = furnished_flat(1)
    path = drive(scene, frames=240, seed=1).select(np.arange(0, 120, 4))
    frames = list(render_frames(scene.world, CAMERA, path, "cpu").read(True))
    stamps = path.stamps_ns.tolist()
    return Drive(
        {t: frame.depth for t, frame in zip(stamps, frames, strict=True)},
        {t: frame.colors for t, frame in zip(stamps, frames, strict=True)},
        dict(zip(stamps, path.T_world_camera, strict=True)),
    )


def entries(images: Drive, *, depth_topic: str = DEPTH, camera: Camera = CAMERA) -> list:
    found = [(depth_topic, t, bags.depth_message("ros1", t, image)) for t, image in images.depths.items()]
    found += [(RGB, t, bags.color_message("ros1", t, image)) for t, image in images.colors.items()]
    found += [(INFO, t, bags.camera_info("ros1", t, camera)) for t in images.depths]
    return found + bags.pose_messages("ros1", POSE, list(images.poses), np.array(list(images.poses.values())))


def write(folder: Path, messages: list) -> Path:
    return bags.write_bag(folder / "run.bag", "ros1", sorted(messages, key=lambda entry: entry[1]))


def run_map(folder: Path, *words: object) -> Outcome:
    """Run `maomaps-warp map WORDS -o FOLDER/out --json FOLDER/map.json`."""
    output, json_file = folder / "out", folder / "map.json"
    json_file.unlink(missing_ok=True)
    result = CliRunner().invoke(app, ["map", "-o", str(output), "--json", str(json_file), *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    document = json.loads(json_file.read_text()) if json_file.exists() else None
    files = {path.name for path in output.iterdir()} if output.exists() else set()
    return Outcome(result.exit_code, result.stdout, result.stderr, document, files)


def assert_refused(outcome: Outcome, *words: str) -> None:
    """Exit code 2, one line with all of `words`, nothing written."""
    assert outcome.code == 2, (outcome.code, outcome.stdout, outcome.stderr)
    (line,) = outcome.stderr.splitlines()
    assert line.startswith("maomaps-warp: error: ")
    for word in words:
        assert word in line, line
    assert (outcome.stdout, outcome.document, outcome.files) == ("", None, set())


def names(run: str) -> set[str]:
    return {name.format(run=run) for name in RUN_FILES}
