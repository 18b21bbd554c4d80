"""Argument checks of the launchers: a wrong array fails here, with its name, and not inside a kernel."""

from __future__ import annotations

from typing import Any

import warp as wp


def check_array(name: str, array: wp.array, dtype: Any, shape: tuple[int | None, ...], device: Any) -> None:
    """Raise unless `array` has this dtype, shape (None = any length) and device.

    Raises:
        TypeError: not a Warp array, or another dtype.
        ValueError: another shape or device.
    """
    if not isinstance(array, wp.array):
        raise TypeError(f"{name}: expected a wp.array, got {type(array).__name__}")
    if array.dtype != dtype:
        raise TypeError(f"{name}: expected dtype {dtype.__name__}, got {array.dtype.__name__}")
    wanted = tuple("any" if n is None else n for n in shape)
    if len(array.shape) != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{name}: expected shape {wanted}, got {tuple(array.shape)}")
    if array.device != wp.get_device(device):
        raise ValueError(f"{name}: expected device {wp.get_device(device)}, got {array.device}")
