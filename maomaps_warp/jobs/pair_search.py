"""Two runs of a robot through a scene whose maps overlap as much as wanted.

Runs are drawn at random and mapped in a rough way: small images, few frames, large voxels. Of all pairs of those the
one is taken whose overlap comes nearest to what is wanted; what the finished maps say corrects the next guess.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.jobs.run_plan import RecordOptions, driven
from maomaps_warp.mapping.depth_samples import DepthLimits
from maomaps_warp.mapping.ground import Ground
from maomaps_warp.mapping.voxel_map import build_voxel_map
from maomaps_warp.model.dataset import OverlapFigures
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.scoring.overlap import map_overlap
from maomaps_warp.sim.free_space import FreeSpace
from maomaps_warp.sim.planning import Planner
from maomaps_warp.sim.render import MeshSimulator, RenderOptions
from maomaps_warp.sim.simulator import simulated_frames
from maomaps_warp.sim.world import World

#: Of what the overlap is taken: voxels, or columns of the projections, known or occupied.
IouKind = Literal["voxels", "known", "obstacle"]

#: The rough maps: voxels so much larger, images so much smaller, and so many of them a second.
_COARSER, _SMALLER, _RATE_HZ = 2.0, 2, 2.0
#: So near to what is wanted a pair is good enough; so many runs are drawn at most.
_NEAR_ENOUGH, _MOST_RUNS = 0.02, 24


@dataclass(frozen=True, eq=False)
class PlannedRun:
    """A run that could be recorded.

    Attributes:
        number: of the draw, from 0.
        trajectory: the camera's poses.
        points: (N, 3) float64, metres: voxel centres of its rough map.
    """

    number: int
    trajectory: Trajectory
    points: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlannedPair:
    """Two runs, and how much their finished maps should overlap."""

    first: PlannedRun
    second: PlannedRun
    expected_iou: float


class PairSearch:
    """Draws runs through one scene, and finds pairs of them.

    Args:
        world: the scene.
        space: where the robot can go.
        options: the robot, its camera and how it drives.
        duration: shortest and longest run, seconds.
        kind: of overlap.
        voxel_size: of the finished maps, metres.
        max_range: of their depth, metres.
        seed: of every draw, together with the run's number.
        device: Warp device.
    """

    def __init__(
        self,
        world: World,
        space: FreeSpace,
        options: RecordOptions,
        *,
        duration: tuple[float, float],
        kind: IouKind,
        voxel_size: float,
        max_range: float,
        seed: tuple[int, ...],
        device: str,
    ) -> None:
        self.runs: list[PlannedRun] = []
        self._space, self._planner, self._options = space, Planner(space), options
        self._duration, self._kind, self._seed, self._device = duration, kind, seed, device
        self._voxel_size, self._max_range = _COARSER * voxel_size, max_range
        self._simulator = MeshSimulator(
            world,
            options.camera.resized(max(1, options.camera.width // _SMALLER), max(1, options.camera.height // _SMALLER)),
            device,
            RenderOptions(are_back_faces_seen=options.render.are_back_faces_seen),
            has_colors=False,
        )
        # One lattice for all runs, so that their voxels can be compared.
        middle = np.append(space.place_of(self._planner.cells).mean(axis=0), space.floor_z)
        self._grid = VoxelGrid.around(middle[None], self._voxel_size)
        self._rough: dict[tuple[int, int], float] = {}
        self._tried: set[tuple[int, int]] = set()
        self._correction = 1.0

    def pair(self, wanted: float, allowed: tuple[float, float]) -> PlannedPair:
        """The best pair that was not tried yet.

        Args:
            wanted: overlap that it should have.
            allowed: lowest and highest; a pair that is expected to lie outside is only taken when no more runs are
                drawn and none is expected inside.
        """

        def misses(key: tuple[int, int]) -> tuple[bool, float]:
            expected = self._expected(key)
            return not allowed[0] <= expected <= allowed[1], abs(expected - wanted)

        while True:
            best = min((key for key in self._rough if key not in self._tried), key=misses, default=None)
            if best is not None:
                is_outside, distance = misses(best)
                if len(self.runs) >= _MOST_RUNS or (not is_outside and distance <= _NEAR_ENOUGH):
                    self._tried.add(best)
                    return PlannedPair(self.runs[best[0]], self.runs[best[1]], self._expected(best))
            self._draw()

    def learn(self, pair: PlannedPair, iou: float) -> None:
        """What the overlap of a pair's finished maps was."""
        rough = self._rough[pair.first.number, pair.second.number]
        if rough > 0.0 and iou > 0.0:
            self._correction = iou / rough

    def _expected(self, key: tuple[int, int]) -> float:
        return min(1.0, self._correction * self._rough[key])

    def _draw(self) -> None:
        """One more run, and its overlap with each of the others."""
        number = len(self.runs)
        rng = np.random.default_rng([*self._seed, number])
        duration = rng.uniform(*self._duration)
        start = self._space.place_of(self._planner.cells[rng.integers(len(self._planner.cells))])
        way = self._planner.exploration(start, self._options.driving.speed * duration, int(rng.integers(1 << 31)))
        trajectory = driven(way, self._space, self._options, duration)
        run = PlannedRun(number, trajectory, self._rough_map(trajectory))
        for other in self.runs:
            self._rough[other.number, number] = self._overlap(other, run)
        self.runs.append(run)

    def _overlap(self, a: PlannedRun, b: PlannedRun) -> float:
        ground = Ground(self._space.floor_z, True, "given")
        return iou_of(map_overlap([a.points, b.points], self._voxel_size, ground), self._kind)

    def _rough_map(self, trajectory: Trajectory) -> NDArray[np.float64]:
        every = max(1, round(self._options.driving.rate_hz / _RATE_HZ))
        few = trajectory.select(np.arange(0, len(trajectory), every))
        built = build_voxel_map(
            simulated_frames(self._simulator, few),
            lambda frame: few.T_world_camera[frame.index],
            self._grid,
            DepthLimits(max_range=self._max_range),
            device=self._device,
        )
        return built.voxels.points


def iou_of(overlap: OverlapFigures, kind: IouKind) -> float:
    """One of the figures; 0 where there is nothing to compare."""
    value = {"voxels": overlap.voxel_iou, "known": overlap.known_iou, "obstacle": overlap.obstacle_iou}[kind]
    return value or 0.0
