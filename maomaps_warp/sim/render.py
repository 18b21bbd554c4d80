"""Renders what a camera sees on its way through a world."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from maomaps_warp.io.rotations import quaternions_from_matrices
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.world import World
from maomaps_warp.threads import thread_count

if TYPE_CHECKING:
    from maomaps_warp.kernels.render import MeshScene

#: Metres along the optical axis.
MAX_DEPTH = 50.0


@dataclass(frozen=True)
class RenderOptions:
    """How images are rendered.

    Attributes:
        max_depth: surfaces beyond it are missing in the images, metres along the optical axis.
        samples: colours are the mean of samples x samples rays a pixel.
        is_lit: False: the world's colours as they are, without light.
        are_back_faces_seen: True: faces that show only their front are seen from behind, too.
    """

    max_depth: float = MAX_DEPTH
    samples: int = 1
    is_lit: bool = True
    are_back_faces_seen: bool = False


def scene_of(world: World, options: RenderOptions, device: str, *, with_colors: bool = True) -> MeshScene:
    """A world on a device, as kernels render it."""
    import warp as wp

    from maomaps_warp.kernels.appearance import create_appearance
    from maomaps_warp.kernels.render import MeshScene

    look = None
    if with_colors:
        look = create_appearance(
            list(world.textures),
            world.face_texture,
            world.corner_uv,
            world.corner_colors,
            grain=world.grain,
            is_lit=options.is_lit,
            device=device,
        )
    shown = np.full(len(world.triangles), options.are_back_faces_seen) | world.is_double_sided
    return MeshScene(
        wp.Mesh(
            points=wp.array(world.vertices, dtype=wp.vec3f, device=device),
            indices=wp.array(world.triangles.reshape(-1), dtype=wp.int32, device=device),
        ),
        look,
        wp.array(shown.astype(np.uint8), dtype=wp.uint8, device=device),
        wp.array(world.face_part, dtype=wp.int32, device=device),
    )


def render_frames(
    world: World,
    camera: Camera,
    trajectory: Trajectory,
    device: str = "cpu",
    options: RenderOptions | None = None,
) -> FrameStream:
    """Depth and colour images of a world from every pose of a trajectory, rendered when they are read.

    Args:
        world: what is seen.
        camera: intrinsics of the images.
        trajectory: one frame a pose; frames carry its stamps.
        device: Warp device that renders.
        options: how; None: as RenderOptions are by default.

    Returns:
        A stream whose frames are noiseless and the same, byte for byte, each time they are read.
    """
    import warp as wp

    from maomaps_warp.kernels.render import render_scene, view_from

    options = options or RenderOptions()
    scene = scene_of(world, options, device)
    bare = replace(scene, look=None)
    stamps = trajectory.stamps_ns
    quaternions = quaternions_from_matrices(trajectory.T_world_camera[:, :3, :3]).tolist()
    poses = list(zip(trajectory.positions.tolist(), quaternions, strict=True))
    lens = (camera.width, camera.fx, camera.fy, camera.cx, camera.cy, options.max_depth)

    def read(with_colors: bool) -> Iterator[Frame]:
        for index, (position, xyzw) in enumerate(poses):
            images = render_scene(
                scene if with_colors else bare,
                view_from(wp.transformf(position, xyzw), *lens),
                camera.height,
                samples=options.samples,
                threads=thread_count(device),
            )
            yield Frame(
                index=index,
                stamp_ns=None if stamps is None else int(stamps[index]),
                depth=images.depth.numpy(),
                colors=None if images.colors is None else images.colors.numpy(),
            )

    return FrameStream(camera, len(trajectory), read, "simulated camera")


def in_memory(stream: FrameStream) -> FrameStream:
    """The same stream, read once with its colours and kept, so that reading it again costs no rendering.

    Takes 7 bytes a pixel and frame: 129 MB for 240 frames of 320 x 240.
    """
    frames = tuple(stream.read(True))

    def read(with_colors: bool) -> Iterator[Frame]:
        return iter(frames if with_colors else [replace(frame, colors=None) for frame in frames])

    return FrameStream(stream.camera, len(frames), read, stream.source)
