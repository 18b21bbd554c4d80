"""Scenes from files: glTF (GLB), PLY and OBJ, with textures, vertex colours and several parts.

trimesh reads the files; what is here decides what they mean: which way is up, in which unit, which colours.
"""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.errors import InputError
from maomaps_warp.sim.world import World

Up = Literal["auto", "y", "z"]
Unit = Literal["m", "cm", "mm"]

#: Metres of one unit.
_METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
#: The way up where a file does not say: glTF demands y; most PLY of scanners have z up, OBJ of modellers y.
_UP_BY_SUFFIX: dict[str, Literal["y", "z"]] = {".glb": "y", ".gltf": "y", ".obj": "y", ".ply": "z"}
#: Turns y up to z up: x stays, y becomes z, z becomes -y.
_Z_UP_FROM_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
#: No building is wider or flatter than this, metres: another unit, or a part that is no furniture.
_WIDEST_M = 100.0
_NARROWEST_M = 0.5
#: So far from the origin float32 still resolves 0.25 mm, metres.
_FARTHEST_M = 2048.0
_WHITE = np.full((1, 1, 3), 255, dtype=np.uint8)


@dataclass(frozen=True)
class SceneOptions:
    """How a scene's file is to be read.

    Attributes:
        up: which axis points upwards; "auto": what a Habitat `.stage_config.json` beside the file says, else y for glTF
            and OBJ, z for PLY.
        unit: of its coordinates.
        drop: names of parts to leave out.
    """

    up: Up = "auto"
    unit: Unit = "m"
    drop: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Part:
    """One mesh of a file, in the file's own coordinates."""

    name: str
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    texture: NDArray[np.uint8]
    uv: NDArray[np.float32] | None
    colors: NDArray[np.uint8] | None
    is_double_sided: bool


def read_world(path: Path, options: SceneOptions | None = None) -> World:
    """Read a scene.

    Args:
        path: .glb, .gltf, .ply or .obj.
        options: how; None: as SceneOptions are by default.

    Returns:
        The world in metres, z up. Textures are multiplied by their materials' base colours; transparency is not shown.

    Raises:
        InputError: no such file, damaged, without triangles, not finite, of absurd size, or no trimesh is installed.
    """
    options = options or SceneOptions()
    path = Path(path)
    if path.suffix.lower() not in _UP_BY_SUFFIX:
        raise InputError(path, "is no scene", f"scenes are {', '.join(_UP_BY_SUFFIX)}")
    if path.is_dir():
        raise InputError(path, "is a folder", "name the scene's file")
    if not path.is_file():
        raise InputError(path, "no such file")
    if not path.stat().st_size:
        raise InputError(path, "is empty")
    notes: list[str] = []
    parts = _kept(path, _read_parts(path, notes), options.drop)
    up = _up_axis(path, options.up, notes)
    scale = _METRES[options.unit]
    turn = scale * (_Z_UP_FROM_Y_UP if up == "y" else np.eye(3))
    moved = [part.vertices @ turn.T for part in parts]
    _check_size(path, parts, moved, options.unit)
    _say_what_looks_lying(moved, up, options.up, notes)
    return _joined(path, parts, moved, notes)


def _read_parts(path: Path, notes: list[str]) -> list[_Part]:
    try:
        import trimesh
    except ImportError:
        raise InputError(
            path, "trimesh, which reads scenes, is not installed", "pip install 'maomaps-warp[scenes]'"
        ) from None
    with _complaints(notes):
        try:
            scene = trimesh.load_scene(path, process=False)
        except Exception as error:  # whatever its many readers raise for damaged files
            reason = str(error) or type(error).__name__
            raise InputError(path, f"cannot be read as a scene: {reason}", "export it anew") from error
        parts = []
        for node in sorted(scene.graph.nodes_geometry, key=str):  # in trimesh's order they change from run to run
            transform, name = scene.graph[node]
            mesh = scene.geometry[name]
            if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
                parts.append(_part_of(path, str(node), mesh, np.asarray(transform, dtype=np.float64)))
    if not parts:
        raise InputError(path, "holds no triangles", "a scene is a surface: points and lines cannot be seen")
    return parts


