"""Scoring a merge of maps: transforms, success, AME of the merged map, the sources without the merge."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.jobs.merge_inputs import MergeFiles, MergeInputs, read_merge_inputs
from maomaps_warp.mapping.projection import find_ground, project
from maomaps_warp.model.merge_results import (
    Apart,
    MergeAlign,
    MergedMapScore,
    MergePlacement,
    MergeScore,
    SourceScore,
    SuccessRule,
    TransformError,
)
from maomaps_warp.model.occupancy_results import OccupancyScore
from maomaps_warp.model.results import NoValue
from maomaps_warp.model.statistics import Statistics
from maomaps_warp.model.voxels import VoxelGrid
from maomaps_warp.scoring.merge_errors import lattice_note, map_error, merged_ground_truth, merged_map_score
from maomaps_warp.scoring.merge_fit import fit_merged
from maomaps_warp.scoring.merge_transforms import (
    first_placement,
    is_placed_well,
    judge,
    moved,
    moved_grid,
    reference_of,
    transform_errors,
    with_true_heights,
)
from maomaps_warp.scoring.occupancy_errors import occupancy_errors
from maomaps_warp.stopwatch import Stopwatch

Pose = NDArray[np.float64]
Points = NDArray[np.float64]

#: A merged map is called worse than its sources apart if its mean AME is above theirs by more than this share of a
#: voxel: what is smaller a map of voxels does not show.
WORSE_BY_VOXELS = 0.5


@dataclass(frozen=True)
class MergeChoices:
    """What the user chose about the score of a merge.

    Attributes:
        align: how the merged map comes into the ground truth's world.
        yaw_correction: radians, added to the start poses; None: none.
        rule: when the merge counts as a success.
        voxel_size: of the sample's maps, metres.
        wall_distance: how far behind or before a surface a second one is looked for, metres.
        ground: rule for the ground that the merged ground truth is projected on, to score an occupancy grid.
        pair, method: names for tables; None: the sample's name, and that of the file of the merge.
    """

    align: MergeAlign = "first"
    yaw_correction: float | None = None
    rule: SuccessRule = field(default_factory=SuccessRule)
    voxel_size: float = 0.05
    wall_distance: float = 0.5
    ground: str = "robust"
    pair: str | None = None
    method: str | None = None


def score_merge(files: MergeFiles, choices: MergeChoices, *, device: str, clock: Stopwatch) -> MergeScore:
    """Score one merge against a sample.

    Args:
        files: what was merged, and how.
        choices: alignment, limits, names.
        device: Warp device.
        clock: collects the stages' times.

    Raises:
        InputError: an input cannot be used, or they do not belong together.
    """
    with clock.stage("read"):
        given = read_merge_inputs(files, choices.yaw_correction)
    transforms, notes = _transforms(given, choices.align)
    errors = None
    if given.transforms is not None and transforms is not None:
        errors = transform_errors(given.T_gt_source, transforms, is_planar=given.transforms.is_planar)
    placement, points = _placed(given, transforms, choices, device, clock)
    ame = _merged_ame(given, points, choices, device, clock)
    ame_2d, ground_notes = _plane_ame(given, transforms, placement, choices, clock)
    is_success, verdict = judge(given.runs, errors, choices.rule, _headline(ame, ame_2d))
    with clock.stage("sources"):
        T_gt_merged = None if placement is None else placement.T_gt_merged
        sources = _source_scores(given, transforms, errors, T_gt_merged, choices.rule, device)
        apart = _apart(given, sources, device)
    gt_note = lattice_note(given.gt_merged, choices.voxel_size)
    notes += [] if gt_note is None else [gt_note]
    notes += ground_notes
    notes += [] if isinstance(ame, NoValue) else _map_notes(ame, apart, choices.voxel_size)
    merge_file = files.transforms or files.merged
    return MergeScore(
        sample=str(files.sample),
        pair=choices.pair or files.sample.resolve().name,
        method=choices.method or _method_of(merge_file),
        merged_map=_merged_name(given, transforms),
        voxel_size=choices.voxel_size,
        rule=choices.rule,
        is_success=is_success,
        verdict=verdict,
        placement=placement,
        sources=sources,
        ame=ame,
        ame_2d=ame_2d,
        apart=apart,
        device=device,
        milliseconds=clock.milliseconds,
        notes=tuple(dict.fromkeys((*given.notes, *notes))),
    )


def _transforms(given: MergeInputs, align: MergeAlign) -> tuple[tuple[Pose | None, ...] | None, list[str]]:
    """The merge's transforms; those of the plane get the sources' true heights."""
    if given.transforms is None:
        return None, []
    transforms = given.transforms.T_merged_source
    reference = reference_of(transforms)
    if not given.transforms.is_planar or reference is None:
        return transforms, []
    base = np.eye(4) if align == "none" else given.T_gt_source[reference]
    note = "the transforms are two-dimensional: errors are those of x, y and yaw, and heights are taken from the truth"
    return with_true_heights(given.T_gt_source, transforms, base), [note]


def _placed(
    given: MergeInputs,
    transforms: tuple[Pose | None, ...] | None,
    choices: MergeChoices,
    device: str,
    clock: Stopwatch,
) -> tuple[MergePlacement | None, Points | NoValue]:
    """The merged map in the ground truth's world, or why there is none."""
    found = _merged_points(given, transforms)
    if isinstance(found, NoValue):
        return None, found
    T_gt_merged = np.eye(4) if choices.align == "none" else first_placement(given.T_gt_source, transforms)
    points = moved(T_gt_merged, found)
    if choices.align != "best":
        return MergePlacement(choices.align, T_gt_merged), points
    with clock.stage("best alignment"):
        T, fit = fit_merged(points, given.gt_merged, choices.voxel_size, device)
    return MergePlacement("best", T @ T_gt_merged, fit), moved(T, points)


