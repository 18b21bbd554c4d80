"""Protocols by name, from TOML files and from options."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from maomaps_warp.errors import InputError
from maomaps_warp.map_protocol import MAP_PRESETS, MapProtocol
from maomaps_warp.protocol import PRESETS, Protocol

AnyProtocol = TypeVar("AnyProtocol", Protocol, MapProtocol)


def load_protocol(name_or_file: str) -> Protocol:
    """A preset by name, or a TOML file: fields of Protocol, and `base` with the preset to start from.

    Raises:
        InputError: neither; or a file with an unknown field or a bad value.
    """
    return _load(name_or_file, PRESETS)


def load_map_protocol(name_or_file: str) -> MapProtocol:
    """The same for protocols of ground-truth maps.

    Raises:
        InputError: as `load_protocol`.
    """
    return _load(name_or_file, MAP_PRESETS)


def _load(name_or_file: str, presets: dict[str, AnyProtocol]) -> AnyProtocol:
    if name_or_file in presets:
        return presets[name_or_file]
    path = Path(name_or_file)
    if not path.is_file():
        raise InputError(
            f"protocol {name_or_file}", "no such protocol", f"presets: {', '.join(presets)}; or a .toml file"
        )
    import tomllib

    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise InputError(path, f"not a TOML file: {error}") from None
    base = values.pop("base", "maomaps")
    if not isinstance(base, str) or base not in presets:
        raise InputError(path, f"base = {base!r}", f"presets: {', '.join(presets)}")
    return with_overrides(presets[base], {"name": path.stem} | values, str(path))


def with_overrides(protocol: AnyProtocol, overrides: dict[str, Any], where: str) -> AnyProtocol:
    """A protocol with some fields replaced.

    Args:
        protocol: where to start.
        overrides: fields by name, as TOML gives them.
        where: what to blame, for the message.

    Raises:
        InputError: an unknown field, or a value it cannot take.
    """
    hints = get_type_hints(type(protocol))
    unknown = [name for name in overrides if name not in hints]
    if unknown:
        raise InputError(where, f"no such field: {unknown[0]}", f"fields: {', '.join(hints)}")
    try:
        values = {name: _as_field(name, hints[name], value) for name, value in overrides.items()}
        return dataclasses.replace(protocol, **values)
    except (TypeError, ValueError) as error:
        raise InputError(where, str(error)) from None


def _as_field(name: str, hint: Any, value: Any) -> Any:
    """`value` in the type of a field, where that loses nothing; TypeError with the field's name if it cannot be."""
    choices = [a for a in get_args(hint) if isinstance(a, str)]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if choices:
        fits, expected = value in choices, f"one of {', '.join(choices)}"
    elif hint is str:
        fits, expected = isinstance(value, str), "a text"
    elif hint is bool:
        fits, expected = isinstance(value, bool), "true or false"
    elif hint is int:
        fits, expected = is_number and isinstance(value, int), "a whole number"
    elif hint == tuple[float, ...]:
        numbers = isinstance(value, list | tuple) and not any(isinstance(v, bool | str) for v in value)
        fits, expected = numbers, "a list of numbers"
        value = tuple(float(v) for v in value) if fits else value
    else:
        fits, expected = is_number, "a number"
        value = float(value) if fits else value
    if not fits:
        raise TypeError(f"{name} = {value!r}: must be {expected}")
    return value


def to_toml(protocol: Protocol | MapProtocol) -> str:
    """The protocol as a TOML file that `load_protocol` or `load_map_protocol` reads back to an equal one."""
    lines = []
    for f in dataclasses.fields(protocol):
        value = getattr(protocol, f.name)
        if value is None:
            continue
        unit = f" [{f.metadata['unit']}]" if f.metadata["unit"] else ""
        lines += [f"# {f.metadata['meaning']}{unit}", f"{f.name} = {_toml_value(value)}"]
    return "\n".join(lines) + "\n"


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, tuple):
        return "[" + ", ".join(repr(v) for v in value) + "]"
    return repr(value)