def _part_of(path: Path, name: str, mesh: Any, transform: NDArray[np.float64]) -> _Part:
    vertices = np.asarray(mesh.vertices, dtype=np.float64) @ transform[:3, :3].T + transform[:3, 3]
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        more = f"; {len(bad)} of {len(vertices)} are so" if len(bad) > 1 else ""
        raise InputError(path, f"part {name!r}: vertex {bad[0]} is not finite{more}", "repair the mesh")
    triangles = np.asarray(mesh.faces, dtype=np.int64)
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        found = f"part {name!r}: a triangle has vertex {triangles.max()}, but there are {len(vertices)}"
        raise InputError(path, found, "export it anew")
    if np.linalg.det(transform[:3, :3]) < 0.0:
        triangles = triangles[:, ::-1]  # a mirrored part shows its other side
    texture, uv, is_double_sided = _WHITE, None, True
    colors: NDArray[np.uint8] | None = None
    if mesh.visual.kind == "vertex":
        colors = np.asarray(mesh.visual.vertex_colors, dtype=np.uint8)[:, :3]
    elif mesh.visual.kind == "face":
        # Corners of their own for each face: then the colours are those of vertices.
        vertices, colors = vertices[triangles.reshape(-1)], np.repeat(mesh.visual.face_colors[:, :3], 3, axis=0)
        triangles = np.arange(len(vertices)).reshape(-1, 3)
    elif mesh.visual.kind == "texture":
        texture, is_double_sided = _texture_of(path, name, mesh.visual.material)
        given = mesh.visual.uv
        if given is not None and len(given) == len(vertices):
            uv = np.asarray(given, dtype=np.float32)[:, :2]
        elif texture.shape[:2] != (1, 1):
            texture = np.rint(texture.reshape(-1, 3).mean(axis=0)).astype(np.uint8).reshape(1, 1, 3)
    return _Part(name, vertices, triangles, texture, uv, colors, is_double_sided)


def _texture_of(path: Path, name: str, material: Any) -> tuple[NDArray[np.uint8], bool]:
    """Base colour of a material as a texture, sRGB, and whether its faces are seen from behind."""
    if hasattr(material, "baseColorFactor"):
        # glTF 2.0, 3.9.2: the factor is linear, the texture sRGB; 3.9.6: faces are single-sided unless it says so.
        factor, image = material.baseColorFactor, material.baseColorTexture
        shade = np.ones(3) if factor is None else np.asarray(factor, dtype=np.float64)[:3] / 255.0
        table = _encoded(shade[:, None] * _decoded(np.arange(256) / 255.0))
        is_double_sided = bool(material.doubleSided)
    else:
        factor, image = getattr(material, "diffuse", None), getattr(material, "image", None)
        shade = np.ones(3) if factor is None or image is not None else np.asarray(factor, dtype=np.float64)[:3] / 255.0
        table = shade[:, None] * np.arange(256) / 255.0
        is_double_sided = True  # these formats do not say
    try:
        texels = _WHITE if image is None else np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (OSError, ValueError) as error:  # pixels are decoded here, not when the file is opened
        raise InputError(path, f"part {name!r}: its texture cannot be read: {error}", "export it anew") from error
    levels = np.rint(255.0 * table).astype(np.uint8)
    return np.stack([levels[channel][texels[:, :, channel]] for channel in range(3)], axis=2), is_double_sided


