"""Measure that the memory of mapping does not grow with the length of a recording.

Two ways, each length in a process of its own, whose peak resident memory is read at its end:

- frames: frames from a generator into `mapping.voxel_map.build_voxel_map`, colours averaged;
- bag: the whole job of `maomaps-warp map` on a bag that is written first, in another process, and removed afterwards.

    python scripts/bench_map_memory.py [--quick] [--kind ros1|mcap] [--json FILE]

The camera drives the same round through a furnished flat again and again, so that the map stops growing early and what
is left to grow is what keeps frames, or lists of them. The bag's poses come with the frames, at 30 Hz.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

LENGTHS = (2_000, 5_000, 10_000, 20_000)
QUICK_LENGTHS = (200, 500, 1_000, 2_000)
#: Frames of a round, and their size in pixels.
ROUND = 200
IMAGE_SIZE = (128, 96)
FRAME_INTERVAL_NS = 33_333_333
VOXEL_SIZE = 0.05
#: ru_maxrss counts kilobytes on Linux and bytes on macOS.
RSS_UNIT = 1 if sys.platform == "darwin" else 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"lengths {QUICK_LENGTHS} instead of {LENGTHS}")
    parser.add_argument("--kind", choices=("ros1", "mcap"), default="ros1", help="of the bag")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    parser.add_argument("--child", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(_CHILDREN[options.child[0]](*options.child[1:])))
        return
    document = _measure(QUICK_LENGTHS if options.quick else LENGTHS, options.kind)
    _print(document)
    if options.json is not None:
        options.json.write_text(json.dumps(document, indent=2) + "\n")


def _measure(lengths: tuple[int, ...], kind: str) -> dict[str, Any]:
    rows = []
    for frames in lengths:
        rows.append({"way": "frames", "frames": frames, **_in_process("frames", frames)})
        with tempfile.TemporaryDirectory(prefix="maomaps-bench-") as folder:
            bag = Path(folder) / ("run.bag" if kind == "ros1" else "run")
            written = _in_process("write", bag, frames, kind)
            measured = _in_process("bag", bag)
        rows.append({"way": f"bag ({kind})", "frames": frames, **measured, "bag_bytes": written["bag_bytes"]})
    packages = ("warp-lang", "numpy", "rosbags", "mcap")
    return {
        "image_size": IMAGE_SIZE,
        "round_frames": ROUND,
        "voxel_size": VOXEL_SIZE,
        "rows": rows,
        "versions": {"python": platform.python_version(), **{name: metadata.version(name) for name in packages}},
        "machine": {"system": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
    }


def _in_process(*words: object) -> dict[str, Any]:
    command = [sys.executable, __file__, "--child", *map(str, words)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def _recording(frames: int) -> tuple[Any, Any]:
    """A stream that repeats the round, colours included, and its trajectory."""
    import numpy as np

    from maomaps_warp.model.camera import Camera
    from maomaps_warp.model.frame import Frame, FrameStream
    from maomaps_warp.model.trajectory import Trajectory
    from maomaps_warp.sim.agent import drive
    from maomaps_warp.sim.render import render_frames
    from maomaps_warp.sim.scene import furnished_flat

    scene = furnished_flat(0)
    way = drive(scene, frames=ROUND, seed=0)
    camera = Camera.from_fov(*IMAGE_SIZE, 90.0)
    kept = tuple(render_frames(scene.world, camera, way).read(True))
    stamps = (1 + np.arange(frames, dtype=np.int64)) * FRAME_INTERVAL_NS

    def read(with_colors: bool) -> Iterator[Frame]:
        for index in range(frames):
            frame = replace(kept[index % ROUND], index=index, stamp_ns=int(stamps[index]))
            yield frame if with_colors else replace(frame, colors=None)

    poses = way.T_world_camera[np.arange(frames) % ROUND]
    return FrameStream(camera, frames, read, "benchmark"), Trajectory(poses, stamps)


def _map_frames(frames: str) -> dict[str, Any]:
    from maomaps_warp.mapping.voxel_map import DepthLimits, build_voxel_map
    from maomaps_warp.model.voxels import VoxelGrid

    stream, trajectory = _recording(int(frames))
    grid = VoxelGrid.around(trajectory.positions, VOXEL_SIZE)
    began = time.perf_counter()
    built = build_voxel_map(
        stream, lambda frame: trajectory.T_world_camera[frame.index], grid, DepthLimits(), colors="rounded"
    )
    return _result(len(built.voxels), began)


def _write_bag(path: str, frames: str, kind: str) -> dict[str, Any]:
    from maomaps_warp.sim.recorder import write_rgbd_bag

    stream, trajectory = _recording(int(frames))
    write_rgbd_bag(Path(path), stream, trajectory, kind="ros2" if kind == "mcap" else "ros1")
    files = [file for file in (Path(path), *Path(path).rglob("*")) if file.is_file()]
    return {"bag_bytes": sum(file.stat().st_size for file in files)}


def _map_bag(path: str) -> dict[str, Any]:
    from maomaps_warp.io.sample_writing import write_run
    from maomaps_warp.io.sources import SourceOptions
    from maomaps_warp.jobs.ground_truth import build_ground_truth, open_recording
    from maomaps_warp.map_protocol import MAP_PRESETS

    began = time.perf_counter()
    rules = MAP_PRESETS["maomaps"]
    source = open_recording(Path(path), rules, SourceOptions(pose_frame="optical"))
    truth = build_ground_truth(source, rules)
    with tempfile.TemporaryDirectory() as folder:
        write_run(Path(folder), "first", truth.voxels, truth.trajectory)
    return _result(len(truth.voxels), began)


def _result(voxels: int, began: float) -> dict[str, Any]:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * RSS_UNIT
    return {"peak_bytes": peak, "voxels": voxels, "seconds": round(time.perf_counter() - began, 1)}


_CHILDREN = {"frames": _map_frames, "write": _write_bag, "bag": _map_bag}


def _print(document: dict[str, Any]) -> None:
    print(f"{'way':<12}{'frames':>8}{'voxels':>9}{'bag MB':>9}{'peak MB':>9}{'s':>8}")
    for row in document["rows"]:
        size = f"{row['bag_bytes'] / 1e6:.0f}" if "bag_bytes" in row else ""
        peak = f"{row['peak_bytes'] / 1e6:.1f}"
        print(f"{row['way']:<12}{row['frames']:>8}{row['voxels']:>9}{size:>9}{peak:>9}{row['seconds']:>8}")
    print(
        "images", "x".join(map(str, document["image_size"])), "depth and colour, voxels of", VOXEL_SIZE, "m;", end=" "
    )
    print(", ".join(f"{name} {version}" for name, version in document["versions"].items()), end="; ")
    print(", ".join(str(value) for value in document["machine"].values()), "cores")


if __name__ == "__main__":
    main()
