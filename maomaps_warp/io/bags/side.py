"""One side of a comparison out of a bag."""

from __future__ import annotations

from pathlib import Path

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags.cloud import read_bag_cloud
from maomaps_warp.io.bags.frames import read_bag_camera, read_bag_frames
from maomaps_warp.io.bags.topics import BagContents, open_contents
from maomaps_warp.io.bags.trajectory import read_bag_trajectory
from maomaps_warp.io.source import Part, Side, Source, SourceOptions, camera_or_note, notes_of, option
from maomaps_warp.io.tables import HEAD_BYTES, read_bytes, signature


def read_bag(path: Path, options: SourceOptions, side: Side, part: Part = "all") -> Source:
    """Read a side from a bag, which is opened once; its frames are read later, when asked for.

    Args:
        path: the bag, of any kind.
        options: topics, camera and whose poses.
        side: of a bag with both clouds and depth images the ground truth takes the depth, the estimate the
            cloud, unless a topic is named.
        part: what is wanted of it.

    Raises:
        InputError: a damaged bag, no or several topics of a kind, or nothing of what is wanted.
    """
    with open_contents(path, options.topics, option(side, "topic")) as contents:
        cloud = frames = trajectory = None
        camera = options.camera
        notes: tuple[str, ...] = ()
        if part != "trajectory":
            contents.check_named_images()
            no_depth = contents.check_depth_is_readable()
            takes_cloud, notes = _takes_cloud(contents, side)
            notes += no_depth
            if takes_cloud:
                cloud = read_bag_cloud(contents)
                if camera is None:
                    camera, more = camera_or_note(lambda: read_bag_camera(contents))
                    notes += more
            elif contents.depths:
                frames = read_bag_frames(contents, camera=camera, max_color_gap_ns=options.max_color_gap_ns)
                camera = frames.camera
        if part != "map" and contents.poses:
            trajectory = read_bag_trajectory(contents, pose_frame=options.pose_frame)
        if cloud is None and frames is None and trajectory is None:
            wanted = {"all": "neither a map nor poses", "map": "no map", "trajectory": "no poses"}[part]
            listed = "; ".join(map(str, contents.all)) or "none"
            tf = (
                "; /tf is not read: give the poses as a file"
                if any("TFMessage" in t.type for t in contents.all)
                else ""
            )
            raise InputError(path, f"the bag holds {wanted}", f"topics in this bag: {listed}{tf}")
    notes += notes_of(cloud, trajectory)
    return Source(str(path), _kind_of(path), trajectory, cloud, frames, camera, notes=notes)


def _takes_cloud(contents: BagContents, side: Side) -> tuple[bool, tuple[str, ...]]:
    """Whether a cloud is the bag's map, not depth images; and a note where there was a choice."""
    clouds, depths = contents.named("clouds"), contents.named("depths")
    if not clouds and not depths:
        clouds, depths = contents.clouds, contents.depths
    if not clouds or not depths:
        return bool(clouds), ()
    # What a method puts out as its map is the estimate; the ground truth's clouds are often single scans.
    chosen = "the clouds are the map" if side == "est" else "the depth makes the map"
    return side == "est", (f"of clouds and depth images in the bag, {chosen}; {option(side, 'topic')} decides",)


def _kind_of(path: Path) -> str:
    if path.is_dir():
        return "ROS 2 bag folder"
    return (signature(read_bytes(path, HEAD_BYTES)) or "a bag").partition(" ")[2]