def _decoded(srgb: NDArray[np.float64]) -> NDArray[np.float64]:
    # IEC 61966-2-1
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _encoded(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _kept(path: Path, parts: list[_Part], drop: Sequence[str]) -> list[_Part]:
    names = {part.name for part in parts}
    for name in drop:
        if name not in names:
            known = ", ".join(sorted(names)[:8]) + (", ..." if len(names) > 8 else "")
            raise InputError(path, f"has no part {name!r} to drop", f"its parts: {known}")
    kept = [part for part in parts if part.name not in drop]
    if not kept:
        raise InputError(path, "nothing is left after dropping its parts")
    return kept


def _up_axis(path: Path, up: Up, notes: list[str]) -> Literal["y", "z"]:
    if up != "auto":
        return up
    config = path.with_suffix(".stage_config.json")
    if config.is_file():
        try:
            told = np.asarray(json.loads(config.read_text(encoding="utf-8"))["up"], dtype=np.float64)
            axis = {(0, 1, 0): "y", (0, 0, 1): "z"}[tuple(np.rint(told).astype(int).tolist())]
        except (OSError, ValueError, KeyError, TypeError) as error:
            hint = 'expected "up": [0, 1, 0] or [0, 0, 1]; or say --up'
            raise InputError(config, f"does not say which way is up: {error}", hint) from error
        notes.append(f"{axis} is up, as {config.name} says")
        return "y" if axis == "y" else "z"
    return _UP_BY_SUFFIX[path.suffix.lower()]


def _check_size(path: Path, parts: list[_Part], moved: list[NDArray[np.float64]], unit: Unit) -> None:
    sizes = [np.ptp(vertices, axis=0).max() for vertices in moved]
    low, high = np.min([v.min(axis=0) for v in moved], axis=0), np.max([v.max(axis=0) for v in moved], axis=0)
    width = float((high - low).max())
    reach = float(np.abs([low, high]).max())
    if width <= _WIDEST_M and reach > _FARTHEST_M:
        hint = "float32 places surfaces there by millimetres at best: move it to the origin first"
        raise InputError(path, f"lies {reach:.7g} m from its origin", hint)
    if width > _WIDEST_M:
        worst = int(np.argmax(sizes))
        others = [size for place, size in enumerate(sizes) if place != worst]
        if others and max(others) <= _WIDEST_M < sizes[worst]:
            found = f"part {parts[worst].name!r} is {sizes[worst]:.4g} m wide, all others up to {max(others):.3g} m"
            raise InputError(path, found, f"--drop {parts[worst].name!r} leaves it out")
        hint = "a room is some metres wide: is it in centimetres (--unit cm) or millimetres (--unit mm)?"
        raise InputError(path, f"is {width:.4g} m wide, read in {unit}", hint)
    if width < _NARROWEST_M:
        raise InputError(path, f"is {width:.3g} m wide, read in {unit}", "a room is some metres wide: see --unit")


def _say_what_looks_lying(moved: list[NDArray[np.float64]], up: str, asked: Up, notes: list[str]) -> None:
    if asked != "auto":
        return
    low, high = np.min([v.min(axis=0) for v in moved], axis=0), np.max([v.max(axis=0) for v in moved], axis=0)
    size = high - low
    if size[2] > 2.0 * size[1]:
        other = "z" if up == "y" else "y"
        seen = f"{size[2]:.3g} m high and {size[1]:.3g} m deep"
        notes.append(f"read with {up} up it is {seen}: if it lies on its side, --up {other}")


def _joined(path: Path, parts: list[_Part], moved: list[NDArray[np.float64]], notes: list[str]) -> World:
    textures: dict[bytes, int] = {}
    kept: list[NDArray[np.uint8]] = []
    which = []
    for part in parts:
        key = part.texture.shape[0].to_bytes(4, "little") + part.texture.tobytes()
        if key not in textures:
            textures[key] = len(kept)
            kept.append(part.texture)
        which.append(textures[key])
    starts = np.cumsum([0, *map(len, moved)])
    faces = [len(part.triangles) for part in parts]
    triangles = np.concatenate([part.triangles + start for part, start in zip(parts, starts[:-1], strict=True)])
    has_uv = any(texture.shape[:2] != (1, 1) for texture in kept)
    has_colors = any(part.colors is not None for part in parts)
    return World(
        np.concatenate(moved).astype(np.float32),
        triangles.astype(np.int32),
        tuple(kept),
        np.repeat(np.array(which, dtype=np.int32), faces),
        _corners([(part, part.uv, (2,), np.float32, 0) for part in parts]) if has_uv else None,
        _corners([(part, part.colors, (3,), np.uint8, 255) for part in parts]) if has_colors else None,
        np.repeat([part.is_double_sided for part in parts], faces),
        tuple(part.name for part in parts),
        np.repeat(np.arange(len(parts), dtype=np.int32), faces),
        source=str(path),
        notes=tuple(notes),
    )


def _corners(columns: list[tuple[_Part, NDArray[Any] | None, tuple[int], Any, int]]) -> NDArray[Any]:
    """Values of vertices at the corners of each triangle, a fill where a part has none."""
    return np.concatenate(
        [
            np.full((len(part.triangles), 3, *width), fill, dtype) if values is None else values[part.triangles]
            for part, values, width, dtype, fill in columns
        ]
    )


@contextmanager
def _complaints(notes: list[str]) -> Iterator[None]:
    """Collects what trimesh logs of things that it could not read, and otherwise leaves out in silence."""

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.levelno < logging.WARNING and not re.match("unable to|failed to|skipping", record.getMessage()):
                return
            cause = record.exc_info[1] if record.exc_info else None
            text = " ".join(record.getMessage().split()) + (f" ({cause})" if cause else "")
            if text not in notes:
                notes.append(text)

    logger, collector = logging.getLogger("trimesh"), Collector()
    before = logger.level, logger.propagate
    logger.addHandler(collector)
    logger.setLevel(logging.DEBUG)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(collector)
        logger.setLevel(before[0])
        logger.propagate = before[1]
