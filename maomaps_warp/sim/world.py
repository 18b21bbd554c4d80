"""The worlds that cameras look at."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class World:
    """A triangle mesh and what it looks like. Metres, right-handed, z up.

    Attributes:
        vertices: (V, 3) float32, metres.
        triangles: (F, 3) int32, counter-clockwise seen from their front.
        textures: (h, w, 3) uint8 each, sRGB, the first row on top; (1, 1, 3) is a plain colour.
        face_texture: (F,) int32.
        corner_uv: (F, 3, 2) float32, texture coordinates, v upwards; None where all textures are plain.
        corner_colors: (F, 3, 3) uint8, sRGB, what textures are multiplied by; None without.
        is_double_sided: (F,) bool; False where a face is not seen from behind.
        parts: names of what the mesh is made of.
        face_part: (F,) int32, the part that each face belongs to.
        grain: by what share the brightness changes from grain to grain, so that plain walls have features; 0: not.
        source: where it comes from, for messages.
        notes: what a user should know of how it was read.
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    textures: tuple[NDArray[np.uint8], ...]
    face_texture: NDArray[np.int32]
    corner_uv: NDArray[np.float32] | None
    corner_colors: NDArray[np.uint8] | None
    is_double_sided: NDArray[np.bool_]
    parts: tuple[str, ...]
    face_part: NDArray[np.int32]
    grain: float = 0.0
    source: str = "scene"
    notes: tuple[str, ...] = ()

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner of the triangles' box, (2, 3), metres."""
        corners = self.vertices[self.triangles.reshape(-1)]
        return np.stack([corners.min(axis=0), corners.max(axis=0)]).astype(np.float64)

    @property
    def digest(self) -> str:
        """SHA-256 of all that can be seen of it, whatever files it came from."""
        digest = hashlib.sha256(f"{self.parts} {self.grain!r}".encode())
        arrays = [self.vertices, self.triangles, self.face_texture, self.corner_uv, self.corner_colors]
        for array in (*arrays, self.is_double_sided, self.face_part, *self.textures):
            if array is not None:
                digest.update(f"{array.dtype} {array.shape}".encode())
                digest.update(array.tobytes())
        return digest.hexdigest()


def plain_world(
    vertices: NDArray[np.float32],
    triangles: NDArray[np.int32],
    face_colors: NDArray[np.uint8],
    *,
    grain: float = 0.0,
    source: str = "scene",
) -> World:
    """A mesh with one colour a face, (F, 3) uint8, seen from both sides."""
    palette, which = np.unique(face_colors.reshape(-1, 3), axis=0, return_inverse=True)
    return World(
        vertices,
        triangles,
        tuple(color.reshape(1, 1, 3) for color in palette),
        which.reshape(-1).astype(np.int32),
        None,
        None,
        np.ones(len(triangles), dtype=bool),
        ("scene",),
        np.zeros(len(triangles), dtype=np.int32),
        grain,
        source,
    )
