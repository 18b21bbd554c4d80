"""Where a recording's images come from: our own renderer, or any other simulator behind the same small interface."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.effects import NO_EFFECTS, Effects, blurred, exposure_poses, shaken

#: Name of the depth without noise among a frame's extras.
EXACT_DEPTH = "exact_depth"


@dataclass(frozen=True, eq=False)
class Seen:
    """What a camera sees from one pose.

    Attributes:
        depth: (H, W) float32, metres along the optical axis; 0 where nothing is seen.
        colors: (H, W, 3) uint8 RGB; None where they were not asked for.
        extras: further images by name: "normals" (H, W, 3) float32, optical frame; "parts" (H, W) int32.
    """

    depth: NDArray[np.float32]
    colors: NDArray[np.uint8] | None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)


class Simulator(Protocol):
    """Pose in, images out: all that the recorder asks of a simulator."""

    @property
    def camera(self) -> Camera:
        """Pinhole intrinsics of all images; pixel (0, 0) is the centre of the first pixel."""

    @property
    def source(self) -> str:
        """What it is, for messages."""

    def see(self, T_world_camera: NDArray[np.float64], *, with_colors: bool = True) -> Seen:
        """Images from a pose.

        Args:
            T_world_camera: (4, 4), metres: the optical frame (x right, y down, z forward) in a world with z up.
            with_colors: False: the caller has no use for colours; giving them all the same does no harm.
        """


def simulated_frames(simulator: Simulator, trajectory: Trajectory, effects: Effects = NO_EFFECTS) -> FrameStream:
    """The images of a simulator along a trajectory, taken when they are read.

    Args:
        simulator: gives the images.
        trajectory: one frame a pose, with its stamp. It is the path that the camera takes, shaking included: see
            `camera_path`.
        effects: what spoils the images. Depth with noise has the exact one beside it, as the extra EXACT_DEPTH.

    Returns:
        A stream whose frames are the same, byte for byte, each time they are read, if the simulator's are.

    Raises:
        ValueError: while reading: the simulator gave images of a wrong shape or type.
    """
    stamps = trajectory.stamps_ns
    if effects.blur and stamps is None:
        raise ValueError("motion blur needs poses with stamps")

    def read(with_colors: bool) -> Iterator[Frame]:
        for index, T_world_camera in enumerate(trajectory.T_world_camera):
            seen = _checked(simulator.see(T_world_camera, with_colors=with_colors), simulator, with_colors)
            colors, depth, extras = seen.colors if with_colors else None, seen.depth, dict(seen.extras)
            if effects.blur and with_colors:
                colors = blurred([_colors(simulator, T) for T in exposure_poses(trajectory, index)])
            if effects.spoils_depth:
                extras[EXACT_DEPTH] = depth
                depth = effects.depth(depth, index, _seconds(trajectory, index))
            yield Frame(index, None if stamps is None else int(stamps[index]), depth, colors, extras)

    return FrameStream(simulator.camera, len(trajectory), read, simulator.source)


def camera_path(trajectory: Trajectory, effects: Effects) -> Trajectory:
    """The path that the camera takes on a robot on a trajectory: the same, or a shaken one."""
    return shaken(trajectory, effects.seed) if effects.shake else trajectory


def _seconds(trajectory: Trajectory, index: int) -> float:
    """Since the first pose; poses without stamps count as a tenth of a second."""
    stamps = trajectory.stamps_ns
    return 0.1 * index if stamps is None else float(stamps[index] - stamps[0]) * 1e-9


def _colors(simulator: Simulator, T_world_camera: NDArray[np.float64]) -> NDArray[np.uint8]:
    seen = _checked(simulator.see(T_world_camera), simulator, True)
    assert seen.colors is not None
    return seen.colors


def _checked(seen: Seen, simulator: Simulator, with_colors: bool) -> Seen:
    shape = (simulator.camera.height, simulator.camera.width)
    depth, colors = seen.depth, seen.colors
    if depth.shape != shape or depth.dtype != np.float32:
        raise ValueError(f"{simulator.source}: depth must be {shape} float32, got {depth.shape} {depth.dtype}")
    if not (np.isfinite(depth).all() and (depth >= 0).all()):
        raise ValueError(f"{simulator.source}: depth must be finite and not negative; 0 where nothing is seen")
    if with_colors and (colors is None or colors.shape != (*shape, 3) or colors.dtype != np.uint8):
        found = "none" if colors is None else f"{colors.shape} {colors.dtype}"
        raise ValueError(f"{simulator.source}: colors must be {(*shape, 3)} uint8, got {found}")
    return seen
