"""Renders what a camera sees on its way through a world."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.io.rotations import quaternions_from_matrices
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.simulator import Seen, simulated_frames
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
        with_normals, with_parts: those images, too, beside the colours.
    """

    max_depth: float = MAX_DEPTH
    samples: int = 1
    is_lit: bool = True
    are_back_faces_seen: bool = False
    with_normals: bool = False
    with_parts: bool = False


def scene_of(world: World, options: RenderOptions, device: str, *, with_colors: bool = True) -> MeshScene:
    """A world on a device, as kernels render it."""
    import warp as wp

    from maomaps_warp.kernels.appearance import create_appearance
    from maomaps_warp.kernels.render import MeshScene
    from maomaps_warp.kernels.triangle_tree import build_triangle_tree

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
    points = wp.array(world.vertices, dtype=wp.vec3f, device=device)
    corners = wp.array(world.triangles.reshape(-1), dtype=wp.int32, device=device)
    return MeshScene(
        build_triangle_tree(points, corners) if points.device.is_cpu else wp.Mesh(points, corners),
        look,
        wp.array(shown.astype(np.uint8), dtype=wp.uint8, device=device),
        wp.array(world.face_part, dtype=wp.int32, device=device),
    )


class MeshSimulator:
    """Sees a world as a pinhole camera does."""

    def __init__(
        self,
        world: World,
        camera: Camera,
        device: str = "cpu",
        options: RenderOptions | None = None,
        *,
        has_colors: bool = True,
    ) -> None:
        """Puts the world on a device; `options` None: as RenderOptions are by default."""
        self.camera = camera
        self.source = "simulated camera"
        self._options = options or RenderOptions()
        self._scene = scene_of(world, self._options, device, with_colors=has_colors)
        self._bare = replace(self._scene, look=None)
        self._threads = thread_count(device)

    def see(self, T_world_camera: NDArray[np.float64], *, with_colors: bool = True) -> Seen:
        """Noiseless images from a pose, (4, 4); the same, byte for byte, each time."""
        import warp as wp

        from maomaps_warp.kernels.pixels import view_from
        from maomaps_warp.kernels.render import render_scene

        camera, options = self.camera, self._options
        (xyzw,) = quaternions_from_matrices(T_world_camera[None, :3, :3]).tolist()
        pose = wp.transformf(T_world_camera[:3, 3].tolist(), xyzw)
        images = render_scene(
            self._scene if with_colors else self._bare,
            view_from(pose, camera.width, camera.fx, camera.fy, camera.cx, camera.cy, options.max_depth),
            camera.height,
            samples=options.samples,
            with_normals=with_colors and options.with_normals,
            with_parts=with_colors and options.with_parts,
            threads=self._threads,
        )
        extras = {"normals": images.normals, "parts": images.parts}
        return Seen(
            images.depth.numpy(),
            None if images.colors is None else images.colors.numpy(),
            {name: image.numpy() for name, image in extras.items() if image is not None},
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
    return simulated_frames(MeshSimulator(world, camera, device, options), trajectory)


def in_memory(stream: FrameStream) -> FrameStream:
    """The same stream, read once with its colours and kept, so that reading it again costs no rendering.

    Takes 7 bytes a pixel and frame: 129 MB for 240 frames of 320 x 240.
    """
    frames = tuple(stream.read(True))

    def read(with_colors: bool) -> Iterator[Frame]:
        return iter(frames if with_colors else [replace(frame, colors=None) for frame in frames])

    return FrameStream(stream.camera, len(frames), read, stream.source)
