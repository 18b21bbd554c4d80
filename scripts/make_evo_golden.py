"""Record what evo says about real trajectories, as golden values for the tests.

evo (https://github.com/MichaelGrupp/evo, GPL-3.0) is neither a dependency nor imported: its command line is
run as a program of its own. Install it anywhere, put its `evo_ape` and `evo_rpe` on the PATH, then

    python scripts/make_evo_golden.py --data DIR --out tests/golden

where DIR holds `traj_evo/` and `rgbd_tum_fr1_rpy_a/` (TUM RGB-D, KITTI and EuRoC trajectories). Where poses
share a stamp evo would compare all of them; it is given the first of each only, because ours has but one.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Case:
    """One estimate and its ground truth: evo's name of the format, files under DIR, alignments to record."""

    name: str
    format: str
    gt: str
    est: str
    alignments: tuple[str, ...]


CASES = (
    Case(
        "fr1_xyz_rgbdslam",
        "tum",
        "traj_evo/freiburg1_xyz-groundtruth.txt",
        "traj_evo/freiburg1_xyz-rgbdslam.txt",
        ("none", "se3", "sim3"),
    ),
    Case(
        "fr1_xyz_rgbdslam_drift",
        "tum",
        "traj_evo/freiburg1_xyz-groundtruth.txt",
        "traj_evo/freiburg1_xyz-rgbdslam_drift.txt",
        ("none", "se3"),
    ),
    Case(
        "fr1_xyz_orb_mono",
        "tum",
        "traj_evo/freiburg1_xyz-groundtruth.txt",
        "traj_evo/freiburg1_xyz-ORB_kf_mono.txt",
        ("none", "sim3"),
    ),
    Case(
        "fr2_desk_orb",
        "tum",
        "traj_evo/fr2_desk_groundtruth.txt",
        "traj_evo/fr2_desk_ORB.txt",
        ("none", "se3"),
    ),
    Case(
        "fr1_rpy_dvo",
        "tum",
        "rgbd_tum_fr1_rpy_a/groundtruth.txt",
        "rgbd_tum_fr1_rpy_a/estimated_dvo.txt",
        ("none", "se3", "sim3"),
    ),
    Case(
        "kitti_00_orb",
        "kitti",
        "traj_evo/KITTI_00_gt.txt",
        "traj_evo/KITTI_00_ORB.txt",
        ("none", "se3", "sim3"),
    ),
    Case(
        "kitti_00_sptam",
        "kitti",
        "traj_evo/KITTI_00_gt.txt",
        "traj_evo/KITTI_00_SPTAM.txt",
        ("none", "se3", "sim3"),
    ),
    Case("euroc_v102", "euroc", "traj_evo/V102_groundtruth.csv", "traj_evo/V102.txt", ("none", "se3")),
)

#: Our name of an alignment -> evo's options.
ALIGNMENTS = {"none": (), "se3": ("--align",), "sim3": ("--align", "--correct_scale")}

#: Our name of an error -> evo's.
RELATIONS = {"translation": "trans_part", "rotation": "angle_rad"}

#: RPE: delta, our unit, evo's unit, all pairs.
DELTAS = ((1, "frames", "f", False), (10, "frames", "f", False), (0.5, "metres", "m", False))
ALL_PAIRS_DELTAS = ((10, "frames", "f", True), (0.5, "metres", "m", True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    version = subprocess.run(["evo", "pkg", "--version"], check=True, capture_output=True, text=True).stdout
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(args.jobs) as pool:
            files = [first_of_each_stamp(args.data / file, case.format, Path(folder)) for file in (case.gt, case.est)]
            results = list(pool.map(lambda job, case=case, files=files: record(case, files, job), jobs(case)))
        golden = {
            "evo": version.strip(),
            "format": case.format,
            "gt": case.gt,
            "est": case.est,
            "results": results,
        }
        path = args.out / f"evo_{case.name}.json"
        path.write_text(json.dumps(golden, indent=1) + "\n")
        print(path)


def jobs(case: Case) -> list[dict[str, Any]]:
    """What to ask evo about a case; each entry becomes a result in the file."""
    asked = []
    for alignment in case.alignments:
        for errors in RELATIONS:
            common = {"align": alignment, "errors": errors}
            asked.append({"metric": "ape", **common})
            deltas = DELTAS + (ALL_PAIRS_DELTAS if alignment == "none" else ())
            for delta, unit, flag, all_pairs in deltas:
                pairing = {"delta": delta, "unit": unit, "evo_unit": flag, "all_pairs": all_pairs}
                asked.append({"metric": "rpe", **common, **pairing})
    return asked


def first_of_each_stamp(path: Path, format: str, folder: Path) -> Path:
    """A copy of a trajectory file in `folder`, without poses that repeat a stamp."""
    lines = path.read_text().splitlines()
    if format != "kitti":
        poses = {}
        for line in (line for line in lines if line.strip() and not line.startswith("#")):
            poses.setdefault(float(line.replace(",", " ").split()[0]), line)
        lines = list(poses.values())
    copy = folder / path.name
    copy.write_text("\n".join(lines) + "\n")
    return copy


def record(case: Case, files: list[Path], job: dict[str, Any]) -> dict[str, Any]:
    """Run evo once and read its result file; `stats` is None where evo finds no pair."""
    command = [f"evo_{job['metric']}", case.format, *map(str, files)]
    command += ["--pose_relation", RELATIONS[job["errors"]], *ALIGNMENTS[job["align"]], "--no_warnings"]
    if job["metric"] == "rpe":
        command += ["--delta", str(job["delta"]), "--delta_unit", job["evo_unit"], "--pairs_from_reference"]
        command += ["--all_pairs"] if job["all_pairs"] else []
    entry = {key: value for key, value in job.items() if key != "evo_unit"}
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.zip"
        done = subprocess.run([*command, "--save_results", str(result)], capture_output=True, text=True)
        if "produced an empty index list" in done.stdout + done.stderr:  # evo's words for: no motion is that long
            return {**entry, "stats": None, "pairs": 0}
        if not result.exists():
            raise SystemExit(f"{' '.join(command)} failed:\n{done.stdout}{done.stderr}")
        with zipfile.ZipFile(result) as archive:
            entry["stats"] = json.loads(archive.read("stats.json"))
            size = archive.getinfo("error_array.npy").file_size
    entry["pairs"] = round((size - 128) / 8)  # float64 values after the 128 bytes of an .npy header
    return entry


if __name__ == "__main__":
    main()
