"""What a dataset is asked to be, and the file that remembers it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from maomaps_warp.errors import InputError
from maomaps_warp.io.outputs import write_whole
from maomaps_warp.jobs.pair_search import IouKind
from maomaps_warp.jobs.record import RecordOptions, SceneOptions, is_flat

#: What was asked for, in the dataset's folder.
RECIPE = "dataset.json"
#: Of the files of a dataset.
SCHEMA = 1


@dataclass(frozen=True)
class SceneEntry:
    """One scene of a dataset.

    Attributes:
        name: a file, or "flat" or "flat:SEED".
        options: how the file is read.
        floor_z: height of the floor, metres; None: found.
        duration: shortest and longest run, seconds; None: as in the other scenes.
    """

    name: str
    options: SceneOptions
    floor_z: float | None = None
    duration: tuple[float, float] | None = None


@dataclass(frozen=True)
class DatasetOptions:
    """What a dataset shall be.

    Attributes:
        scenes: sample k is of scene k modulo their number.
        robot: robot, camera, driving and rendering of every run; its seed, duration and places are not used.
        samples: how many.
        iou: lowest and highest overlap of a sample's runs, 0 to 1.
        kind: of what the overlap is taken.
        duration: shortest and longest run, seconds.
        seed: of everything random.
        suffix: of the bags: ".bag", ".mcap", or "" for folders.
    """

    scenes: tuple[SceneEntry, ...]
    robot: RecordOptions
    samples: int = 20
    iou: tuple[float, float] = (0.2, 0.6)
    kind: IouKind = "voxels"
    duration: tuple[float, float] = (20.0, 60.0)
    seed: int = 0
    suffix: str = ".bag"

    def __post_init__(self) -> None:
        if not self.scenes or self.samples < 1:
            raise ValueError("a dataset needs a scene and a sample")
        if not 0.0 <= self.iou[0] < self.iou[1] <= 1.0:
            raise ValueError(f"the overlap must be a range within 0 and 1, got {self.iou}")
        for duration in (self.duration, *(entry.duration for entry in self.scenes if entry.duration)):
            if not 0.0 < duration[0] <= duration[1] < np.inf:
                raise ValueError(f"the duration must be a range above 0, got {duration}")


def recipe_of(options: DatasetOptions) -> dict[str, Any]:
    """Everything that decides the samples' bytes."""
    robot = asdict(options.robot)
    # Every run of a dataset explores from a start of its own.
    for unused in (
        "duration",
        "seed",
        "start",
        "waypoints",
        "trajectory",
        "pose_frame",
        "floor_z",
        "scene",
        "overwrite",
    ):
        del robot[unused]
    scenes = [
        asdict(entry) | {"name": Path(entry.name).name, "sha256": _digest(entry.name)} for entry in options.scenes
    ]
    recipe = {
        "schema": SCHEMA,
        "scenes": scenes,
        "iou": options.iou,
        "iou_of": options.kind,
        "duration_s": options.duration,
        "seed": options.seed,
        "suffix": options.suffix,
        "robot": robot,
    }
    return dict(json.loads(json.dumps(recipe)))


def _digest(scene: str) -> str | None:
    """Of a scene's file (not of textures that lie beside it); None of a built-in one."""
    if is_flat(scene):
        return None
    try:
        with Path(scene).open("rb") as file:
            return hashlib.file_digest(file, partial(hashlib.new, "sha256")).hexdigest()
    except OSError as error:
        raise InputError(scene, f"cannot be read: {error.strerror}") from error


def begin_dataset(folder: Path, recipe: dict[str, Any]) -> None:
    """Begin a dataset, or go on with one of the same recipe."""
    path = folder / RECIPE
    if path.exists():
        try:
            known = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(path, f"cannot be read: {error}", "choose another folder") from error
        if known != recipe:
            other = [key for key in recipe if known.get(key) != recipe[key]]
            found = f"was made with other options: {', '.join(other)}"
            raise InputError(path, found, "give the same ones to go on, or choose another folder")
        return
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(folder, "exists and is no dataset that was made here", "choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, f"cannot be made: {error.strerror}", "choose another place") from error
    with write_whole(path) as file:
        file.write(json.dumps(recipe, indent=2) + "\n")
