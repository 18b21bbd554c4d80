"""Two overlapping runs as bags, made of the real TUM recording: poses at 100 Hz whose stamps no image shares."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bags
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation
from shared_data import shared_data

from maomaps_warp.model.camera import Camera

TUM = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
#: Every fourth pixel of the real images; pixel (0, 0) stays the centre of the first pixel.
SMALL = Camera(160, 120, 525.0 / 4, 525.0 / 4, 319.5 / 4, 239.5 / 4)
#: First and one past the last of the hundred frames of each run.
RUNS = {"first": (0, 60), "second": (40, 100)}

RGB_TOPIC, DEPTH_TOPIC = "/camera/rgb/image_raw", "/camera/depth/image_raw"
INFO_TOPIC, POSE_TOPIC = "/camera/depth/camera_info", "/pose"


@dataclass(frozen=True)
class TumFrames:
    """The recording in arrays: stamps (N,) int64 ns, depth (N, H, W) float32 metres, colours (N, H, W, 3), and
    the motion capture's stamps (M,) int64 ns and T_world_camera (M, 4, 4)."""

    stamps_ns: NDArray[np.int64]
    depth: NDArray[np.float32]
    colors: NDArray[np.uint8]
    pose_stamps_ns: NDArray[np.int64]
    T_world_camera: NDArray[np.float64]


def read_tum(stride: int = 4) -> TumFrames:
    """Read the recording without our readers, every `stride`-th pixel; skips the test where it is absent."""
    folder = shared_data("rgbd_tum_fr1_rpy_a")
    rows = [line.split() for line in (folder / "associations.txt").read_text().splitlines() if line[:1] != "#"]
    stamps = np.array([_ns(row[0]) for row in rows])
    depth = [np.asarray(Image.open(folder / row[1]))[::stride, ::stride] for row in rows]
    colors = [np.asarray(Image.open(folder / row[3]).convert("RGB"))[::stride, ::stride] for row in rows]
    lines = [line.split() for line in (folder / "groundtruth.txt").read_text().splitlines() if line[:1] != "#"]
    values = np.array([[float(word) for word in line[1:]] for line in lines])
    T = np.tile(np.eye(4), (len(values), 1, 1))
    T[:, :3, :3] = Rotation.from_quat(values[:, 3:]).as_matrix()
    T[:, :3, 3] = values[:, :3]
    return TumFrames(
        stamps, (np.stack(depth) / 5000).astype(np.float32), np.stack(colors), np.array([_ns(x[0]) for x in lines]), T
    )


def write_run(path: Path, kind: bags.BagKind, frames: TumFrames, run: str, camera: Camera = SMALL) -> Path:
    """Write one run as a bag: depth (32FC1), colours, camera_info, and the motion capture's poses around it."""
    first, end = RUNS[run]
    stamps = frames.stamps_ns[first:end].tolist()
    margin = 200_000_000
    near = (frames.pose_stamps_ns > stamps[0] - margin) & (frames.pose_stamps_ns < stamps[-1] + margin)
    entries = bags.pose_messages(kind, POSE_TOPIC, frames.pose_stamps_ns[near].tolist(), frames.T_world_camera[near])
    for stamp, depth, colors in zip(stamps, frames.depth[first:end], frames.colors[first:end], strict=True):
        entries += [
            (INFO_TOPIC, stamp, bags.camera_info(kind, stamp, camera)),
            (RGB_TOPIC, stamp, bags.color_message(kind, stamp, colors)),
            (DEPTH_TOPIC, stamp, bags.depth_message(kind, stamp, depth)),
        ]
    return bags.write_bag(path, kind, sorted(entries, key=lambda entry: entry[1]))


def write_sample_bags(folder: Path, kind: bags.BagKind = "ros1") -> dict[str, Path]:
    """Both runs as bags in `folder`, by name."""
    frames = read_tum()
    written = {}
    for run in RUNS:
        (folder / run).mkdir()
        written[run] = write_run(bags.bag_path(folder / run, kind), kind, frames, run)
    return written


def _ns(seconds: str) -> int:
    whole, _, fraction = seconds.partition(".")
    return int(whole) * 1_000_000_000 + int(fraction.ljust(9, "0")[:9])
