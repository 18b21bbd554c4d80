"""Furniture.

Every piece stands in its own frame: its back on the plane y = 0, its front towards -y, x to the right of
somebody who looks at its front from there, centred on x = 0, the floor at z = 0. Metres throughout.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

import numpy as np

from maomaps_warp.sim.solids import Color, Solid, ball, box, cylinder, lathe, lighter, named, placed

WHITE: Color = (236, 234, 228)
STEEL: Color = (150, 156, 162)
DARK: Color = (44, 46, 52)
LEAF: Color = (64, 128, 60)
GLOW: Color = (255, 240, 196)
SKY: Color = (168, 208, 240)
BOOKS: tuple[Color, ...] = (
    (168, 52, 44),
    (42, 84, 140),
    (214, 164, 50),
    (54, 110, 78),
    (120, 66, 112),
    (224, 216, 196),
    (210, 108, 48),
)


_Sizes = ParamSpec("_Sizes")


def _piece(design: Callable[_Sizes, list[Solid]]) -> Callable[_Sizes, list[Solid]]:
    """Names the solids of a design after it; those of a piece that it is made of, too."""

    @wraps(design)
    def made(*args: _Sizes.args, **kwargs: _Sizes.kwargs) -> list[Solid]:
        return named(design.__name__.replace("_", " "), design(*args, **kwargs))

    return made


@_piece
def table(width: float, depth: float, height: float, color: Color) -> list[Solid]:
    """A plate on four legs."""
    x, leg = width / 2, 0.05
    legs = [
        box((lx, ly, 0), (lx + leg, ly + leg, height - 0.05), color)
        for lx in (-x + 0.025, x - 0.025 - leg)
        for ly in (-depth + 0.025, -0.025 - leg)
    ]
    return [box((-x, -depth, height - 0.05), (x, 0, height), color), *legs]


@_piece
def chair(color: Color) -> list[Solid]:
    """A chair with a back, 0.45 m square; its back is at y = 0."""
    back = [box((-0.2, -0.05, z), (0.2, -0.025, z + 0.1), color) for z in (0.6, 0.775)]
    posts = [box((x, -0.05, 0.45), (x + 0.025, -0.025, 0.9), color) for x in (-0.225, 0.2)]
    return [*table(0.45, 0.45, 0.45, color), *back, *posts]


@_piece
def shelf(width: float, height: float, boards: int, color: Color, rng: np.random.Generator) -> list[Solid]:
    """An open shelf, 0.3 m deep; each board but the highest carries a row of books."""
    x, edge, depth = width / 2, 0.025, 0.3
    solids = [
        box((-x, -depth, 0), (-x + edge, 0, height), color),
        box((x - edge, -depth, 0), (x, 0, height), color),
    ]
    solids.append(box((-x, -0.05, 0), (x, 0, height), color))
    gap = height / boards
    for z in np.arange(boards) * gap + 0.05:
        solids.append(box((-x, -depth, z), (x, 0, z + edge), color))
        solids += _books(width - 2 * edge, z + edge, gap, rng)
    solids.append(box((-x, -depth, height), (x, 0, height + edge), color))
    return solids


def _books(width: float, z: float, gap: float, rng: np.random.Generator) -> list[Solid]:
    books, x, end = [], -width / 2, width / 2 * rng.uniform(0.3, 1.0)
    while x < end - 0.1:
        thick = 0.025 * int(rng.integers(1, 4))
        tall, deep = gap * rng.uniform(0.55, 0.85), rng.uniform(0.12, 0.2)
        books.append(box((x, -0.05 - deep, z), (x + thick, -0.05, z + tall), BOOKS[rng.integers(len(BOOKS))]))
        x += thick
    return books


@_piece
def cabinet(width: float, depth: float, height: float, doors: int, color: Color) -> list[Solid]:
    """A closed body with doors and handles."""
    x, leaf = width / 2, width / doors
    solids = [box((-x, -depth + 0.025, 0), (x, 0, height), color)]
    for left in -x + leaf * np.arange(doors):
        solids.append(box((left + 0.025, -depth, 0.075), (left + leaf - 0.025, 0, height - 0.025), lighter(color, 14)))
        grip = left + leaf - 0.075
        solids.append(box((grip, -depth - 0.025, height * 0.45), (grip + 0.025, -depth, height * 0.45 + 0.15), STEEL))
    return solids


@_piece
def bed(width: float, length: float, wood: Color, cover: Color) -> list[Solid]:
    """A bed with its head at y = 0: frame, mattress, cover and two pillows."""
    x = width / 2
    pillows = [
        box((c - width * 0.2, -0.5, 0.5), (c + width * 0.2, -0.15, 0.6), WHITE) for c in (-width * 0.24, width * 0.24)
    ]
    return [
        box((-x, -0.05, 0), (x, 0, 1.0), wood),
        box((-x, -length, 0.1), (x, -0.05, 0.3), wood),
        box((-x + 0.05, -length + 0.05, 0.3), (x - 0.05, -0.05, 0.5), WHITE),
        box((-x + 0.025, -length + 0.025, 0.35), (x - 0.025, -0.75, 0.525), cover),
        *pillows,
    ]


@_piece
def sofa(width: float, color: Color) -> list[Solid]:
    """A sofa with arms and loose cushions, 0.9 m deep."""
    x, seats = width / 2, 3
    seat = (width - 0.4) / seats
    cushions = [
        box((left, -0.875, 0.3), (left + seat - 0.025, -0.2, 0.45), lighter(color, 22))
        for left in -x + 0.2 + seat * np.arange(seats)
    ]
    arms = [box((a, -0.9, 0.05), (a + 0.2, 0, 0.6), color) for a in (-x, x - 0.2)]
    return [
        box((-x, -0.9, 0.05), (x, 0, 0.3), color),
        box((-x, -0.2, 0.3), (x, 0, 0.85), color),
        *arms,
        *cushions,
    ]


@_piece
def screen(width: float, height: float) -> list[Solid]:
    """A television or monitor on a foot, standing at y = -0.15."""
    x = width / 2
    return [
        box((-0.15, -0.25, 0), (0.15, -0.05, 0.025), DARK),
        box((-0.025, -0.15, 0), (0.025, -0.125, 0.15), DARK),
        box((-x, -0.175, 0.1), (x, -0.125, 0.1 + height), DARK),
        box((-x + 0.025, -0.2, 0.125), (x - 0.025, -0.15, 0.075 + height), (58, 92, 122)),
    ]


@_piece
def counter(width: float, color: Color) -> list[Solid]:
    """A kitchen counter with hob, sink tap, pots and wall cupboards above."""
    x = width / 2
    upper = placed(cabinet(width, 0.35, 0.65, round(width / 0.5), WHITE), 0, 0, z=1.5)
    rings = [cylinder((cx, cy), 0.08, 0.925, 0.935, (190, 60, 40)) for cx in (-0.14, 0.14) for cy in (-0.18, -0.42)]
    pots = [
        cylinder((-0.14, -0.18), 0.1, 0.935, 1.06, STEEL),
        cylinder((x - 0.25, -0.2), 0.07, 0.9, 1.12, (196, 84, 52)),
        cylinder((x - 0.45, -0.15), 0.05, 0.9, 1.18, (84, 132, 92)),
    ]
    tap = [
        cylinder((-x + 0.4, -0.1), 0.02, 0.9, 1.2, STEEL),
        box((-x + 0.375, -0.3, 1.175), (-x + 0.425, -0.1, 1.2), STEEL),
    ]
    return [
        *cabinet(width, 0.6, 0.85, round(width / 0.5), color),
        box((-x, -0.625, 0.85), (x, 0, 0.9), (206, 202, 194)),
        box((-0.3, -0.55, 0.9), (0.3, -0.05, 0.925), DARK),
        *rings,
        *pots,
        *tap,
        *upper,
    ]


@_piece
def fridge() -> list[Solid]:
    """A fridge-freezer."""
    body = [
        box((-0.3, -0.6, 0.05), (0.3, 0, 1.8), WHITE),
        box((-0.3, -0.625, 0.075), (0.3, -0.6, 0.6), WHITE),
    ]
    grips = [box((0.2, -0.675, z), (0.225, -0.65, z + 0.3), STEEL) for z in (0.25, 0.75)]
    return [*body, box((-0.3, -0.65, 0.65), (0.3, -0.6, 1.775), WHITE), *grips]


@_piece
def standing_lamp(height: float, shade: Color) -> list[Solid]:
    """A lamp on a thin stem; short ones stand on tables. Centred on the origin."""
    size = 0.1 + 0.06 * height
    return [
        cylinder((0, 0), size * 0.8, 0, 0.02, DARK),
        cylinder((0, 0), 0.015, 0.02, height - size, DARK),
        lathe((0, 0), ((size, height - 1.4 * size), (size * 0.6, height)), shade),
    ]


@_piece
def pendant_lamp(ceiling: float) -> list[Solid]:
    """A ball that hangs from the ceiling. Centred on the origin."""
    return [cylinder((0, 0), 0.01, ceiling - 0.4, ceiling, DARK), ball((0, 0, ceiling - 0.5), 0.15, GLOW)]


@_piece
def plant(rng: np.random.Generator) -> list[Solid]:
    """A pot with leaves. Centred on the origin."""
    solids = [
        lathe((0, 0), ((0.11, 0), (0.16, 0.3)), (176, 92, 62)),
        cylinder((0, 0), 0.02, 0.3, 0.8, (92, 70, 44)),
    ]
    for _ in range(7):
        x, y, z = *rng.uniform(-0.15, 0.15, 2), rng.uniform(0.55, 1.1)
        green: Color = (LEAF[0] + int(rng.integers(-16, 17)), LEAF[1] + int(rng.integers(-24, 25)), LEAF[2])
        solids.append(ball((x, y, z), rng.uniform(0.08, 0.15), green))
    return solids


@_piece
def picture(width: float, height: float, rng: np.random.Generator) -> list[Solid]:
    """A framed picture of coloured fields, hung with its lower edge at z = 0."""
    x = width / 2
    solids = [box((-x, -0.025, 0), (x, 0, height), DARK)]
    for left, right in ((-x + 0.05, -x * 0.2), (-x * 0.2, x - 0.05)):
        for low, high in ((0.05, height * 0.55), (height * 0.55, height - 0.05)):
            solids.append(box((left, -0.05, low), (right, 0, high), BOOKS[rng.integers(len(BOOKS))]))
    return solids


@_piece
def window(width: float, height: float) -> list[Solid]:
    """A window with bars and sill, its lower edge at z = 0; solid, so that no ray leaves the flat."""
    x = width / 2
    bars = [box((a, -0.05, 0), (a + 0.05, 0, height), WHITE) for a in (-x, -0.025, x - 0.05)]
    beams = [box((-x, -0.05, z), (x, 0, z + 0.05), WHITE) for z in (0.0, height - 0.05)]
    return [
        box((-x, -0.025, 0), (x, 0, height), SKY),
        box((-x - 0.05, -0.2, -0.05), (x + 0.05, 0, 0), WHITE),
        *bars,
        *beams,
    ]


@_piece
def radiator(width: float) -> list[Solid]:
    """A ribbed radiator, 0.5 m high, 0.15 m above the floor."""
    ribs = [
        box((a, -0.125, 0.15), (a + 0.05, -0.025, 0.65), WHITE) for a in np.arange(-width / 2, width / 2 - 0.05, 0.1)
    ]
    return [box((-width / 2, -0.1, 0.2), (width / 2, -0.05, 0.6), WHITE), *ribs]


@_piece
def rug(width: float, depth: float, outer: Color, inner: Color) -> list[Solid]:
    """A flat rug with a border, centred on the origin."""
    x, y = width / 2, depth / 2
    return [
        box((-x, -y, 0), (x, y, 0.025), outer),
        box((-x + 0.15, -y + 0.15, 0), (x - 0.15, y - 0.15, 0.05), inner),
    ]