def _merged_points(given: MergeInputs, transforms: tuple[Pose | None, ...] | None) -> Points | NoValue:
    """The merged map in its own frame: what was given, or the union of the sources that were merged."""
    if given.merged is not None:
        return given.merged.points
    if transforms is None:
        return NoValue("the merged map is an occupancy grid", asked=False)
    missing = [run for run, T in zip(given.runs, transforms, strict=True) if T is None]
    if len(given.runs) - len(missing) < 2:
        return NoValue(f"not merged: {', '.join(missing)}", asked=True)
    if not given.sources:
        return NoValue("there is no merged map: give the sources' own maps by --source, or --merged", asked=True)
    pairs = zip(transforms, given.sources, strict=True)
    return np.concatenate([moved(T, source.points) for T, source in pairs if T is not None])


def _merged_ame(
    given: MergeInputs, points: Points | NoValue, choices: MergeChoices, device: str, clock: Stopwatch
) -> MergedMapScore | NoValue:
    if isinstance(points, NoValue):
        return points
    with clock.stage("merged map"):
        gt = merged_ground_truth(given.gt_merged, given.gt_runs, choices.voxel_size, "the sample's maps")
        return merged_map_score(points, gt, wall_distance=choices.wall_distance, device=device)


def _plane_ame(
    given: MergeInputs,
    transforms: tuple[Pose | None, ...] | None,
    placement: MergePlacement | None,
    choices: MergeChoices,
    clock: Stopwatch,
) -> tuple[OccupancyScore | NoValue, list[str]]:
    """2D AME of a merged occupancy grid against the projection of the merged ground truth, and notes."""
    if given.grid is None:
        return NoValue("the merged map is no occupancy grid", asked=False), []
    if placement is not None:
        T_gt_merged = placement.T_gt_merged
    elif choices.align == "best":
        raise InputError("--align best", "an occupancy grid alone is not fitted", "use --align first or none")
    else:
        T_gt_merged = np.eye(4) if choices.align == "none" else first_placement(given.T_gt_source, transforms)
    with clock.stage("occupancy grid"):
        grid = VoxelGrid.around(given.gt_merged, choices.voxel_size)
        centers = grid.centers_of(grid.ijk_of(given.gt_merged))
        ground = find_ground(centers, choices.voxel_size, choices.ground, given.camera_heights)
        gt = project(centers, choices.voxel_size, ground)
        return occupancy_errors(moved_grid(T_gt_merged, given.grid), gt), list(gt.notes)


