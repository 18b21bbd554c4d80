"""Renders what a camera sees on its way through a scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from maomaps_warp.io.rotations import quaternions_from_matrices
from maomaps_warp.model.camera import Camera
from maomaps_warp.model.frame import Frame, FrameStream
from maomaps_warp.model.trajectory import Trajectory
from maomaps_warp.sim.scene import Scene
from maomaps_warp.threads import thread_count


def render_frames(
    scene: Scene, camera: Camera, trajectory: Trajectory, device: str = "cpu", max_depth: float = 50.0
) -> FrameStream:
    """Depth and colour images of a scene from every pose of a trajectory, rendered when they are read.

    Args:
        scene: what is seen.
        camera: intrinsics of the images.
        trajectory: one frame a pose; frames carry its stamps.
        device: Warp device that renders.
        max_depth: surfaces beyond it are missing in the images, metres along the optical axis.

    Returns:
        A stream whose frames are noiseless and the same, byte for byte, each time they are read.
    """
    import warp as wp

    from maomaps_warp.kernels.render import render_mesh

    mesh = wp.Mesh(
        points=wp.array(scene.vertices, dtype=wp.vec3f, device=device),
        indices=wp.array(scene.triangles.reshape(-1), dtype=wp.int32, device=device),
    )
    face_colors = wp.array(scene.face_colors, dtype=wp.vec3ub, device=device)
    stamps = trajectory.stamps_ns
    quaternions = quaternions_from_matrices(trajectory.T_world_camera[:, :3, :3]).tolist()
    poses = list(zip(trajectory.positions.tolist(), quaternions, strict=True))

    def read(with_colors: bool) -> Iterator[Frame]:
        for index, (position, xyzw) in enumerate(poses):
            depth, colors = render_mesh(
                mesh,
                face_colors if with_colors else None,
                wp.transformf(position, xyzw),
                camera.width,
                camera.height,
                camera.fx,
                camera.fy,
                camera.cx,
                camera.cy,
                max_depth,
                threads=thread_count(device),
            )
            yield Frame(
                index=index,
                stamp_ns=None if stamps is None else int(stamps[index]),
                depth=depth.numpy(),
                colors=None if colors is None else colors.numpy(),
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
