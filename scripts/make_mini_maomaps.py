"""Make a mini-MAOMaps: twenty samples of overlapping runs, from four scenes and four furnished flats.

    python scripts/make_mini_maomaps.py SCENES -o mini_maomaps

SCENES holds the folders scene_aws_small_house, scene_habitat_simple_room, scene_living_room and scene_pal_home; a scene
that is missing is an error. It takes about 50 minutes on two cores and 5.4 GB; interrupted, the same command goes on.
Options after `--` are passed on to `maomaps-warp create-dataset` (`-- --samples 8 --antialias 1`).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

#: Each with what holds for it alone: a house without a floor plane, a single room that a long run sees all of.
SCENES = (
    "scene_aws_small_house/aws_small_house.glb",
    "flat:1",
    "scene_pal_home/pal_home.glb,floor=0",
    "scene_living_room/living_room.glb,duration=5..12",
    "flat:2",
    "scene_habitat_simple_room/simple_room.glb,duration=15..30",
    "flat:3",
    "flat:4",
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, help="folder of the scenes' folders")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the dataset")
    cut = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    asked, options = parser.parse_args(sys.argv[1:cut]), sys.argv[cut + 1 :]
    scenes = [scene if scene.startswith("flat") else str(asked.scenes / scene) for scene in SCENES]
    command = [sys.executable, "-m", "maomaps_warp", "create-dataset", *scenes, "-o", str(asked.output)]
    standard = ["--samples", "20", "--iou", "0.2..0.6", "--duration", "20..45", "--seed", "1"]
    return subprocess.run([*command, *standard, *options], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
