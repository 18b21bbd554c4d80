"""The text formats of trajectories: rows to poses and stamps, before frames and order are settled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.io.rotations import (
    checked_quaternions,
    checked_rotations,
    matrices_from_quaternions,
    matrices_from_rpy,
    poses,
)
from maomaps_warp.io.tables import Table, check_finite, read_table

#: No clock counts so many seconds (3170 years): such a number counts milliseconds, microseconds or
#: nanoseconds.
LARGEST_SECONDS = 1e11
#: Cameras do not wait 11 days between poses: steps of so many "seconds" count a smaller unit.
LARGEST_STEP_S = 1e6
#: Poses do not follow one another within a microsecond: steps of fewer "nanoseconds" count a larger unit.
SMALLEST_STEP_NS = 1e3

#: What a number of values a row stands for, for messages.
COLUMN_MEANINGS = {
    3: "points `x y z`",
    6: "MAOMaps poses `x y z roll pitch yaw` or coloured points `x y z r g b`",
    7: "poses without stamps",
    8: "TUM `t x y z qx qy qz qw` or EuRoC `ns x y z qw qx qy qz`",
    12: "KITTI, a 3x4 matrix",
    16: "4x4 matrices",
    17: "EuRoC ground truth",
}


@dataclass(frozen=True, eq=False)
class PoseRows:
    """Poses as a file lists them.

    Attributes:
        T: (N, 4, 4) float64, metres, in the file's own frame convention.
        stamps_ns: (N,) int64, nanoseconds, in any order; None without stamps.
        where_stamp: the place of stamp i, for messages.
        notes: what was decided while reading.
    """

    T: NDArray[np.float64]
    stamps_ns: NDArray[np.int64] | None
    where_stamp: Callable[[int], str]
    notes: tuple[str, ...] = ()


def read_tum_rows(path: Path) -> PoseRows:
    """Reads `t x y z qx qy qz qw`, seconds."""
    table = _pose_table(path, lambda count: count == 8, "TUM has 8: t x y z qx qy qz qw", keep_first=True)
    rotations = matrices_from_quaternions(checked_quaternions(table.values[:, 4:8], table.where))
    return PoseRows(poses(table.values[:, 1:4], rotations), ns_of_seconds(table), table.where)


def read_euroc_rows(path: Path) -> PoseRows:
    """Reads `ns, x, y, z, qw, qx, qy, qz`, nanoseconds; further columns (velocities, biases) are not used."""
    hint = "EuRoC has 8 or more: ns, x, y, z, qw, qx, qy, qz"
    table = _pose_table(path, lambda count: count >= 8, hint, keep_first=True)
    rotations = matrices_from_quaternions(checked_quaternions(table.values[:, [5, 6, 7, 4]], table.where))
    return PoseRows(poses(table.values[:, 1:4], rotations), _ns_of_nanoseconds(table), table.where)


def read_kitti_rows(path: Path) -> PoseRows:
    """Reads 3x4 matrices, row by row; stamps stand in `<stem>_times.txt`, or in `times.txt` if as long."""
    table = _pose_table(path, lambda count: count == 12, "KITTI has 12: a 3x4 matrix, row by row")
    matrices = table.values.reshape(-1, 3, 4)
    T = poses(matrices[:, :, 3], checked_rotations(matrices[:, :, :3], table.where))
    own, common = path.with_name(f"{path.stem}_times.txt"), path.with_name("times.txt")
    if own.exists():
        return _with_stamps(T, own, table)
    if common.exists() and common != path:
        times = read_table(common, columns={1}, keep_first=True)
        if len(times) == len(table):
            return PoseRows(T, ns_of_seconds(times), times.where)
        note = f"{common.name} holds {len(times)} stamps for {len(table)} poses and was not used: no stamps"
        return PoseRows(T, None, table.where, (note,))
    return PoseRows(T, None, table.where, (f"no stamps: there is no {own.name} or times.txt",))


def read_maomaps_rows(path: Path) -> PoseRows:
    """Reads `x y z roll pitch yaw`, radians; stamps stand in `<stem>_timestamps.txt`."""
    T, table = read_maomaps_poses(path)
    stamps = timestamps_beside(path)
    if stamps.exists():
        return _with_stamps(T, stamps, table)
    return PoseRows(T, None, table.where, (f"no stamps: there is no {stamps.name}",))


def read_maomaps_poses(path: Path) -> tuple[NDArray[np.float64], Table]:
    """Reads `x y z roll pitch yaw`, radians, without stamps: (N, 4, 4) float64, metres, and the table."""
    table = _pose_table(path, lambda count: count == 6, "MAOMaps has 6: x y z roll pitch yaw")
    return poses(table.values[:, :3], matrices_from_rpy(*table.values[:, 3:6].T)), table


def timestamps_beside(path: Path) -> Path:
    """Where the stamps of a MAOMaps pose file stand."""
    return path.with_name(f"{path.stem}_timestamps.txt")


def ns_of_seconds(table: Table) -> NDArray[np.int64]:
    """Stamps, (N,) int64 nanoseconds, of a first column in decimal seconds: exact, no float in between."""
    seconds = table.values[:, 0]
    check_finite(table)
    large = np.flatnonzero(np.abs(seconds) >= LARGEST_SECONDS)
    if len(large):
        row = int(large[0])
        unit, divisor = _unit_of(abs(seconds[row]))
        raise _not_seconds(table, row, f"stamp {table.first[row]} looks like {unit}", divisor)
    if len(seconds) > 1 and (step := float(np.median(np.abs(np.diff(seconds))))) >= LARGEST_STEP_S:
        raise _not_seconds(table, 0, f"stamps look like nanoseconds: {step:.3g} s would lie between two poses", "1e9")
    stamps = [int(Decimal(text).scaleb(9).to_integral_value()) for text in table.first]
    if max(map(abs, stamps)) > np.iinfo(np.int64).max:
        raise InputError(table.path, "stamps are beyond 292 years", "stamps must be seconds")
    return np.array(stamps, np.int64)


def _ns_of_nanoseconds(table: Table) -> NDArray[np.int64]:
    hint = "EuRoC stamps are whole nanoseconds; multiply by 1e9, or if it is TUM's order name the format tum"
    exact = [Decimal(text) for text in table.first]
    for row, stamp in enumerate(exact):
        if stamp != stamp.to_integral_value():
            raise InputError(table.where(row), f"stamp {table.first[row]} looks like seconds", hint)
        if abs(stamp) > np.iinfo(np.int64).max:
            raise InputError(table.where(row), f"stamp {table.first[row]} is beyond 292 years", hint)
    stamps = np.array([int(stamp) for stamp in exact], np.int64)
    if len(stamps) > 1 and (step := float(np.median(np.abs(np.diff(stamps))))) < SMALLEST_STEP_NS and step > 0:
        raise InputError(table.where(0), f"stamps look like seconds: they lie {step:g} ns apart", hint)
    return stamps


def _not_seconds(table: Table, row: int, found: str, divisor: str) -> InputError:
    hint = f"divide by {divisor} for seconds; for EuRoC's columns name the format euroc"
    return InputError(table.where(row), found, hint)


def _unit_of(value: float) -> tuple[str, str]:
    """What a stamp counts that is too large for seconds, and what turns it into seconds."""
    if value >= 1e17:
        return "nanoseconds", "1e9"
    return ("microseconds", "1e6") if value >= 1e14 else ("milliseconds or nanoseconds", "1e3 or 1e9")


def _pose_table(path: Path, fits: Callable[[int], bool], hint: str, *, keep_first: bool = False) -> Table:
    """A table of finite numbers whose number of columns fits."""
    table = read_table(path, keep_first=keep_first)
    count = table.values.shape[1]
    if not fits(count):
        meaning = f", as in {COLUMN_MEANINGS[count]}" if count in COLUMN_MEANINGS else ""
        raise InputError(table.where(0), f"{count} values a row{meaning}", hint)
    check_finite(table)
    return table


def _with_stamps(T: NDArray[np.float64], stamps: Path, table: Table) -> PoseRows:
    times = read_table(stamps, columns={1}, keep_first=True)
    if len(times) != len(table):
        found = f"holds {len(times)} stamps, but {table.path.name} holds {len(table)} poses"
        raise InputError(stamps, found, "one stamp a pose is needed; without this file poses pair by index")
    return PoseRows(T, ns_of_seconds(times), times.where)