def _headline(ame: MergedMapScore | NoValue, ame_2d: OccupancyScore | NoValue) -> float | None:
    """Mean AME in space, or else in the plane, metres."""
    if not isinstance(ame, NoValue):
        return ame.accuracy.mean
    if isinstance(ame_2d, NoValue) or isinstance(ame_2d.ame, NoValue):
        return None
    return ame_2d.ame.mean


def _source_scores(
    given: MergeInputs,
    transforms: tuple[Pose | None, ...] | None,
    errors: tuple[TransformError | NoValue, ...] | None,
    T_gt_merged: Pose | None,
    rule: SuccessRule,
    device: str,
) -> tuple[SourceScore, ...]:
    reference = None if transforms is None else reference_of(transforms)
    scores = []
    for i, run in enumerate(given.runs):
        T = None if transforms is None else transforms[i]
        error = NoValue("the merge gave no transforms", asked=False) if errors is None else errors[i]
        alone: Statistics | NoValue = NoValue("its own map was not given", asked=False)
        merged = alone
        if given.sources:
            points = given.sources[i].points
            alone = map_error(moved(given.T_gt_source[i], points), given.gt_runs[i], device)
            merged = NoValue("the merge does not place it", asked=False)
            if T is not None and T_gt_merged is not None:
                merged = map_error(moved(T_gt_merged @ T, points), given.gt_runs[i], device)
        scores.append(
            SourceScore(
                name=given.sources[i].source if given.sources else run,
                run=run,
                is_merged=None if transforms is None else T is not None,
                is_reference=i == reference,
                error=error,
                is_success=None if errors is None else i == reference or is_placed_well(error, rule),
                ame_alone=alone,
                ame_merged=merged,
            )
        )
    return tuple(scores)


def _apart(given: MergeInputs, scores: tuple[SourceScore, ...], device: str) -> Apart | NoValue:
    """The sources without the merge: each where it truly lies, and all unmoved in the first one's frame."""
    means = [score.ame_alone.mean for score in scores if not isinstance(score.ame_alone, NoValue)]
    if not given.sources or len(means) < len(scores):
        return NoValue("the sources' own maps were not given", asked=False)
    unmoved = np.concatenate([source.points for source in given.sources])
    together = map_error(moved(given.T_gt_source[0], unmoved), given.gt_merged, device)
    if isinstance(together, NoValue):
        return together
    return Apart(float(np.mean(means)), together.mean)


def _map_notes(ame: MergedMapScore, apart: Apart | NoValue, voxel_size: float) -> list[str]:
    notes = []
    value, lost = ame.accuracy.mean, ame.counts["gt_no_run"]
    if not ame.counts["gt_overlap"]:
        notes.append("the ground-truth maps of the runs do not overlap: nothing is inside the overlap")
    if lost:
        total = ame.counts["gt_points"]
        notes.append(f"{lost} of {total} elements of the merged ground truth are in the map of no run")
    if not isinstance(apart, NoValue):
        if value > apart.sources_mean + WORSE_BY_VOXELS * voxel_size:
            notes.append(
                f"worse than the sources apart: AME {value:.3f} m, theirs on average {apart.sources_mean:.3f} m"
            )
        if value > apart.unmoved:
            notes.append(
                f"worse than none: the sources laid on one another unmoved have an AME of {apart.unmoved:.3f} m"
            )
    return notes


def _merged_name(given: MergeInputs, transforms: tuple[Pose | None, ...] | None) -> str:
    if given.merged is not None:
        return given.merged.source
    merged = sum(T is not None for T in transforms or ())
    return f"union of {merged} of {len(given.runs)} sources" if given.sources and merged > 1 else "none"


def _method_of(merge_file: Path | None) -> str:
    """The name of a merge's file, or of its folder where the file is called what `merge` calls it."""
    if merge_file is None:
        return "merge"
    folder = merge_file.resolve().parent.name
    return folder if merge_file.stem in ("transforms", "merged") and folder else merge_file.stem
