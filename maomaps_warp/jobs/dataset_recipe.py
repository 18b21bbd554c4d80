"""What a dataset is asked to be, and the file that remembers it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from maomaps_warp.errors import InputError
from maomaps_warp.io.outputs import write_whole
from maomaps_warp.jobs.pair_search import IouKind
from maomaps_warp.jobs.run_plan import RecordOptions
from maomaps_warp.sim.scene_files import SceneOptions

#: What was asked for, in the dataset's folder.
RECIPE = "dataset.json"
#: Of the files of a dataset.
SCHEMA = 1
_OF_SINGLE_RUNS = (
    "duration",
    "seed",
    "start",
    "waypoints",
    "trajectory",
    "pose_frame",
    "floor_z",
    "scene",
    "overwrite",
)


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
            low, high = self.iou
            raise ValueError(f"the overlap must be a range within 0 and 1, lower end first, got {low:g}..{high:g}")
        for duration in (self.duration, *(entry.duration for entry in self.scenes if entry.duration)):
            if not 0.0 < duration[0] <= duration[1] < np.inf:
                raise ValueError(f"the duration must be a range above 0, got {duration}")


def recipe_of(options: DatasetOptions, digests: Sequence[str], device: str) -> dict[str, Any]:
    """Everything that decides the samples' bytes.

    Args:
        options: what was asked for.
        digests: of the scenes' worlds, in order.
        device: Warp device; CPU and CUDA may differ where rays pass edges.
    """
    robot = asdict(options.robot)
    # Every run of a dataset explores from a start of its own.
    for unused in _OF_SINGLE_RUNS:
        del robot[unused]
    scenes = [
        asdict(entry) | {"name": Path(entry.name).name, "sha256": digest}
        for entry, digest in zip(options.scenes, digests, strict=True)
    ]
    recipe = {
        "schema": SCHEMA,
        "maomaps_warp": version("maomaps-warp"),
        "device": device.partition(":")[0],
        "scenes": scenes,
        "iou": options.iou,
        "iou_of": options.kind,
        "duration_s": options.duration,
        "seed": options.seed,
        "suffix": options.suffix,
        "robot": robot,
    }
    return dict(json.loads(json.dumps(recipe)))


@contextmanager
def begun_dataset(folder: Path, recipe: dict[str, Any]) -> Iterator[None]:
    """Begin a dataset, or go on with one of the same recipe; nobody else does meanwhile.

    Raises:
        InputError: another dataset or something else is there, or another process is at it.
    """
    path = folder / RECIPE
    if path.exists():
        _check_same(path, recipe)
    else:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(folder, "exists and is no dataset that was made here", "choose another folder")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(folder, f"cannot be made: {error.strerror}", "choose another place") from error
        with write_whole(path) as file:
            file.write(json.dumps(recipe, indent=2) + "\n")
    with path.open(encoding="utf-8") as file:
        _lock(folder, file.fileno())
        yield


def read_facts(path: Path, remedy: str, needed: Sequence[str] = ()) -> dict[str, Any]:
    """A JSON object of a dataset.

    Args:
        path: the file.
        remedy: what to do about one that is damaged.
        needed: names that it must hold.

    Raises:
        InputError: it is none.
    """
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read: {error}", remedy) from error
    if not isinstance(facts, dict) or not facts.keys() >= set(needed):
        raise InputError(path, "does not hold what it should", remedy)
    return facts


def _check_same(path: Path, recipe: dict[str, Any]) -> None:
    known = _leaves("", read_facts(path, "choose another folder"))
    asked = _leaves("", recipe)
    if known != asked:
        names = sorted(key for key in {*known, *asked} if known.get(key) != asked.get(key))
        first = f"{names[0].lstrip('.')} was {known.get(names[0])!r}, now {asked.get(names[0])!r}"
        others = f" (and {len(names) - 1} more)" if len(names) > 1 else ""
        found = f"was made with other options: {first}{others}"
        raise InputError(path, found, "give the same ones to go on, or choose another folder")


def _leaves(place: str, value: Any) -> dict[str, Any]:
    """The single values of nested objects and lists, by their places."""
    if isinstance(value, dict | list):
        entries = value.items() if isinstance(value, dict) else enumerate(value)
        return {key: leaf for name, entry in entries for key, leaf in _leaves(f"{place}.{name}", entry).items()}
    return {place: value}


def _lock(folder: Path, descriptor: int) -> None:
    """Held until the file is closed; systems without such locks do without."""
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(folder, "is being made by another process", "wait for it, or choose another folder") from None
    except OSError:  # a file system without locks
        return
