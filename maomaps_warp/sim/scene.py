"""A furnished flat of four rooms, made from a seed.

The flat's inner walls cross in one point. Each room is designed in its own frame: p and q grow from that
crossing towards the outer walls, so that one design fits every corner of the flat after a mirroring. Two
doors lead out of each room, through its two inner walls; the four rooms thus form a round tour.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.sim import furniture as make
from maomaps_warp.sim.solids import (
    STEP,
    Color,
    Solid,
    ball,
    box,
    cylinder,
    merged,
    mirrored,
    named,
    parts_of,
    placed,
)
from maomaps_warp.sim.world import World, plain_world

#: Where the inner walls cross, and the height of the floor, metres. Every face of a box lies at this plus a
#: multiple of STEP = 0.025: half a step from all faces and centres of voxels of 0.05, whether cells are
#: found by rounding or by floor.
ORIGIN = (2.5125, 1.8625, 0.0125)
#: Clear height, thickness of the half of a wall that belongs to one room, door opening; metres.
CEILING = 2.6
HALF_WALL = 0.05
DOOR_WIDTH = 0.9
DOOR_HEIGHT = 2.05
#: By what share the brightness of its surfaces changes from grain to grain: features for what looks at plain walls.
GRAIN = 0.045

OAK: Color = (176, 128, 80)
PINE: Color = (212, 172, 116)
WALNUT: Color = (112, 74, 50)
WALLS: tuple[Color, ...] = ((226, 214, 188), (196, 212, 202), (204, 212, 226), (228, 204, 194))
FLOORS: tuple[Color, ...] = ((170, 122, 78), (150, 148, 142), (188, 146, 100), (142, 108, 76))


@dataclass(frozen=True)
class Room:
    """A room's clear floor, metres, world; `name` says what it is furnished as."""

    name: str
    x_min: float
    y_min: float
    x_max: float
    y_max: float


@dataclass(frozen=True)
class Door:
    """An opening between two rooms: its centre on the floor plan and its width, metres.

    `across` is "x" or "y": the axis along which one goes through.
    """

    x: float
    y: float
    width: float
    across: str


