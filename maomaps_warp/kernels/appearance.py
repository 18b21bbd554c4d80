"""What a surface looks like where a ray meets it: textures, vertex colours, light.

The light is the same everywhere and every time: a share from all sides, one from the camera, one from above. Both sides
of a face look alike.
"""

import numpy as np
import warp as wp

#: Shares of the light: from everywhere, from the camera, from above; dimensionless, their sum is 1.
_AMBIENT = wp.constant(wp.float32(0.48))
_HEADLIGHT = wp.constant(wp.float32(0.34))
_SKYLIGHT = wp.constant(wp.float32(0.18))
#: Edge of the grains that a surface may have, metres.
_GRAIN_SIZE = wp.constant(wp.float32(0.023))
#: How far behind the surface the grain is sampled, metres: a face between grains would flicker otherwise.
_GRAIN_INSET = wp.constant(wp.float32(0.004))


@wp.struct
class Appearance:
    """Colours of a mesh of F triangles: of a texture, times those of the corners if corners have some."""

    texels: wp.array(dtype=wp.vec3ub)  # RGB of all textures, row by row from the top, one texture after the other
    first_texel: wp.array(dtype=wp.int32)  # (T,) where each texture begins
    rows: wp.array(dtype=wp.int32)  # (T,) its height
    columns: wp.array(dtype=wp.int32)  # (T,) and width
    face_texture: wp.array(dtype=wp.int32)  # (F,)
    corner_uv: wp.array(dtype=wp.vec2)  # (3 F,) from the texture's lower left corner, 1 its edge; it repeats. Or empty
    corner_colors: wp.array(dtype=wp.vec3ub)  # (3 F,) RGB, or empty
    grain: wp.float32  # by what share the brightness changes from grain to grain; 0: smooth surfaces
    is_lit: wp.bool  # False: colours as they are


@wp.func
def _rest(i: wp.int32, n: wp.int32) -> wp.int32:
    return ((i % n) + n) % n


@wp.func
def _as_floats(color: wp.vec3ub) -> wp.vec3:
    return wp.vec3(wp.float32(color[0]), wp.float32(color[1]), wp.float32(color[2]))


@wp.func
def texture_color(look: Appearance, face: wp.int32, u: wp.float32, v: wp.float32, w: wp.float32) -> wp.vec3:
    """Texture of a face at barycentric coordinates u, v, w of its corners, 0..255, bilinear between texels."""
    texture = look.face_texture[face]
    first = look.first_texel[texture]
    rows = look.rows[texture]
    columns = look.columns[texture]
    color = _as_floats(look.texels[first])
    if rows * columns > 1:
        uv = u * look.corner_uv[3 * face] + v * look.corner_uv[3 * face + 1] + w * look.corner_uv[3 * face + 2]
        # The middle of the upper left texel is at (0.5 / columns, 1 - 0.5 / rows).
        x = (uv[0] - wp.floor(uv[0])) * wp.float32(columns) - 0.5
        y = (1.0 - (uv[1] - wp.floor(uv[1]))) * wp.float32(rows) - 0.5
        column = wp.int32(wp.floor(x))
        row = wp.int32(wp.floor(y))
        share_x = x - wp.float32(column)
        share_y = y - wp.float32(row)
        left = _rest(column, columns)
        right = _rest(column + 1, columns)
        above = first + _rest(row, rows) * columns
        below = first + _rest(row + 1, rows) * columns
        upper = (1.0 - share_x) * _as_floats(look.texels[above + left]) + share_x * _as_floats(
            look.texels[above + right]
        )
        lower = (1.0 - share_x) * _as_floats(look.texels[below + left]) + share_x * _as_floats(
            look.texels[below + right]
        )
        color = (1.0 - share_y) * upper + share_y * lower
    return color


@wp.func
def grain(point: wp.vec3f, contrast: wp.float32) -> wp.float32:
    """Brightness factor of a surface point (metres): one pseudo-random value for each small cube of space."""
    i = wp.int32(wp.floor(point[0] / _GRAIN_SIZE))
    j = wp.int32(wp.floor(point[1] / _GRAIN_SIZE))
    k = wp.int32(wp.floor(point[2] / _GRAIN_SIZE))
    # Teschner et al. 2003, Optimized spatial hashing: three large primes, here followed by one more mix.
    mixed = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791)
    mixed = (mixed ^ (mixed >> 13)) * 1274126177
    share = wp.float32((mixed >> 16) & 255) / 255.0
    return 1.0 + contrast * (2.0 * share - 1.0)


