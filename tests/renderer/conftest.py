"""Devices for the renderer's tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import rhi


@pytest.fixture
def null() -> Iterator[rhi.Device]:
    with rhi.create_device("null") as device:
        yield device


@pytest.fixture
def gl() -> Iterator[rhi.Device]:
    """A GL device that records; tests that look at pixels are skipped where there is none."""
    try:
        device = rhi.create_device("gl", record=True)
    except rhi.DeviceError as error:
        pytest.skip(f"no GL device here: {error.given or error.rule.sentence}")
    with device:
        yield device


@pytest.fixture(scope="module", params=["gl", "cl"])
def drawing_device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    """A device of each backend that draws, one per module; tests of a backend that isn't here are skipped."""
    try:
        device = rhi.create_device(request.param)
    except rhi.DeviceError as error:
        pytest.skip(f"no {request.param} device here: {error.given or error.rule.sentence}")
    with device:
        if not device.capabilities.renders:
            pytest.skip(f"the {request.param} device draws nothing")
        yield device


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
