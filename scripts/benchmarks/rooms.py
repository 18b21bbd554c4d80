"""Buildings of square rooms with furniture and doors, and a walk through all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim import furniture as make
from maomaps_warp.sim.solids import Color, Solid, box, cylinder, merged, placed

#: Metres: edge of a room, clear height, half of a wall, opening of a door, camera above the floor.
ROOM = 4.0
CEILING = 2.7
HALF_WALL = 0.05
DOOR_WIDTH, DOOR_HEIGHT = 1.0, 2.1
CAMERA_HEIGHT = 1.2
#: Pieces that are tried in each room; one that would stand within DOOR_CLEARANCE metres of a door is left out.
PIECES = 7
DOOR_CLEARANCE = 1.0
#: The gaze swings by this to both sides, radians, once in so many frames.
SWING, SWING_FRAMES = 0.9, 60

PAINT: Color = (214, 208, 196)
WOOD: Color = (168, 124, 82)

Place = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Building:
    """A coloured mesh and a way through it.

    Attributes:
        vertices: (V, 3) float32, metres, z up.
        triangles: (F, 3) int32.
        face_colors: (F, 3) uint8 RGB.
        way: (W, 2) float64, metres: corners of a way through every room, by the doors.
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    face_colors: NDArray[np.uint8]
    way: NDArray[np.float64]


def furnished_building(columns: int, rows: int, seed: int) -> Building:
    """`columns` x `rows` rooms, each furnished at random along its walls; the same seed gives the same arrays."""
    rng = np.random.default_rng(seed)
    solids = _shell(columns * ROOM, rows * ROOM)
    doors: dict[tuple[int, int, str], Place] = {}
    for i in range(columns):
        for j in range(rows):
            if i:
                doors[i, j, "x"] = (i * ROOM, _wall_with_door(solids, rng, (i, j), "x"))
            if j:
                doors[i, j, "y"] = (_wall_with_door(solids, rng, (i, j), "y"), j * ROOM)
    for i in range(columns):
        for j in range(rows):
            solids += _furniture(rng, i * ROOM, j * ROOM, list(doors.values()))
    return Building(*merged(solids), _way(columns, rows, doors))


def _shell(width: float, depth: float) -> list[Solid]:
    t = 0.1
    return [
        box((-t, -t, -t), (width + t, depth + t, 0), WOOD),
        box((-t, -t, CEILING), (width + t, depth + t, CEILING + t), make.WHITE),
        box((-t, -t, 0), (0, depth + t, CEILING), PAINT),
        box((width, -t, 0), (width + t, depth + t, CEILING), PAINT),
        box((0, -t, 0), (width, 0, CEILING), PAINT),
        box((0, depth, 0), (width, depth + t, CEILING), PAINT),
    ]


def _wall_with_door(solids: list[Solid], rng: np.random.Generator, room: tuple[int, int], across: str) -> float:
    """Add the wall before a room; the middle of its door along the wall, metres."""
    at, start = (room[0] * ROOM, room[1] * ROOM) if across == "x" else (room[1] * ROOM, room[0] * ROOM)
    left = start + rng.uniform(1.0, ROOM - 2.0)
    right = left + DOOR_WIDTH
    for a, b, low in ((start, left, 0.0), (right, start + ROOM, 0.0), (left, right, DOOR_HEIGHT)):
        corners = ((at - HALF_WALL, a), (at + HALF_WALL, b))
        near, far = corners if across == "x" else ((a, at - HALF_WALL), (b, at + HALF_WALL))
        solids.append(box((*near, low), (*far, CEILING), PAINT))
    return left + DOOR_WIDTH / 2


def _furniture(rng: np.random.Generator, x: float, y: float, doors: list[Place]) -> list[Solid]:
    """Pieces with their backs to the walls of the room whose corner is (x, y), a lamp and a picture."""
    middle = (x + ROOM / 2, y + ROOM / 2)
    solids = placed(make.pendant_lamp(CEILING), *(c + rng.uniform(-0.8, 0.8) for c in middle))
    solids += placed(make.picture(1.0, 0.7, rng), middle[0], y + ROOM - HALF_WALL, z=1.2)
    for _ in range(PIECES):
        width, wall, along = rng.uniform(0.4, 1.3), int(rng.integers(4)), rng.uniform(-1.2, 1.2)
        out = ROOM / 2 - HALF_WALL
        # The four walls: far y, far x, near y, near x; a piece's back is at its y = 0, its body at y < 0.
        dx, dy, yaw = ((along, out, 0.0), (out, along, -np.pi / 2), (along, -out, np.pi), (-out, along, np.pi / 2))[
            wall
        ]
        place = (middle[0] + dx, middle[1] + dy)
        if all(np.hypot(place[0] - a, place[1] - b) > DOOR_CLEARANCE for a, b in doors):
            solids += placed(_piece(rng, width), *place, yaw)
    return solids


def _piece(rng: np.random.Generator, width: float) -> list[Solid]:
    depth, height = rng.uniform(0.3, 0.7), rng.uniform(0.4, 2.0)
    if height > 1.3:
        return make.shelf(width, height, 5, WOOD, rng)
    if height > 0.9:
        return make.cabinet(width, depth, height, 2, PAINT)
    mugs = [
        cylinder((rng.uniform(-width, width) * 0.4, -depth * rng.uniform(0.2, 0.8)), r, height, height + 3 * r, PAINT)
        for r in rng.uniform(0.03, 0.08, 3)
    ]
    return [*make.table(width, depth, height, WOOD), *mugs]


def _way(columns: int, rows: int, doors: dict[tuple[int, int, str], Place]) -> NDArray[np.float64]:
    """Row by row, to and fro, past two points of each room."""
    way: list[Place] = []
    last: tuple[int, int] | None = None
    for j in range(rows):
        for i in range(columns)[:: -1 if j % 2 else 1]:
            if last is not None:
                way.append(doors[max(i, last[0]), max(j, last[1]), "x" if i != last[0] else "y"])
            x, y = (i + 0.5) * ROOM, (j + 0.5) * ROOM
            way += [(x - 0.5, y - 0.4), (x + 0.5, y + 0.3)]
            last = i, j
    return np.array(way)


def walk(way: NDArray[np.float64], frames: int) -> Trajectory:
    """Optical poses at even steps along a way, its corners rounded, the gaze swinging to both sides; at 10 Hz."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], frames)
    x, y = (_smooth(np.interp(at, along, way[:, axis]), frames // 40) for axis in range(2))
    heading = _smooth(np.unwrap(np.arctan2(np.gradient(y), np.gradient(x))), frames // 30)
    index = np.arange(frames)
    yaw = heading + SWING * np.sin(2.0 * np.pi * index / SWING_FRAMES)
    c, s, zero = np.cos(yaw), np.sin(yaw), np.zeros(frames)
    poses = np.tile(np.eye(4), (frames, 1, 1))
    right, down, forward = (s, -c, zero), (zero, zero, zero - 1.0), (c, s, zero)
    poses[:, :3, :3] = np.stack([np.stack(axis, axis=1) for axis in (right, down, forward)], axis=2)
    poses[:, :3, 3] = np.stack([x, y, CAMERA_HEIGHT + 0.01 * np.sin(index / 7.0)], axis=1)
    return Trajectory(poses, 1_700_000_000_000_000_000 + index.astype(np.int64) * 100_000_000, "walk", "world")


def _smooth(track: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """The moving mean over 2 * reach + 1 values."""
    kernel = np.full(2 * reach + 1, 1.0 / (2 * reach + 1))
    return np.convolve(np.pad(track, reach, mode="edge"), kernel, "valid")