@dataclass(frozen=True, eq=False)
class Scene:
    """A coloured triangle mesh and its floor plan. World: metres, right-handed, z up.

    Attributes:
        vertices: (V, 3) float32, metres.
        triangles: (F, 3) int32, counter-clockwise seen from outside of each body.
        face_colors: (F, 3) uint8 RGB, one a triangle.
        parts: kinds of things in it, by name.
        face_part: (F,) int32, the kind of thing that each triangle belongs to.
        rooms: in the order of the tour.
        doors: doors[i] leads from rooms[i] to the next, the last one back to the first.
        tour: (W, 2) float64, metres: corners of a closed way through all rooms that stays clear of walls and
            furniture; it starts in the middle of rooms[0].
        floor_z, ceiling_z: heights, metres.
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    face_colors: NDArray[np.uint8]
    parts: tuple[str, ...]
    face_part: NDArray[np.int32]
    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]
    tour: NDArray[np.float64]
    floor_z: float
    ceiling_z: float

    @property
    def world(self) -> World:
        """What cameras see of it."""
        plain = plain_world(self.vertices, self.triangles, self.face_colors, grain=GRAIN, source="furnished flat")
        return replace(plain, parts=self.parts, face_part=self.face_part)


@dataclass(frozen=True)
class _Plan:
    """One room in its own frame: its corner of the flat, sizes, where doors are along p and q."""

    sign_x: int
    sign_y: int
    size_p: float
    size_q: float
    door_p: float
    door_q: float

    def against(self, wall: str, along: float, solids: Sequence[Solid], z: float = 0.0) -> list[Solid]:
        """A piece with its back to a wall ("far_p", "far_q", "near_p", "near_q"), centred on `along`."""
        along = round(along / STEP) * STEP
        x, y, yaw = {
            "far_p": (self.size_p, along, -0.5 * np.pi),
            "far_q": (along, self.size_q, 0.0),
            "near_p": (0.0, along, 0.5 * np.pi),
            "near_q": (along, 0.0, np.pi),
        }[wall]
        return placed(solids, x, y, yaw, z)

    def point(self, p: float, q: float) -> tuple[float, float]:
        """World x and y of a point of the room's frame."""
        return ORIGIN[0] + self.sign_x * (HALF_WALL + p), ORIGIN[1] + self.sign_y * (HALF_WALL + q)

    def in_world(self, solids: Sequence[Solid]) -> list[Solid]:
        """Solids of the room's frame, in the world."""
        return placed(mirrored(solids, self.sign_x, self.sign_y), *self.point(0.0, 0.0), z=ORIGIN[2])

    @property
    def way(self) -> list[tuple[float, float]]:
        """Corners of the way from the door at p = 0 to the one at q = 0, clear of the furniture."""
        p, q = self.door_p, self.door_q
        return [(0.0, q), (0.6, q), (1.35, 1.6), (1.7, 1.35), (p, 0.6), (p, 0.0)]

    @property
    def room(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max of the clear floor in the world."""
        near, far = self.point(0.0, 0.0), self.point(self.size_p, self.size_q)
        return min(near[0], far[0]), min(near[1], far[1]), max(near[0], far[0]), max(near[1], far[1])


def furnished_flat(seed: int = 0) -> Scene:
    """A flat of 2 x 2 rooms of about 4 x 3.5 m: living room, kitchen, study and bedroom.

    The seed decides sizes, where doors are, which room is which, colours and small things. The same seed
    gives the same arrays.
    """
    rng = np.random.default_rng(seed)
    sizes_p, sizes_q = _rounded(rng.uniform(3.85, 4.15, 2)), _rounded(rng.uniform(3.4, 3.65, 2))
    doors_p, doors_q = _rounded(rng.uniform(1.05, 1.3, 2)), _rounded(rng.uniform(1.05, 1.3, 2))
    order, walls, floors = (rng.permutation(4) for _ in range(3))
    solids: list[Solid] = []
    rooms, doors, tour = [], [], []
    # Counter-clockwise round the crossing of the inner walls.
    for corner, (i, j) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        plan = _Plan(2 * i - 1, 2 * j - 1, sizes_p[i], sizes_q[j], doors_p[i], doors_q[j])
        name, design = _DESIGNS[order[corner]]
        inside = [*_shell(plan, WALLS[walls[corner]], FLOORS[floors[corner]]), *design(plan, rng)]
        solids += plan.in_world(inside)
        rooms.append(Room(name, *plan.room))
        leaves_by_q = i != j
        tour += [plan.point(p, q) for p, q in (plan.way if leaves_by_q else plan.way[::-1])]
        if leaves_by_q:
            doors.append(Door(*plan.point(plan.door_p, -HALF_WALL), DOOR_WIDTH, "y"))
        else:
            doors.append(Door(*plan.point(-HALF_WALL, plan.door_q), DOOR_WIDTH, "x"))
    return Scene(
        *merged(solids),
        *parts_of(solids),
        rooms=tuple(rooms),
        doors=tuple(doors),
        tour=np.roll(np.array(tour), -3, axis=0),
        floor_z=ORIGIN[2],
        ceiling_z=ORIGIN[2] + CEILING,
    )


def _rounded(lengths: NDArray[np.float64]) -> list[float]:
    return [float(v) for v in np.rint(lengths / STEP) * STEP]


def _shell(plan: _Plan, wall: Color, floor: Color) -> list[Solid]:
    """Floor, ceiling, walls with door openings and their trim, skirting boards, a lamp."""
    p, q, t, lowest = plan.size_p, plan.size_q, HALF_WALL, -0.1
    solids = [
        *named("floor", [box((-t, -t, lowest), (p + t, q + t, 0), floor)]),
        *named("ceiling", [box((-t, -t, CEILING), (p + t, q + t, CEILING + 0.1), make.WHITE)]),
        *plan.against("far_p", q / 2, _wall(q, None, wall)),
        *plan.against("far_q", p / 2, _wall(p, None, wall)),
        # Walls at p = 0 and q = 0 are seen from the other side: their x runs along +q and -p.
        *plan.against("near_p", q / 2, _wall(q, plan.door_q - q / 2, wall)),
        *plan.against("near_q", p / 2, _wall(p, p / 2 - plan.door_p, wall)),
    ]
    return [*solids, *placed(make.pendant_lamp(CEILING), p / 2, q / 2)]


def _wall(length: float, door: float | None, color: Color) -> list[Solid]:
    """A wall behind y = 0, with an opening centred on x = `door` if there is one, and its skirting board."""
    end, t = length / 2 + HALF_WALL, HALF_WALL
    if door is None:
        return [
            *named("wall", [box((-end, 0, 0), (end, t, CEILING), color)]),
            *named("skirting", [box((-end, -0.025, 0), (end, 0, 0.1), make.WHITE)]),
        ]
    left, right, trim = door - DOOR_WIDTH / 2, door + DOOR_WIDTH / 2, 0.075
    frame = [box((left - trim, -0.025, DOOR_HEIGHT), (right + trim, 0, DOOR_HEIGHT + trim), PINE)]
    frame += [box((a, -0.025, 0), (a + trim, 0, DOOR_HEIGHT), PINE) for a in (left - trim, right)]
    solids = named("wall", [box((left, 0, DOOR_HEIGHT), (right, t, CEILING), color)]) + named("door frame", frame)
    for a, b in ((-end, left), (right, end)):
        solids += named("wall", [box((a, 0, 0), (b, t, CEILING), color)])
        skirting = (a, b - trim) if b == left else (a + trim, b)
        solids += named("skirting", [box((skirting[0], -0.025, 0), (skirting[1], 0, 0.1), make.WHITE)])
    return solids


def _living_room(plan: _Plan, rng: np.random.Generator) -> list[Solid]:
    p, q = plan.size_p, plan.size_q
    cloth: Color = ((92, 112, 140), (132, 92, 82), (96, 122, 98))[rng.integers(3)]
    return [
        *placed(make.rug(1.8, 1.2, (150, 64, 56), (222, 200, 164)), 2.65, q - 1.3),
        *plan.against("far_q", 2.65, make.sofa(2.0, cloth)),
        *plan.against("far_q", 2.65, make.picture(1.0, 0.6, rng), z=1.35),
        *placed(make.table(0.9, 0.5, 0.45, OAK), 2.65, q - 1.15),
        *placed(_tableware(rng, 2), 2.65, q - 1.4, z=0.45),
        *plan.against("near_q", 2.8, make.cabinet(1.4, 0.4, 0.5, 3, WALNUT)),
        *plan.against("near_q", 2.8, make.screen(1.1, 0.65), z=0.5),
        *plan.against("far_p", 1.3, make.shelf(1.0, 2.0, 5, PINE, rng)),
        *placed(make.standing_lamp(1.6, make.GLOW), 1.3, q - 0.4),
        *placed(make.plant(rng), p - 0.35, q - 0.35),
        *plan.against("near_p", q - 0.9, make.shelf(0.8, 0.8, 2, OAK, rng)),
        *plan.against("near_p", q - 0.9, make.picture(0.5, 0.7, rng), z=1.2),
    ]


def _kitchen(plan: _Plan, rng: np.random.Generator) -> list[Solid]:
    p, q = plan.size_p, plan.size_q
    seat: Color = ((184, 92, 60), (86, 128, 120), (200, 168, 80))[rng.integers(3)]
    solids = [
        *plan.against("far_q", 1.8, make.counter(2.5, (120, 146, 150))),
        *plan.against("far_q", p - 0.45, make.fridge()),
        *placed(make.table(1.2, 0.8, 0.75, OAK), 3.05, 1.75),
        *placed(_tableware(rng, 4), 3.05, 1.35, z=0.75),
        *plan.against("far_p", 1.35, make.window(1.2, 1.1), z=0.95),
        *plan.against("far_p", 1.35, make.radiator(1.0)),
        *plan.against("near_q", 2.7, make.picture(0.7, 0.5, rng), z=1.35),
        *plan.against("near_p", q - 0.9, make.cabinet(0.9, 0.35, 1.2, 2, PINE)),
        *placed(_tableware(rng, 2), 0.2, q - 0.9, z=1.2),
    ]
    for x, side in ((2.75, 0), (3.35, 0), (2.75, 1), (3.35, 1)):
        yaw = np.pi * (1 - side) + rng.uniform(-0.2, 0.2)
        solids += placed(make.chair(seat), x, 2.15 if side else 0.55, yaw)
    return solids


def _bedroom(plan: _Plan, rng: np.random.Generator) -> list[Solid]:
    p, q = plan.size_p, plan.size_q
    cover: Color = ((84, 110, 158), (164, 84, 96), (98, 140, 110))[rng.integers(3)]
    return [
        *placed(make.rug(1.2, 0.8, (92, 104, 150), (206, 208, 222)), 1.55, 1.4),
        *plan.against("far_p", q - 0.75, make.bed(1.4, 2.0, OAK, cover)),
        *plan.against("far_p", q - 0.75, make.picture(0.9, 0.6, rng), z=1.35),
        *plan.against("far_p", q - 1.7, make.cabinet(0.4, 0.4, 0.5, 1, OAK)),
        *placed(make.standing_lamp(0.45, make.GLOW), p - 0.2, q - 1.7, z=0.5),
        *plan.against("near_q", 2.75, make.cabinet(1.6, 0.6, 2.0, 3, PINE)),
        *plan.against("far_q", 1.1, make.window(1.1, 1.1), z=0.95),
        *plan.against("far_q", 1.1, make.radiator(0.9)),
        *plan.against("near_p", q - 0.8, make.cabinet(0.9, 0.45, 0.8, 2, WALNUT)),
        *placed(make.plant(rng), 0.25, q - 0.6, z=0.8),
        *plan.against("near_p", q - 0.9, make.picture(0.6, 0.45, rng), z=1.6),
    ]


def _study(plan: _Plan, rng: np.random.Generator) -> list[Solid]:
    p, q = plan.size_p, plan.size_q
    return [
        *placed(make.rug(1.4, 1.0, (88, 118, 108), (200, 190, 160)), 1.6, 1.6),
        *plan.against("far_p", 1.6, make.table(1.5, 0.7, 0.75, WALNUT)),
        *plan.against("far_p", 1.5, make.screen(0.6, 0.35), z=0.75),
        *plan.against("far_p", 2.1, _tableware(rng, 2), z=0.75),
        *placed(make.chair(make.DARK), p - 0.95, 1.6, 0.5 * np.pi + rng.uniform(-0.5, 0.5)),
        *plan.against("far_p", 2.85, make.window(0.7, 1.1), z=0.95),
        *plan.against("far_q", 1.1, make.shelf(1.0, 2.1, 6, OAK, rng)),
        *plan.against("far_q", 2.2, make.shelf(1.0, 1.5, 4, OAK, rng)),
        *placed(make.standing_lamp(1.5, make.GLOW), p - 0.4, q - 0.4),
        *plan.against("near_q", 2.7, make.cabinet(1.0, 0.4, 0.9, 2, PINE)),
        *placed(named("globe", [ball((0, 0, 0.22), 0.2, (70, 110, 160))]), 2.7, 0.2, z=0.9),
        *plan.against("near_q", 2.7, make.picture(0.9, 0.6, rng), z=1.5),
        *placed(make.plant(rng), 0.35, q - 0.7),
    ]


def _tableware(rng: np.random.Generator, count: int) -> list[Solid]:
    """Mugs and fruit on 0.4 x 0.2 m, whose back is 0.2 m in front of y = 0; the table's top is at z = 0."""
    solids: list[Solid] = []
    for x in np.linspace(-0.2, 0.2, count):
        at = (x + rng.uniform(-0.04, 0.04), -0.3 + rng.uniform(-0.1, 0.1))
        color = make.BOOKS[rng.integers(len(make.BOOKS))]
        solids.append(cylinder(at, 0.04, 0, 0.1, make.WHITE if rng.random() < 0.3 else color))
        solids.append(ball((at[0] + 0.12, at[1] + 0.02, 0.045), 0.045, color))
    return named("tableware", solids)


_Design = Callable[[_Plan, np.random.Generator], list[Solid]]
_DESIGNS: tuple[tuple[str, _Design], ...] = (
    ("living room", _living_room),
    ("kitchen", _kitchen),
    ("study", _study),
    ("bedroom", _bedroom),
)
