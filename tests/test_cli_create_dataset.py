"""`create-dataset`: pairs of runs that overlap as asked, whole samples, and a dataset that goes on where it was."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from maomaps_warp.cli.app import app
from maomaps_warp.jobs import create_dataset as job

SMALL = ("--camera", "48x36@90", "--antialias", "1", "--rate", "5", "--duration", "6..14", "--device", "cpu")


def create(folder: Path, samples: int, *options: str, scenes: tuple[str, ...] = ("flat:1", "flat:2")) -> Result:
    command = ["create-dataset", *scenes, "-o", str(folder), "--samples", str(samples), *SMALL, *options]
    return CliRunner().invoke(app, command)


def tree(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    folder = tmp_path_factory.mktemp("datasets") / "mini"
    return folder, create(folder, 2)


def test_every_sample_is_whole_and_overlaps_as_asked(dataset: tuple[Path, Result]) -> None:
    folder, done = dataset
    assert done.exit_code == 0, done.output
    assert sorted(entry.name for entry in folder.iterdir()) == ["dataset.json", "sample1", "sample2"]
    for number, scene in ((1, "flat:1"), (2, "flat:2")):
        sample = folder / f"sample{number}"
        names = {file.name for file in sample.iterdir()}
        for run in ("first", "second"):
            assert {f"{run}.bag", f"gt_points_{run}.pcd", f"gt_points_{run}.txt", f"gt_colors_{run}.txt"} <= names
            assert {f"gt_poses_{run}.txt", f"start_pose_{run}.txt", f"goal_pose_{run}.txt"} <= names
        assert {"gt_points_merged.pcd", "sample.json"} <= names
        facts = json.loads((sample / "sample.json").read_text())
        assert facts["scene"] == scene
        # The overlap by NumPy, of what the files hold.
        first, second = (
            {tuple(row) for row in np.rint(np.loadtxt(sample / f"gt_points_{run}.txt") / 0.05).astype(int)}
            for run in ("first", "second")
        )
        iou = len(first & second) / len(first | second)
        assert iou == pytest.approx(facts["iou"]["voxels"], abs=1e-12) and 0.2 <= iou <= 0.6
        assert f"IoU {iou:.3f} (voxels)" in done.stdout
    assert "Sample" in done.stdout and "IoU 3D" in done.stdout, "Table II"


def test_a_dataset_that_was_made_in_parts_has_the_same_bytes(dataset: tuple[Path, Result], tmp_path: Path) -> None:
    folder, _ = dataset
    assert create(tmp_path / "mini", 1).exit_code == 0
    (tmp_path / "mini" / ".sample2.part").mkdir()  # of a run that was killed
    (tmp_path / "mini" / ".sample2.part" / "first.bag").write_bytes(b"half")
    done = create(tmp_path / "mini", 2)
    assert done.exit_code == 0 and "sample1   flat:1: IoU" in done.stdout and ", was there" in done.stdout
    assert tree(tmp_path / "mini") == tree(folder)


def test_ctrl_c_leaves_the_samples_that_are_whole(
    dataset: tuple[Path, Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, _ = dataset
    bags: list[Path] = []
    real = job.record_simulator

    def interrupted(simulator: Any, trajectory: Any, output: Path, **options: Any) -> Any:
        bags.append(output)
        return replace(real(simulator, trajectory, output, **options), is_stopped="sample2" in str(output.parent))

    monkeypatch.setattr(job, "record_simulator", interrupted)
    with pytest.raises(KeyboardInterrupt):
        create(tmp_path / "mini", 2)
    assert bags
    assert sorted(entry.name for entry in (tmp_path / "mini").iterdir()) == ["dataset.json", "sample1"]
    monkeypatch.undo()
    assert create(tmp_path / "mini", 2).exit_code == 0
    assert tree(tmp_path / "mini") == tree(folder)


@pytest.mark.slow
def test_noise_spoils_the_images_and_not_the_ground_truth(dataset: tuple[Path, Result], tmp_path: Path) -> None:
    folder, _ = dataset
    done = create(tmp_path / "mini", 1, "--effect", "kinect", "--effect", "blur")
    assert done.exit_code == 0, done.output
    noisy, exact = tree(tmp_path / "mini" / "sample1"), tree(folder / "sample1")
    assert noisy["first.bag"] != exact["first.bag"]
    for name in exact:
        # Colours are blurred, in the PCD files too.
        if name.endswith(".txt") and not name.startswith("gt_colors"):
            assert noisy[name] == exact[name], name


def test_other_options_do_not_go_on_with_a_dataset(dataset: tuple[Path, Result]) -> None:
    folder, _ = dataset
    before = tree(folder)
    for options, words in (
        (("--seed", "1"), "robot.effects.seed was 0, now 1 (and 1 more)"),
        (("--iou", "0.3..0.6"), "iou.0 was 0.2, now 0.3"),
        (("--speed", "0.4"), "robot.driving.speed was 0.5, now 0.4"),
    ):
        done = create(folder, 2, *options)
        assert done.exit_code == 2 and f"was made with other options: {words}" in done.stderr
    assert create(folder, 2, scenes=("flat:1",)).exit_code == 2
    assert tree(folder) == before


@pytest.mark.parametrize(
    ("options", "scenes", "words"),
    [
        (("--iou", "0.2"), ("flat",), "--iou 0.2: '0.2' is no range (give LO..HI"),
        (("--iou", "0.2..x"), ("flat",), "the range holds 'x', which is no number"),
        (("--iou", "0.6..0.2"), ("flat",), "the overlap must be a range within 0 and 1"),
        (("--duration", "0..5"), ("flat",), "the duration must be a range above 0"),
        ((), ("flat,duration=5..1",), "the duration must be a range above 0"),
        ((), ("flat,colour=red",), "'colour' is said twice, or is no option of a scene"),
        ((), ("flat,floor=0,floor=1",), "'floor' is said twice"),
        ((), ("flat,unit=ft",), "unit cannot be 'ft' (allowed: m, cm, mm)"),
        ((), ("flat,floor=low",), "floor holds 'low', which is no number"),
        ((), ("flat:1", "nowhere.glb"), "nowhere.glb: no such file"),
        ((), ("flat:1", "flat:x"), "'x' is no seed"),
        ((), ("flat,unit=cm",), "is built in"),
        (("--also", "heat"), ("flat",), "--also heat: no such images"),
        (("--effect", "fog"), ("flat",), "'fog' is no effect"),
    ],
)
def test_what_cannot_be_asked_for_is_one_line(
    tmp_path: Path, options: tuple[str, ...], scenes: tuple[str, ...], words: str
) -> None:
    done = create(tmp_path / "mini", 1, *options, scenes=scenes)
    assert done.exit_code == 2 and words in done.stderr, done.output
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_an_overlap_that_no_runs_have_is_told_with_what_they_have(tmp_path: Path) -> None:
    done = create(tmp_path / "mini", 1, "--iou", "0.97..0.98", "--duration", "2..3")
    assert done.exit_code == 2
    assert "overlap by 0.97 to 0.98 (voxels); the nearest: 0." in done.stderr
    assert [entry.name for entry in (tmp_path / "mini").iterdir()] == ["dataset.json"]


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mini").mkdir()
    (tmp_path / "mini" / "notes.txt").write_text("precious")
    done = create(tmp_path / "mini", 1)
    assert done.exit_code == 2 and "is no dataset that was made here" in done.stderr
    assert tree(tmp_path) == {"mini/notes.txt": b"precious"}


def test_a_damaged_recipe_and_a_foreign_sample_are_named(tmp_path: Path) -> None:
    folder = tmp_path / "mini"
    folder.mkdir()
    (folder / "dataset.json").write_text("{")
    done = create(folder, 1)
    assert done.exit_code == 2 and "dataset.json: cannot be read" in done.stderr
    (folder / "dataset.json").write_text("[]")
    assert "dataset.json: does not hold what it should" in create(folder, 1).stderr
    (folder / "dataset.json").unlink()
    assert create(folder, 1, "--iou", "0.97..0.98", "--duration", "2..3").exit_code == 2
    (folder / "sample1").mkdir()
    done = create(folder, 1, "--iou", "0.97..0.98", "--duration", "2..3")
    assert done.exit_code == 2 and "sample1: is no sample that was made here" in done.stderr


def test_rough_maps_of_all_runs_lie_on_one_lattice() -> None:
    from maomaps_warp.jobs.pair_search import PairSearch, PlannedPair
    from maomaps_warp.jobs.run_plan import RecordOptions, SceneOptions, open_world
    from maomaps_warp.sim.free_space import find_free_space

    world, options = open_world("flat:1", SceneOptions()), RecordOptions()
    search = PairSearch(
        world,
        find_free_space(world, options.robot),
        options,
        duration=(4.0, 8.0),
        kind="voxels",
        voxel_size=0.05,
        max_range=10.0,
        seed=(1,),
        device="cpu",
    )
    pair = search.pair(0.4, (0.2, 0.6))
    a, b = ({tuple(c) for c in np.rint(run.points / 0.1).astype(int)} for run in (pair.first, pair.second))
    np.testing.assert_allclose(pair.first.points / 0.1, np.rint(pair.first.points / 0.1), rtol=0, atol=1e-9)
    assert len(a & b) / len(a | b) == pytest.approx(pair.expected_iou, abs=1e-12)
    search._rough = {(0, 1): 0.40, (0, 2): 0.50, (1, 2): 0.30}
    search.runs = [pair.first] * 3
    search._tried = {(0, 1)}
    search.learn(PlannedPair(replace(pair.first, number=0), replace(pair.second, number=1), 0.4), 0.2)
    # What was expected to be twice as much as it is: of those that are left 0.50 is nearest to 0.25 now.
    assert search.pair(0.25, (0.1, 0.6)).expected_iou == pytest.approx(0.25)


def test_a_damaged_sample_and_a_dataset_in_other_hands_are_named(dataset: tuple[Path, Result], tmp_path: Path) -> None:
    import shutil

    fcntl = pytest.importorskip("fcntl", reason="locks of POSIX systems")

    folder = tmp_path / "mini"
    shutil.copytree(dataset[0], folder)
    for text, words in (("{", "cannot be read"), ("{}", "does not hold what it should")):
        (folder / "sample1" / "sample.json").write_text(text)
        done = create(folder, 2)
        assert done.exit_code == 2 and f"sample.json: {words}" in done.stderr and "it is made anew" in done.stderr
    shutil.copyfile(dataset[0] / "sample1" / "sample.json", folder / "sample1" / "sample.json")
    (folder / "sample1" / "first.bag").unlink()
    (folder / "sample1" / "gt_points_merged.txt").unlink()
    done = create(folder, 2)
    assert done.exit_code == 2 and "lacks first.bag, gt_points_merged.txt" in done.stderr
    with (folder / "dataset.json").open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        done = create(folder, 2)
    assert done.exit_code == 2 and "is being made by another process" in done.stderr


@pytest.mark.parametrize(
    ("known", "expected"),
    [
        ({(0, 1): 0.19, (0, 2): 0.31, (1, 2): 0.9}, 0.31),  # near, but outside
        ({(0, 1): 0.19, (0, 2): 0.10, (1, 2): 0.9}, 0.19),  # none is inside
        ({(0, 1): 0.21, (0, 2): 0.31, (1, 2): 0.9}, 0.21),
    ],
)
def test_a_pair_is_only_taken_outside_the_range_when_there_is_none_inside(
    known: dict[tuple[int, int], float], expected: float
) -> None:
    from maomaps_warp.jobs.pair_search import _MOST_RUNS, PairSearch

    search = PairSearch.__new__(PairSearch)  # what it knows is said here
    search._rough, search._tried, search._correction = known, set(), 1.0
    search.runs = [None] * _MOST_RUNS  # type: ignore[list-item]
    assert search.pair(0.205, (0.2, 0.6)).expected_iou == expected


def test_overlaps_that_samples_aim_at_fill_the_range_evenly() -> None:
    from maomaps_warp.jobs.record import RecordOptions

    scene = job.SceneEntry("flat", None)  # type: ignore[arg-type]
    for seed in range(5):
        options = job.DatasetOptions((scene,), RecordOptions(), iou=(0.2, 0.6), seed=seed)
        aims = np.array([job.wanted_overlap(options, number) for number in range(1, 21)])
        assert np.histogram(aims, bins=5, range=(0.2, 0.6))[0].min() >= 3
        np.testing.assert_array_equal(aims[:5], [job.wanted_overlap(options, number) for number in range(1, 6)])


def test_what_holds_for_one_scene_alone_is_said_behind_it() -> None:
    from maomaps_warp.cli.create_dataset import _scene

    entry = _scene("x.glb,floor=0.5,drop=a,drop=b,unit=cm,up=z,duration=5..12")
    assert entry.name == "x.glb" and entry.floor_z == 0.5 and entry.duration == (5.0, 12.0)
    assert (entry.options.up, entry.options.unit, entry.options.drop) == ("z", "cm", ("a", "b"))
    assert _scene("flat:3").floor_z is None and _scene("flat:3").duration is None


@pytest.mark.slow
def test_other_overlaps_and_other_bags_can_be_asked_for(tmp_path: Path) -> None:
    done = create(tmp_path / "mini", 1, "--iou-of", "known", "--iou", "0.3..0.7", "--bags", "mcap")
    assert done.exit_code == 0, done.output
    facts = json.loads((tmp_path / "mini" / "sample1" / "sample.json").read_text())
    assert 0.3 <= facts["iou"]["known"] <= 0.7 and f"IoU {facts['iou']['known']:.3f} (known)" in done.stdout
    assert {"first.mcap", "second.mcap"} <= {file.name for file in (tmp_path / "mini" / "sample1").iterdir()}


def test_a_pair_that_overlaps_otherwise_is_dropped_and_after_six_the_scene_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries = []
    monkeypatch.setattr(job, "iou_of", lambda overlap, kind: tries.append(kind) or 0.05)
    done = create(tmp_path / "mini", 1, "--camera", "24x18@90", "--duration", "2..4", "--iou", "0.1..0.9")
    assert done.exit_code == 2
    assert tries == ["voxels"] * 6 and done.stderr.count("0.05") == 6
    assert [entry.name for entry in (tmp_path / "mini").iterdir()] == ["dataset.json"]