@wp.func
def color_of_hit(
    look: Appearance,
    face: wp.int32,
    u: wp.float32,
    v: wp.float32,
    point: wp.vec3,
    normal: wp.vec3,
    direction: wp.vec3,
) -> wp.vec3:
    """Colour of a surface point, RGB 0..255.

    Args:
        look: the surface.
        face: which was met.
        u, v: barycentric coordinates of its first two corners.
        point: where, metres, world, z up.
        normal: unit vector of either sign, world.
        direction: the ray's, world, of any length.
    """
    w = 1.0 - u - v
    color = texture_color(look, face, u, v, w)
    if look.corner_colors.shape[0] > 0:
        tint = u * _as_floats(look.corner_colors[3 * face]) + v * _as_floats(look.corner_colors[3 * face + 1])
        tint = tint + w * _as_floats(look.corner_colors[3 * face + 2])
        color = wp.cw_mul(color, tint) / 255.0
    light = wp.float32(1.0)
    facing = wp.dot(normal, wp.normalize(direction))
    if look.is_lit:
        upward = wp.where(facing > 0.0, -normal[2], normal[2])
        light = _AMBIENT + _HEADLIGHT * wp.abs(facing) + _SKYLIGHT * (0.5 + 0.5 * upward)
    if look.grain > 0.0:
        inset = wp.where(facing > 0.0, _GRAIN_INSET, -_GRAIN_INSET)
        light = light * grain(point + inset * normal, look.grain)
    return light * color


def create_appearance(
    textures: list[np.ndarray],
    face_texture: np.ndarray,
    corner_uv: np.ndarray | None = None,
    corner_colors: np.ndarray | None = None,
    *,
    grain: float = 0.0,
    is_lit: bool = True,
    device: str | None = None,
) -> Appearance:
    """Put what a mesh of F triangles looks like on a device.

    Args:
        textures: (h, w, 3) uint8 RGB each, the first row on top; (1, 1, 3) is a plain colour.
        face_texture: (F,) int32, the texture of each face.
        corner_uv: (F, 3, 2) float32, texture coordinates of the corners of each face, v upwards; not needed where all
            textures are plain.
        corner_colors: (F, 3, 3) uint8 RGB, colours of the corners, which the textures are multiplied by.
        grain: by what share the brightness changes from grain to grain.
        is_lit: False: colours as they are, without light.
        device: Warp device.

    Raises:
        ValueError: a wrong shape, a texture that is missing, or no coordinates for one.
    """
    faces = len(face_texture)
    shapes = np.array([texture.shape[:2] for texture in textures], dtype=np.int32).reshape(-1, 2)
    if any(texture.shape != (*shape, 3) or texture.size == 0 for texture, shape in zip(textures, shapes, strict=True)):
        raise ValueError("textures: expected (h, w, 3) each, with at least one texel")
    if faces and not (0 <= face_texture.min() and face_texture.max() < len(textures)):
        raise ValueError(f"face_texture: expected 0 to {len(textures) - 1}, got {face_texture.max()}")
    if corner_uv is None and faces and (shapes[face_texture].prod(axis=1) > 1).any():
        raise ValueError("corner_uv: needed, not all textures are plain")
    for name, array, width in (("corner_uv", corner_uv, 2), ("corner_colors", corner_colors, 3)):
        if array is not None and array.shape != (faces, 3, width):
            raise ValueError(f"{name}: expected ({faces}, 3, {width}), got {array.shape}")
    texels = shapes.prod(axis=1, dtype=np.int64)
    look = Appearance()
    look.texels = wp.array(
        np.concatenate([np.empty((0, 3), np.uint8), *(texture.reshape(-1, 3) for texture in textures)]),
        dtype=wp.vec3ub,
        device=device,
    )
    look.first_texel = wp.array(np.cumsum(texels) - texels, dtype=wp.int32, device=device)
    look.rows, look.columns = (wp.array(shapes[:, a].copy(), dtype=wp.int32, device=device) for a in range(2))
    look.face_texture = wp.array(face_texture, dtype=wp.int32, device=device)
    uv = np.empty((0, 2)) if corner_uv is None else corner_uv.reshape(-1, 2)
    colors = np.empty((0, 3)) if corner_colors is None else corner_colors.reshape(-1, 3)
    look.corner_uv = wp.array(uv, dtype=wp.vec2, device=device)
    look.corner_colors = wp.array(colors, dtype=wp.vec3ub, device=device)
    look.grain = grain
    look.is_lit = is_lit
    return look
