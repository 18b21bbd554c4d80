"""A dataset of overlapping runs through given scenes: recorded, mapped, and measured, sample by sample."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from maomaps_warp.errors import InputError
from maomaps_warp.io.outputs import write_whole
from maomaps_warp.io.sample_writing import SamplePlace
from maomaps_warp.io.sources import SourceOptions
from maomaps_warp.jobs.dataset_recipe import SCHEMA, DatasetOptions, SceneEntry, begun_dataset, read_facts, recipe_of
from maomaps_warp.jobs.ground_truth import open_recording
from maomaps_warp.jobs.pair_search import PairSearch, PlannedPair, PlannedRun, iou_of
from maomaps_warp.jobs.record import record_simulator
from maomaps_warp.jobs.run_plan import open_world
from maomaps_warp.jobs.sample import MadeSample, make_sample
from maomaps_warp.map_protocol import MAP_PRESETS
from maomaps_warp.model.dataset import OverlapFigures
from maomaps_warp.sim.free_space import FreeSpace, find_free_space
from maomaps_warp.sim.recorder import MAOMAPS_TOPICS
from maomaps_warp.sim.render import MeshSimulator
from maomaps_warp.sim.simulator import EXACT_DEPTH
from maomaps_warp.sim.world import World
from maomaps_warp.stopwatch import Stopwatch

__all__ = ["VOXEL_SIZE", "DatasetOptions", "DatasetSample", "SceneEntry", "create_dataset", "wanted_overlap"]

#: What became of a sample, in its folder.
FACTS = "sample.json"
_NEEDED = ("scene", "scene_notes", "iou", "files")
#: Of all maps, metres.
VOXEL_SIZE = MAP_PRESETS["maomaps"].voxel_size
_RUNS = ("first", "second")
#: Pairs that are recorded and mapped at most, until one overlaps as asked.
_MOST_TRIES = 6
#: The golden ratio: multiples of it, modulo 1, fill an interval evenly, however many there will be.
_GOLDEN = 0.5 * (1.0 + 5.0**0.5)


@dataclass(frozen=True)
class DatasetSample:
    """A sample of a dataset.

    Attributes:
        name: of its folder.
        facts: what `sample.json` says.
        was_there: it was made earlier.
    """

    name: str
    facts: dict[str, Any]
    was_there: bool


@dataclass(frozen=True, eq=False)
class _RecordedPair:
    """Two runs that were recorded and mapped; `empty` is the share of pixels that see nothing, by run."""

    pair: PlannedPair
    made: MadeSample
    overlap: OverlapFigures
    empty: dict[str, float]


def create_dataset(
    folder: Path,
    options: DatasetOptions,
    *,
    device: str = "cpu",
    clock: Stopwatch | None = None,
    tell: Callable[[DatasetSample], None] = lambda sample: None,
) -> tuple[DatasetSample, ...]:
    """Make sample1, sample2, ... in a folder; those that are there already stay.

    Each sample depends on the options and its number alone, so that a dataset that was interrupted ends with the same
    bytes, and one of more samples begins with those of one of fewer. A sample appears when it is complete.

    Args:
        folder: made if there is none; else a dataset of the same options, `samples` apart.
        options: what it shall be.
        device: Warp device.
        clock: collects the stages' times.
        tell: told of each sample, in order.

    Raises:
        InputError: another dataset or something else is in the folder, a scene cannot be used, or no two runs through
            it overlap as asked.
        KeyboardInterrupt: Ctrl-C; the samples that are complete stay.
    """
    clock = clock or Stopwatch()
    made = []
    with clock.stage("read scenes") as progress:
        digests = []
        for number, scene in enumerate(options.scenes, 1):
            # All of them before the first sample: who has a typing error in the last should not wait for an hour.
            digests.append(_open_site(scene, options, device)[0].digest)
            progress(number, len(options.scenes))
    with begun_dataset(folder, recipe_of(options, digests, device)), clock.stage("dataset") as progress:
        for number in range(1, options.samples + 1):
            progress(number - 1, options.samples)
            name = f"sample{number}"
            facts = folder / name / FACTS
            if was_there := facts.exists():
                known = _known(folder / name)
            else:
                known = _make(folder, name, number, options, device, clock)
            made.append(DatasetSample(name, known, was_there))
            tell(made[-1])
        progress(options.samples, options.samples)
    return tuple(made)


def _known(sample: Path) -> dict[str, Any]:
    """The facts of a sample that is whole."""
    remedy = f"remove {sample}: it is made anew"
    facts = read_facts(sample / FACTS, remedy, _NEEDED)
    if missing := [file for file in facts["files"] if not (sample / file).exists()]:
        raise InputError(sample, f"lacks {', '.join(missing)}", remedy)
    return facts


def _make(
    folder: Path, name: str, number: int, options: DatasetOptions, device: str, clock: Stopwatch
) -> dict[str, Any]:
    """Make one sample, beside its place and then in it; returns its facts."""
    part = folder / f".{name}.part"
    if (folder / name).exists():
        raise InputError(folder / name, "is no sample that was made here", "move it away")
    shutil.rmtree(part, ignore_errors=True)  # of a run that was killed
    try:
        facts = _record_pair(part, name, number, options, device, clock)
        with write_whole(part / FACTS) as file:
            file.write(json.dumps(facts, indent=2) + "\n")
        part.rename(folder / name)
    except InputError as error:
        where = error.where.replace(str(part), str(folder / name))
        raise InputError(where, error.found, error.hint) from error
    except OSError as error:
        raise InputError(folder / name, f"cannot be written: {error.strerror or error}", "see --debug") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return facts


def _record_pair(
    part: Path, name: str, number: int, options: DatasetOptions, device: str, clock: Stopwatch
) -> dict[str, Any]:
    scene = options.scenes[(number - 1) % len(options.scenes)]
    robot = options.robot
    rules = MAP_PRESETS["maomaps"]
    low, high = options.iou
    wanted = wanted_overlap(options, number)
    with clock.stage("read scene"):
        world, space = _open_site(scene, options, device)
    search = PairSearch(
        world,
        space,
        robot,
        duration=scene.duration or options.duration,
        kind=options.kind,
        voxel_size=VOXEL_SIZE,
        max_range=rules.max_range,
        seed=(options.seed, number),
        device=device,
    )
    simulator = MeshSimulator(world, robot.camera, device, robot.render)
    found = []
    for tried in range(1, _MOST_TRIES + 1):
        with clock.stage("plan"):
            pair = search.pair(wanted, options.iou)
        recorded = _record_and_map(part, number, pair, simulator, world, options, device, clock)
        iou = iou_of(recorded.overlap, options.kind)
        if low <= iou <= high:
            return _facts(name, world, scene, recorded, wanted, tried, options)
        found.append(iou)
        search.learn(pair, iou)
        shutil.rmtree(part)
    seen = ", ".join(f"{iou:.2f}" for iou in found)
    asked = f"{low:g} to {high:g}"
    raise InputError(
        scene.name,
        f"no two of {len(search.runs)} runs overlap by {asked} ({options.kind}); the nearest: {seen}",
        "a larger range, or other durations: short runs overlap less",
    )


def wanted_overlap(options: DatasetOptions, number: int) -> float:
    """The overlap that sample `number`, from 1, aims at."""
    low, high = options.iou
    share = float(np.random.default_rng([options.seed]).random()) + number / _GOLDEN
    return low + (high - low) * (share % 1.0)


def _open_site(scene: SceneEntry, options: DatasetOptions, device: str) -> tuple[World, FreeSpace]:
    """A scene, and where the robot can go in it."""
    world = open_world(scene.name, scene.options)
    return world, find_free_space(world, options.robot.robot, floor_z=scene.floor_z, device=device)


def _record_and_map(
    part: Path,
    number: int,
    pair: PlannedPair,
    simulator: MeshSimulator,
    world: World,
    options: DatasetOptions,
    device: str,
    clock: Stopwatch,
) -> _RecordedPair:
    """Record both runs into the folder, and map what the bags hold."""
    part.mkdir(parents=True)
    bags, empty = {}, {}
    for run, planned in zip(_RUNS, (pair.first, pair.second), strict=True):
        bags[run] = part / f"{run}{options.suffix}"
        effects = replace(options.robot.effects, seed=_effect_seed(options, number, planned))
        with clock.stage("record") as progress:
            recorded = record_simulator(
                simulator,
                planned.trajectory,
                bags[run],
                effects=effects,
                part_names=world.parts if options.robot.render.with_parts else (),
                progress=progress,
            )
        if recorded.is_stopped:
            raise KeyboardInterrupt
        empty[run] = recorded.empty
    # Ground truth is made of depth without noise.
    topics = (MAOMAPS_TOPICS.extras[EXACT_DEPTH],) if options.robot.effects.spoils_depth else ()
    rules = MAP_PRESETS["maomaps"]
    reading = SourceOptions(topics=topics, pose_frame="maomaps-c")
    sources = {run: open_recording(bag, rules, reading) for run, bag in bags.items()}
    made = make_sample(SamplePlace(part, bags), sources, rules, device=device, clock=clock)
    assert made.figures.overlap is not None, "a sample of two runs has an overlap"
    return _RecordedPair(pair, made, made.figures.overlap, empty)


def _effect_seed(options: DatasetOptions, number: int, run: PlannedRun) -> int:
    """Another one for each run of each sample."""
    return int(np.random.default_rng([options.seed, number, run.number]).integers(1 << 31))


def _facts(
    name: str,
    world: World,
    scene: SceneEntry,
    recorded: _RecordedPair,
    wanted: float,
    tried: int,
    options: DatasetOptions,
) -> dict[str, Any]:
    pair, overlap = recorded.pair, recorded.overlap
    runs = {
        run: {
            "number_of_the_draw": planned.number,
            "frames": len(planned.trajectory),
            "path_length_m": planned.trajectory.path_length,
            "duration_s": planned.trajectory.duration_s,
            "pixels_that_see_nothing": recorded.empty[run],
        }
        for run, planned in zip(_RUNS, (pair.first, pair.second), strict=True)
    }
    iou = {"voxels": overlap.voxel_iou, "known": overlap.known_iou, "obstacle": overlap.obstacle_iou}
    return {
        "schema": SCHEMA,
        "sample": name,
        "scene": Path(scene.name).name,
        "scene_notes": list(world.notes),
        "iou": iou | {"asked_for": list(options.iou), "of": options.kind, "aimed_at": wanted, "tries": tried},
        "runs": runs,
        "files": sorted({*(file.name for file in recorded.made.files), *(f"{run}{options.suffix}" for run in _RUNS)}),
        "notes": {run: list(notes) for run, notes in recorded.made.notes.items()},
    }
