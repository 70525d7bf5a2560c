"""Devices for the tests of light culling."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import rhi


@pytest.fixture(scope="module", params=["gl", "cl"])
def device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    """A device of each backend that draws and computes, one per module."""
    try:
        made = rhi.create_device(request.param)
    except rhi.DeviceError as error:
        pytest.skip(f"no {request.param} device here: {error.given or error.rule.sentence}")
    with made:
        if not (made.capabilities.renders and made.capabilities.compute):
            pytest.skip(f"the {request.param} device draws nothing")
        yield made
