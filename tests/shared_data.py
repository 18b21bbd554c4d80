"""Finds the real data that lies beside the checkout; it is not part of the repository."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


def shared_data(name: str) -> Path:
    """Path of a folder under ../shared/data; skips the test, saying so, where it is absent."""
    return _present(SHARED / "data" / name)


def shared_reference(name: str) -> Path:
    """Path of a folder under ../shared/reference; skips the test, saying so, where it is absent."""
    return _present(SHARED / "reference" / name)


def _present(path: Path) -> Path:
    if not path.exists():
        pytest.skip(f"real data not present: {path}")
    return path
