"""Coloured triangle bodies, and how they are turned, moved and merged. Metres; triangles look outwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Color = tuple[int, int, int]

#: Faces of boxes lie on multiples of this, metres; so one offset moves a whole flat off the faces of voxels.
STEP = 0.025

_BOX_TRIANGLES = np.array(
    [
        *([0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6]),
        *([0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7]),
        *([0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]),
    ],
    dtype=np.int32,
)


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed body of one colour.

    Attributes:
        vertices: (V, 3) float64, metres.
        triangles: (F, 3) int32, counter-clockwise seen from outside.
        color: RGB.
        part: what it belongs to ("chair").
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    color: Color
    part: str = ""


def box(lo: Sequence[float], hi: Sequence[float], color: Color) -> Solid:
    """An axis-aligned box between two corners, rounded to `STEP`; no edge is shorter than one step."""
    low = np.rint(np.array(lo) / STEP)
    high = np.maximum(np.rint(np.array(hi) / STEP), low + 1)
    corners = [[x, y, z] for z in (low[2], high[2]) for y in (low[1], high[1]) for x in (low[0], high[0])]
    return Solid(np.array(corners) * STEP, _BOX_TRIANGLES, color)


def lathe(center: Sequence[float], profile: Sequence[tuple[float, float]], color: Color) -> Solid:
    """A body of revolution about the vertical at `center` (x, y); `profile` is (radius, z) from below."""
    sides = 14
    angle = np.arange(sides) * (2.0 * np.pi / sides)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [np.column_stack([np.array(center[:2]) + r * circle, np.full(sides, z)]) for r, z in profile]
    bottom, top = ((*center[:2], z) for z in (profile[0][1], profile[-1][1]))
    i = np.arange(sides)
    j = (i + 1) % sides
    triangles = [np.stack([j, i, np.full(sides, sides * len(rings))], axis=1)]
    for first in range(0, sides * (len(rings) - 1), sides):
        triangles += [
            np.stack([first + i, first + j, first + sides + i], axis=1),
            np.stack([first + j, first + sides + j, first + sides + i], axis=1),
        ]
    last = sides * (len(rings) - 1)
    triangles.append(np.stack([last + i, last + j, np.full(sides, sides * len(rings) + 1)], axis=1))
    return Solid(np.vstack([*rings, bottom, top]), np.vstack(triangles).astype(np.int32), color)


def cylinder(center: Sequence[float], radius: float, low: float, high: float, color: Color) -> Solid:
    """An upright cylinder about `center` (x, y), from height `low` to `high`."""
    return lathe(center, ((radius, low), (radius, high)), color)


def ball(center: Sequence[float], radius: float, color: Color) -> Solid:
    """A sphere about `center` (x, y, z)."""
    angle = np.linspace(0.08, np.pi - 0.08, 8)
    profile = [(radius * float(np.sin(a)), center[2] - radius * float(np.cos(a))) for a in angle]
    return lathe(center, profile, color)


def lighter(color: Color, by: int) -> Color:
    """The colour with `by` added to each channel, at most 255."""
    return min(color[0] + by, 255), min(color[1] + by, 255), min(color[2] + by, 255)


def placed(solids: Sequence[Solid], x: float, y: float, yaw: float = 0.0, z: float = 0.0) -> list[Solid]:
    """The solids turned about z by `yaw` (radians), then moved."""
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return [replace(solid, vertices=solid.vertices @ turn + (x, y, z)) for solid in solids]


def named(part: str, solids: Sequence[Solid]) -> list[Solid]:
    """The solids as parts of something."""
    return [replace(solid, part=part) for solid in solids]


def mirrored(solids: Sequence[Solid], sign_x: int, sign_y: int) -> list[Solid]:
    """The solids with x and y multiplied by signs; triangles keep facing outwards."""
    order = [0, 1, 2] if sign_x * sign_y > 0 else [0, 2, 1]
    signs = (sign_x, sign_y, 1)
    return [replace(s, vertices=s.vertices * signs, triangles=s.triangles[:, order]) for s in solids]


def merged(solids: Sequence[Solid]) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8]]:
    """All solids as one mesh: vertices (V, 3), triangles (F, 3), one RGB a triangle (F, 3)."""
    first = np.cumsum([0, *(len(s.vertices) for s in solids)])
    triangles = [s.triangles + np.int32(start) for s, start in zip(solids, first, strict=False)]
    colors = [np.tile(np.array(s.color, np.uint8), (len(s.triangles), 1)) for s in solids]
    return np.vstack([s.vertices for s in solids]).astype(np.float32), np.vstack(triangles), np.vstack(colors)


def parts_of(solids: Sequence[Solid]) -> tuple[tuple[str, ...], NDArray[np.int32]]:
    """Names of the parts, in alphabetical order, and the part of each triangle of the merged mesh, (F,)."""
    names = tuple(sorted({solid.part for solid in solids}))
    numbers = np.array([names.index(solid.part) for solid in solids], dtype=np.int32)
    return names, np.repeat(numbers, [len(solid.triangles) for solid in solids])
