"""Figures of the samples of a dataset."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RunFigures:
    """One run of a sample; None where its files do not tell.

    Attributes:
        name: "first", "second", ...
        path_length: metres.
        duration: seconds from the first pose to the last.
        poses: how many.
        elements: elements of its map.
    """

    name: str
    path_length: float | None = None
    duration: float | None = None
    poses: int | None = None
    elements: int | None = None


@dataclass(frozen=True)
class OverlapFigures:
    """How much of a sample its runs share: seen by at least two runs over seen by any.

    Attributes:
        known_iou: of the columns that the projections know, free or occupied; None if no map knows one.
        obstacle_iou: of the occupied columns of the projections; None if there are none.
        voxel_iou: of the voxels; None if all maps are empty.
        counts: both numbers of each: known_common, known_any, obstacle_common, obstacle_any, voxel_common, voxel_any.
    """

    known_iou: float | None
    obstacle_iou: float | None
    voxel_iou: float | None
    counts: dict[str, int]


@dataclass(frozen=True)
class SampleFigures:
    """One row of the paper's Table II.

    Attributes:
        name: of the sample directory.
        runs: its runs, in order.
        overlap: of the runs' maps; None if one of them is missing.
        elements: elements of the merged map.
        size: width (along x) and height (along y) of the projection of the merged map, cells.
        ground_z: height of the ground in the merged map, metres.
        problems: what is missing or damaged, one sentence each.
        notes: what was decided on the way, one sentence each.
    """

    name: str
    runs: tuple[RunFigures, ...]
    overlap: OverlapFigures | None = None
    elements: int | None = None
    size: tuple[int, int] | None = None
    ground_z: float | None = None
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class DatasetFigures:
    """The samples of a dataset.

    Attributes:
        name: what the user gave.
        samples: in the order of the table.
        voxel_size: metres.
        ground: the rule the ground was found by, or its height.
        notes: what was left out, one sentence each.
    """

    name: str
    samples: tuple[SampleFigures, ...]
    voxel_size: float
    ground: str
    notes: tuple[str, ...] = ()
