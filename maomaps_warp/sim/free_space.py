"""Where a robot can go in a world."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.sim.world import World
from maomaps_warp.threads import thread_count

#: Heights are counted in bins so thick, metres.
_FLOOR_BIN_M = 0.02
#: Faces are level if their normal's z is above this: 2.5 degrees.
_LEVEL = 0.999
#: The floor is the lowest level whose area is at least this share of the largest, and at least so many square metres.
_FLOOR_SHARE, _LEAST_FLOOR_M2 = 0.3, 1.0


#: A robot is a stack of balls of its radius: thinner ones would take very many.
_LEAST_RADIUS_M = 0.02


@dataclass(frozen=True)
class Robot:
    """A robot with a camera; metres.

    Attributes:
        radius: of the circle it needs.
        height: of its top above the floor.
        camera_height: of the camera's centre above the floor.
        step: what it drives over, and how uneven the floor may be.
    """

    radius: float = 0.18
    height: float = 1.3
    camera_height: float = 1.0
    step: float = 0.05

    def __post_init__(self) -> None:
        if not (
            _LEAST_RADIUS_M <= self.radius < np.inf and 0.0 < self.step < self.camera_height <= self.height < np.inf
        ):
            least = f"of at least {_LEAST_RADIUS_M:g} m"
            raise ValueError(f"a robot needs a radius {least}, and 0 < step < camera_height <= height: {self}")


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """The places that a robot can reach from one another, on a grid.

    Attributes:
        lower: (2,) float64, x and y of the middle of the first cell, metres.
        cell: metres.
        is_free: (nx, ny) bool: one connected region (over edges of cells).
        floor_z: metres.
    """

    lower: NDArray[np.float64]
    cell: float
    is_free: NDArray[np.bool_]
    floor_z: float

    @property
    def area(self) -> float:
        """Square metres."""
        return float(self.is_free.sum()) * self.cell**2

    def cell_of(self, place: NDArray[np.float64]) -> NDArray[np.int64]:
        """Cells of places, (..., 2) metres; they may lie outside."""
        return np.rint((place - self.lower) / self.cell).astype(np.int64)

    def place_of(self, cell: NDArray[np.int64]) -> NDArray[np.float64]:
        """Middles of cells, (..., 2) metres."""
        return np.asarray(self.lower + self.cell * cell)

    def holds(self, places: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the places, (N, 2) metres, are free."""
        cells = self.cell_of(places)
        inside = ((cells >= 0) & (cells < self.is_free.shape)).all(axis=1)
        free = np.zeros(len(places), dtype=bool)
        free[inside] = self.is_free[tuple(cells[inside].T)]
        return free

    def nearest(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """The middle of the free cell nearest to a place, (2,) metres."""
        middles = self.place_of(np.argwhere(self.is_free))
        return np.asarray(middles[np.square(middles - place).sum(axis=1).argmin()])


def find_free_space(
    world: World,
    robot: Robot,
    *,
    around: NDArray[np.float64] | None = None,
    cell: float = 0.05,
    floor_z: float | None = None,
    device: str = "cpu",
) -> FreeSpace:
    """Find where a robot can go.

    Args:
        world: the scene.
        robot: its size.
        around: (2,) metres; the region that holds this place is taken, if it is free, else the largest.
        cell: of the grid, metres.
        floor_z: height of the floor, metres; then a place needs no surface there. None: found.
        device: Warp device.

    Raises:
        InputError: no floor is found, or the robot fits nowhere.
    """
    import warp as wp
    from scipy import ndimage

    from maomaps_warp.kernels.robot_space import RobotShape, find_free_places

    lowest, highest = world.bounds[:, 2]
    if floor_z is not None and not lowest - robot.height <= floor_z <= highest:
        found = f"reaches from {lowest:.2f} to {highest:.2f} m: no floor lies at {floor_z:g} m"
        raise InputError(world.source, found, "--floor says the floor's height, metres, in the scene's own frame")
    shape = RobotShape()
    shape.floor_z = find_floor(world) if floor_z is None else floor_z
    shape.needs_floor = floor_z is None
    shape.radius, shape.step = robot.radius, robot.step
    shape.lowest = robot.step + robot.radius
    shape.highest = max(robot.height - robot.radius, shape.lowest)
    shape.balls = int(np.ceil((shape.highest - shape.lowest) / robot.radius)) + 1
    low, high = world.bounds[:, :2]
    count = np.floor((high - low) / cell).astype(int) + 1
    x, y = (low[a] + cell * np.arange(count[a]) for a in range(2))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    mesh = wp.Mesh(
        points=wp.array(world.vertices, dtype=wp.vec3f, device=device),
        indices=wp.array(world.triangles.reshape(-1), dtype=wp.int32, device=device),
    )
    on_device = wp.array(places.astype(np.float32), dtype=wp.vec2, device=device)

    def free_places() -> NDArray[np.bool_]:
        found = find_free_places(mesh, shape, on_device, threads=thread_count(device))
        return np.asarray(found.numpy().reshape(count) != 0)

    free = free_places()
    if not free.any():
        size = f"a robot {2 * robot.radius:.3g} m wide and {robot.height:.3g} m high"
        if shape.needs_floor:
            shape.needs_floor = False
            if free_places().any():
                found = f"{size} fits nowhere where a surface lies at the floor's height, {shape.floor_z:.2f} m"
                raise InputError(world.source, found, f"--floor {shape.floor_z:.2f} lets it go without one")
        hint = "give a smaller robot (--radius, --robot-height), or --floor if the floor was found in a wrong place"
        raise InputError(world.source, f"{size} fits nowhere (floor at {shape.floor_z:.2f} m)", hint)
    regions, _ = ndimage.label(free)
    space = FreeSpace(low.astype(np.float64), cell, free, float(shape.floor_z))
    region = 1 + int(np.bincount(regions.reshape(-1))[1:].argmax())
    if around is not None and space.holds(around[None])[0]:
        region = int(regions[tuple(space.cell_of(around))])
    return replace(space, is_free=regions == region)


def find_floor(world: World) -> float:
    """Height of the floor: the lowest level with much of the scene's level surface, facing upwards or not; metres.

    Raises:
        InputError: nothing level.
    """
    a, b, c = (world.vertices[world.triangles[:, k]].astype(np.float64) for k in range(3))
    normal = np.cross(b - a, c - a)
    area = 0.5 * np.linalg.norm(normal, axis=1)
    is_level = np.abs(normal[:, 2]) > _LEVEL * 2.0 * np.maximum(area, 1e-12)
    height = (a[:, 2] + b[:, 2] + c[:, 2])[is_level] / 3.0
    hint = "--floor Z says at which height it is"
    if not len(height):
        raise InputError(world.source, "has no floor: none of its faces is level", hint)
    bins = np.floor((height - height.min()) / _FLOOR_BIN_M).astype(int)
    areas = np.bincount(bins, area[is_level])
    # The ceiling is as large, and the box under a floor has a lower side: the first large one with room above it.
    large = np.flatnonzero((areas >= _FLOOR_SHARE * areas.max()) & (areas >= _LEAST_FLOOR_M2))
    if not len(large):
        raise InputError(world.source, f"has no floor: its largest level is of {areas.max():.2g} m2", hint)
    lowest = large[0]
    for other in large[1:]:
        if (other - lowest) * _FLOOR_BIN_M > 0.3:  # no slab is thicker
            break
        lowest = other
    return float(np.average(height[bins == lowest], weights=area[is_level][bins == lowest]))
