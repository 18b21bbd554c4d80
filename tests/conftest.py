"""Fixtures: every test of a device stage runs on each device there is."""

from __future__ import annotations

import pytest
import warp as wp

wp.config.quiet = True
wp.config.log_level = wp.LOG_ERROR
wp.init()


@pytest.fixture(params=[d.alias for d in wp.get_devices()])
def device(request: pytest.FixtureRequest) -> str:
    """Each Warp device of this machine: the CPU, and CUDA where there is one."""
    return request.param
