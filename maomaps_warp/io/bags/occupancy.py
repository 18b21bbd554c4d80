"""Maps of the ground from the topics of a bag."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.topics import BagContents
from maomaps_warp.model.occupancy import Cell, OccupancyGrid

#: Per cent from which on a cell is occupied, and up to which it is free: map_server's thresholds.
OCCUPIED_PERCENT, FREE_PERCENT = 65, 19.6
#: How far the norm of an orientation may be from 1, and its roll and pitch parts from 0.
_QUATERNION_TOLERANCE = 1e-3


def read_bag_grid(contents: BagContents) -> OccupancyGrid:
    """Read the last nav_msgs/OccupancyGrid of the named topic, or else of the only one with grids.

    Raises:
        InputError: no or several candidates (lists them), or a message that describes no map of the ground.
    """
    topic = contents.choose("grids")
    where = f"{contents.path}, topic {topic.name}"
    notes = (f"{topic.name}: the last of {topic.count} grids is used",) if topic.count > 1 else ()
    return grid_of(contents.bag.last_message(topic), where, notes)


def grid_of(message: Any, where: str, notes: tuple[str, ...] = ()) -> OccupancyGrid:
    """Unpack an OccupancyGrid: from 65 per cent on occupied, up to 19.6 free, between unknown, -1 unknown.

    Args:
        message: the message, of ROS 1 or ROS 2.
        where: bag and topic, for errors.
        notes: what was decided before.

    Raises:
        InputError: no size, no resolution, an orientation with roll or pitch, or values outside -1..100.
    """
    info = message.info
    width, height = int(info.width), int(info.height)
    # The message holds float32: 0.05 would be 0.05000000074505806 and drift off the lattice.
    resolution = float(str(np.float32(info.resolution)))
    if not (math.isfinite(resolution) and resolution > 0):
        raise InputError(where, f"its cells have a size of {resolution:g} m", "the publisher must state the resolution")
    if not width or not height:
        raise InputError(where, f"an empty grid of {width} x {height} cells")
    values = np.asarray(message.data, dtype=np.int8)
    if len(values) != width * height:
        raise InputError(where, f"{len(values)} values for {width} x {height} cells", "the message is damaged")
    yaw, more = _yaw_of(info.origin.orientation, where)
    x, y = float(info.origin.position.x), float(info.origin.position.y)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(where, f"its origin lies at {x:g}, {y:g} m", "the publisher must state the origin")
    cells = _cells_of(values, where).reshape(height, width)
    return OccupancyGrid(cells, resolution, (x, y, yaw), where, message.header.frame_id, notes + more)


def _cells_of(values: NDArray[np.int8], where: str) -> NDArray[np.uint8]:
    wrong = np.flatnonzero((values < -1) | (values > 100))
    if len(wrong):
        found = f"{len(wrong)} cells hold values outside -1..100, the first {values[wrong[0]]}"
        raise InputError(where, found, "cells hold per cent, or -1 for unknown")
    cells = np.full(len(values), Cell.UNKNOWN, dtype=np.uint8)
    cells[(values >= 0) & (values <= FREE_PERCENT)] = Cell.FREE
    cells[values >= OCCUPIED_PERCENT] = Cell.OCCUPIED
    return cells


def _yaw_of(orientation: Any, where: str) -> tuple[float, tuple[str, ...]]:
    """Radians of a quaternion that turns about z alone; and a note if none was set."""
    x, y, z, w = (float(getattr(orientation, name)) for name in "xyzw")
    if not any((x, y, z, w)):
        return 0.0, ("the grid's orientation is not set (all zeros): taken as no rotation",)
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1.0) <= _QUATERNION_TOLERANCE:
        raise InputError(where, f"the quaternion of its origin has the norm {norm:g}", "it should be 1")
    if math.hypot(x, y) > _QUATERNION_TOLERANCE:
        found = f"its origin is tilted (qx {x:g}, qy {y:g})"
        raise InputError(where, found, "a map of the ground may only be turned about z")
    yaw = 2.0 * math.atan2(z, w)
    return math.remainder(yaw, math.tau), ()
