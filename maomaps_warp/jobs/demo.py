"""The demonstration's recording: a flat, a drive through it, bags, and a disturbed estimate of both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from maomaps_warp.errors import InputError
from maomaps_warp.io.clouds import write_pcd
from maomaps_warp.io.sources import Source
from maomaps_warp.io.trajectories import write_tum
from maomaps_warp.map_building import build_side
from maomaps_warp.model.alignment import Alignment
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.protocol import PRESETS
from maomaps_warp.sim.agent import drive
from maomaps_warp.sim.recorder import write_rgbd_bag
from maomaps_warp.sim.render import in_memory, render_frames
from maomaps_warp.sim.scene import furnished_flat
from maomaps_warp.sim.slam import SlamDisturbance, disturbed_frames, disturbed_trajectory, kept_poses
from maomaps_warp.stopwatch import Stopwatch

#: Pixels. Half of the data set's size each way: the demonstration has a minute on two cores, compilation included.
IMAGE_SIZE = (160, 120)


@dataclass(frozen=True)
class DemoFiles:
    """What the demonstration wrote.

    Attributes:
        ros1_bag: ground truth as a ROS 1 bag: depth, colour, camera_info, pose.
        mcap_bag: the same as a ROS 2 bag folder with MCAP storage.
        est_map: the estimate's map, PCD.
        est_trajectory: the estimate's trajectory, TUM format.
    """

    ros1_bag: Path
    mcap_bag: Path
    est_map: Path
    est_trajectory: Path


def make_demo(folder: Path, *, frames: int, seed: int, device: str, clock: Stopwatch) -> DemoFiles:
    """Record a drive through a furnished flat, and what a SLAM method would have made of it.

    Args:
        folder: an existing, empty folder.
        frames: length of the recording, at 10 Hz.
        seed: of the flat and of the disturbance.
        device: Warp device that renders and maps.
        clock: collects the stages' times.

    Raises:
        InputError: the folder cannot be written to.
    """
    files = DemoFiles(folder / "gt.bag", folder / "gt_mcap", folder / "est_map.pcd", folder / "est_trajectory.txt")
    with clock.stage("render"):
        scene = furnished_flat(seed)
        try:
            gt = drive(scene, frames=frames, seed=seed)
        except ValueError as error:
            raise InputError(f"--frames {frames}", f"too few for a round through the flat: {error}") from None
        stream = in_memory(render_frames(scene.world, Camera.from_fov(*IMAGE_SIZE, 90.0), gt, device))
    with clock.stage("write bags"):
        write_rgbd_bag(files.ros1_bag, stream, gt, kind="ros1")
        write_rgbd_bag(files.mcap_bag, stream, gt, kind="ros2")
    disturbance = SlamDisturbance(seed=seed)
    est, kept = disturbed_trajectory(gt, disturbance), kept_poses(gt, disturbance)
    source = Source("simulated SLAM", "simulation", est, frames=disturbed_frames(stream, disturbance, kept))
    rules = PRESETS["maomaps"]
    grid = VoxelGrid.around(est.positions, rules.voxel_size)
    built = build_side("SLAM's own map", source, Alignment(), grid, rules, device, clock, with_colors=True)
    write_pcd(files.est_map, built.points, built.voxels.colors)
    write_tum(files.est_trajectory, est)
    return files
