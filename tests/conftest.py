"""Fixtures: every test of a device stage runs on each device there is."""

from __future__ import annotations

import pytest
import warp as wp

from maomaps_warp.mapping.device import prepare_kernels

wp.config.quiet = True
wp.config.log_level = wp.LOG_ERROR
wp.init()
# All kernels of a module are registered before the first of them is compiled: each later one means compiling again.
prepare_kernels("cpu", "score", "nearest", "map", "render")


@pytest.fixture(params=[d.alias for d in wp.get_devices()])
def device(request: pytest.FixtureRequest) -> str:
    """Each Warp device of this machine: the CPU, and CUDA where there is one."""
    return request.param
