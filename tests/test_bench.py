"""The benchmark's machinery on a tiny flat, without peers: what is compared, judged and printed; no times."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import bench
import numpy as np
import pytest
from benchmarks import (
    association_works,
    gate,
    growth,
    map_works,
    nearest_works,
    ours,
    peers_loop,
    peers_numba,
    peers_rays,
    ray_works,
    table,
)
from benchmarks.flats import FAR, NEAR, Flat, load_flat
from benchmarks.goals import GOALS
from benchmarks.rows import Row, Skipped, WrongResult, check_share, from_json, to_json
from benchmarks.setting import Setting
from benchmarks.timing import Repeats, interleaved
from benchmarks.works import WORKS
from numpy.typing import NDArray

from maomaps_warp.model.voxels import pack_keys

BENCH = Path(__file__).parent.parent / "scripts" / "bench.py"
ONCE = Repeats(most=1, least=1, budget_s=0.0)


@pytest.fixture(scope="module")
def setting(tmp_path_factory: pytest.TempPathFactory) -> Setting:
    return Setting("tiny", tmp_path_factory.mktemp("scenes"), repeats=ONCE, long=False)


@pytest.fixture(scope="module")
def flat(setting: Setting) -> Flat:
    return setting.flat


@pytest.fixture
def no_peers(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (ray_works, nearest_works):
        monkeypatch.setattr(module, "find_spec", lambda name: None)


def row(work: str = "rays", *, ours: tuple[float, ...] = (1.0,), theirs: tuple[float, ...] = (10.0,)) -> Row:
    return Row(work, "apt", "cpu", 1, "some rays", ours, "Peer" if theirs else "", theirs, "all the same")


def test_ours_and_the_peer_take_turns_after_a_round_that_is_not_timed() -> None:
    calls: list[str] = []
    names = ("ours", "peer")
    timed = interleaved(
        {name: lambda name=name: calls.append(name) or name for name in names}, Repeats(most=3, least=3, budget_s=60.0)
    )
    assert calls == [*names] * 4
    assert [timed[name].result for name in names] == [*names]
    assert all(len(timed[name].seconds) == 3 for name in names)


def test_the_least_rounds_are_run_even_if_the_budget_is_spent() -> None:
    assert len(interleaved({"ours": lambda: None}, Repeats(most=9, least=2, budget_s=0.0))["ours"].seconds) == 2


def test_a_ratio_is_that_of_the_medians_and_its_spread_that_of_the_rounds() -> None:
    measured = row(ours=(1.0, 2.0, 4.0), theirs=(12.0, 10.0, 8.0))
    assert measured.ratio == 5.0
    assert measured.spread == (2.0, 12.0)
    assert row(theirs=()).ratio is None and row(theirs=()).spread is None


def test_a_row_survives_json() -> None:
    measured = row(ours=(1.0, 2.0), theirs=(3.0, 4.0))
    assert from_json(json.loads(json.dumps(to_json(measured)))) == measured


def test_every_work_has_a_goal_and_every_goal_a_work() -> None:
    assert WORKS.keys() == GOALS.keys()


def test_the_gate_is_open_for_what_reaches_its_goal_and_the_baseline() -> None:
    assert gate.failures([row(theirs=(10.0,))], {row().key: 10.0}) == []


def test_the_gate_is_open_for_the_baseline_itself_and_shut_for_nothing() -> None:
    baseline = json.loads((Path(gate.__file__).parent / "baseline.json").read_text())["ratios"]
    rows = []
    for key, ratio in baseline.items():
        device, flat, threads, work, peer = key.split("/")
        rows.append(replace(row(work, theirs=(ratio,)), device=device, flat=flat, threads=int(threads), peer=peer))
    assert [r.key for r in rows] == list(baseline) and len(rows) > 20
    assert gate.failures(rows, baseline) == []
    for nothing in ([], [row(theirs=())]):
        (reason,) = gate.failures(nothing, baseline)
        assert "could be judged" in reason


def test_a_goal_that_the_baseline_misses_keeps_no_gate_shut() -> None:
    assert gate.failures([row(theirs=(2.0,))], {row().key: 2.5}) == []


def test_the_gate_shuts_below_the_goal() -> None:
    (reason,) = gate.failures([row(theirs=(2.9,))], {})
    assert "goal of 3x" in reason


def test_the_gate_shuts_far_below_the_baseline_and_not_a_little_below_it() -> None:
    baseline = {row().key: 20.0}
    (reason,) = gate.failures([row(theirs=(gate.BASELINE_SHARE * 20.0 - 0.1,))], baseline)
    assert "baseline's 20.00x" in reason
    assert gate.failures([row(theirs=(gate.BASELINE_SHARE * 20.0 + 0.1,))], baseline) == []


def test_the_gate_holds_seconds_only_against_a_generous_multiple_of_their_limit() -> None:
    limit = GOALS["score"].limit
    assert limit is not None
    assert gate.failures([row("score", ours=(gate.SLOWER_MACHINE * limit - 0.01,), theirs=())], {}) == []
    assert len(gate.failures([row("score", ours=(gate.SLOWER_MACHINE * limit + 0.01,), theirs=())], {})) == 1


def test_the_gate_shuts_on_memory_that_grows_with_the_recording_or_exceeds_its_limit() -> None:
    assert gate.failures([row("memory", ours=(100.0, 101.0, 100.5), theirs=())], {}) == []
    (grows,) = gate.failures([row("memory", ours=(100.0, 150.0, 200.0), theirs=())], {})
    assert "grows" in grows
    (large,) = gate.failures([row("memory", ours=(700.0, 700.0), theirs=())], {})
    assert "exceed" in large


def test_a_baseline_keeps_ratios_by_what_was_measured_and_no_times() -> None:
    assert gate.ratios([row(), row("score", theirs=())]) == {"cpu/apt/1/rays/Peer": 10.0}


def test_the_table_says_what_was_measured_and_what_was_left_out() -> None:
    text = table.table([row()], [Skipped("map-1", "numba is not installed")])
    assert "| rays | Peer | 1 | 1.00 s | 10.00 s | 10.0x | 10.0x..10.0x | 3.0x | 6.0x |" in text
    assert "- rays (Peer): some rays; all the same" in text
    assert "- map-1: left out: numba is not installed" in text


def test_too_large_a_share_of_different_results_is_an_error() -> None:
    assert check_share("hits", 1, 1000, 1e-3) == "hits: 1 of 1000 differ"
    with pytest.raises(WrongResult, match="2 of 1000"):
        check_share("hits", 2, 1000, 1e-3)


def test_a_flat_is_made_once_and_read_again(setting: Setting, flat: Flat) -> None:
    (folder,) = setting.scenes.iterdir()
    again = load_flat("tiny", setting.scenes)
    assert list(setting.scenes.iterdir()) == [folder]
    np.testing.assert_array_equal(again.est_map.ijk, flat.est_map.ijk)
    np.testing.assert_array_equal(again.depth, flat.depth)
    assert len(flat.gt) == len(flat.est) == len(flat.depth) and not np.array_equal(
        flat.gt.positions, flat.est.positions
    )


def test_the_voxel_map_is_compared_with_the_loop_over_points(setting: Setting) -> None:
    (measured,) = map_works.against_loop(setting)
    assert measured.ratio is not None
    compared = re.search(r"points by voxel: (?:all|\d+ of) (\d+)", measured.agreement)
    assert compared is not None and int(compared[1]) > 1000


def test_a_map_that_lost_points_is_wrong(setting: Setting, monkeypatch: pytest.MonkeyPatch) -> None:
    build: Any = ours.map_of_frames

    def lossy(*args: object) -> object:
        voxels = build(*args)
        return replace(voxels, ijk=voxels.ijk[20:], counts=voxels.counts[20:])

    monkeypatch.setattr(ours, "map_of_frames", lossy)
    with pytest.raises(WrongResult, match="points by voxel"):
        list(map_works.against_loop(setting))


def test_the_peer_for_numba_gives_the_same_map_when_it_is_run_by_python(flat: Flat) -> None:
    depth, colors, poses = np.array(flat.depth[:1]), np.array(flat.colors[:1]), flat.gt.T_world_camera[:1].copy()
    counts = peers_loop.map_of_frames([(depth[0], colors[0], poses[0])], flat.camera, 0.05, NEAR, FAR)
    grid = flat.gt_map.grid
    poses[:, :3, 3] -= grid.origin
    keys, samples, means = peers_numba.map_of_frames(
        peers_numba._integrate, depth, colors, poses, flat.camera, grid, (NEAR, FAR), len(counts)
    )
    cells = np.array(list(counts)) - grid.origin_ijk
    order = np.argsort(pack_keys(cells))
    np.testing.assert_array_equal(keys, pack_keys(cells)[order])
    np.testing.assert_array_equal(samples, np.array(list(counts.values()))[order])
    total = colors.reshape(-1, 3).astype(float).sum(axis=0)
    # Means are truncated: each of them lies less than one level below the exact one.
    assert np.all(np.abs((means * samples[:, None]).sum(axis=0) - total) <= samples.sum())


def test_the_mesh_of_two_neighbours_has_ten_faces_that_look_at_their_voxels() -> None:
    mesh = peers_rays.voxel_mesh(np.array([[0, 0, 0], [1, 0, 0]], dtype=np.int32), 0.5)
    assert len(mesh.triangles) == 20 and sorted(np.bincount(mesh.voxel)) == [10, 10]
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(10 * 0.5**2)
    assert mesh.vertices.min(axis=0).tolist() == [-0.25, -0.25, -0.25]


def _hits(flat: Flat) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    import warp as wp

    origins, directions = ray_works.scorer_rays(flat)
    field = ours.ray_field(flat.gt_map, "cpu")
    starts, ways = (wp.array(rays, dtype=wp.vec3, device="cpu") for rays in (origins, directions))
    return origins, directions, ours.cast(field, starts, ways, 1)


def test_hits_are_held_against_the_triangles_that_a_peer_found(flat: Flat) -> None:
    origins, directions, hits = _hits(flat)
    mesh = peers_rays.voxel_mesh(flat.gt_map.ijk, flat.gt_map.grid.voxel_size)
    first = np.zeros(len(flat.gt_map), dtype=np.int64)
    first[mesh.voxel[::-1]] = np.arange(len(mesh.voxel))[::-1]  # the first triangle of each voxel
    triangles = np.where(hits >= 0, first[hits], 2**32 - 1)
    assert len(hits) > 1000 and "all" in ray_works.compare_hits(flat, origins, directions, hits, mesh, triangles)
    with pytest.raises(WrongResult, match="hits"):
        ray_works.compare_hits(flat, origins, directions, hits, mesh, np.roll(triangles, 1))


def test_rays_are_left_out_where_no_peer_is_installed(setting: Setting, no_peers: None) -> None:
    for work in (ray_works.casting, ray_works.building):
        assert [entry.reason for entry in work(setting) if isinstance(entry, Skipped)] == [
            "open3d is not installed",
            "embreex is not installed",
        ]


@pytest.mark.parametrize("work", [nearest_works.on_lattice, nearest_works.of_free_clouds, nearest_works.apart])
def test_nearest_neighbours_are_compared_with_scipy_where_pykdtree_is_missing(
    setting: Setting, no_peers: None, work: nearest_works.Measure
) -> None:
    left_out, measured = work(setting)
    assert isinstance(left_out, Skipped) and "pykdtree" in left_out.reason
    assert isinstance(measured, Row) and measured.peer == "SciPy" and "differ by at most" in measured.agreement


def test_a_wrong_distance_is_an_error(setting: Setting, no_peers: None, monkeypatch: pytest.MonkeyPatch) -> None:
    find = ours.distances
    monkeypatch.setattr(ours, "distances", lambda *args: find(*args) + 1e-6)
    with pytest.raises(WrongResult, match="SciPy"):
        list(nearest_works.on_lattice(setting))


def test_association_is_compared_with_the_plain_kernels(setting: Setting) -> None:
    for work in (association_works.nearest_pose, association_works.every_pose):
        (measured,) = work(setting)
        assert "correspondences" in measured.agreement and measured.ratio is not None


def test_other_correspondences_are_an_error(flat: Flat) -> None:
    found = ours.build_and_associate(flat, "nearest", "cpu")
    assert "the same" in association_works.compare(found, found)
    with pytest.raises(WrongResult, match="correspondences"):
        association_works.compare(found, replace(found, gt_index=np.roll(found.gt_index, 1)))
    with pytest.raises(WrongResult, match="classes"):
        association_works.compare(found, replace(found, classes=(found.classes + 1) % 4))


def test_two_threads_are_measured_only_where_there_are_two(setting: Setting) -> None:
    (left_out,) = association_works.threads_nearest(setting)
    assert isinstance(left_out, Skipped)
    (measured,) = association_works.threads_nearest(replace(setting, threads=2))
    assert isinstance(measured, Row) and measured.agreement == "the same, bit for bit"


def test_the_exponent_of_a_power_law_is_found() -> None:
    sizes = [10, 100, 1000]
    assert growth.exponent(sizes, [3e-6 * n**1.5 for n in sizes]) == pytest.approx(1.5)


def test_the_script_measures_a_work_prints_it_and_writes_it(setting: Setting, tmp_path: Path) -> None:
    assert setting.flat.name == "tiny"
    command = [sys.executable, str(BENCH), "--quick", "--flat", "tiny", "--scenes", str(setting.scenes)]
    command += ["--threads", "1", "--only", "associate", "--json", str(tmp_path / "out.json")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "| associate | plain kernels, mesh | 1 |" in done.stdout
    document = json.loads((tmp_path / "out.json").read_text())
    assert [entry["work"] for entry in document["rows"]] == ["associate"] and document["failed"] == []
    assert document["versions"].keys() >= {"python", "warp-lang", "numpy"} and "processor" in document["machine"]


@pytest.mark.parametrize(
    ("theirs", "wrong", "options", "code"),
    [(10.0, [], ["--gate"], 0), (2.0, [], ["--gate"], 1), (2.0, [], [], 0), (10.0, ["rays: wrong"], [], 1)],
)
def test_the_script_fails_on_a_missed_goal_with_the_gate_and_on_a_wrong_result_always(
    setting: Setting,
    monkeypatch: pytest.MonkeyPatch,
    theirs: float,
    wrong: list[str],
    options: list[str],
    code: int,
) -> None:
    monkeypatch.setattr(bench.children, "measure", lambda *args: ([row(theirs=(theirs,))], [], wrong))
    words = ["bench.py", "--flat", "tiny", "--scenes", str(setting.scenes), "--only", "rays", *options]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as exit_info:
        bench.main()
    assert exit_info.value.code == code
