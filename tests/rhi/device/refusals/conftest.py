"""Devices for tests of refusals: null devices, shared by all of them. After each refusal they must go on
working."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import rhi
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import check_working


@pytest.fixture(scope="session")
def backend() -> str:
    """The backend of these tests: the front end refuses a call before any backend sees it."""
    return "null"


@pytest.fixture(scope="session")
def shared_recording() -> Iterator[rhi.Device]:
    """A device that records its commands."""
    with rhi.create_device("null", validation=True, record=True) as device:
        yield device


@pytest.fixture(scope="session")
def shared_device() -> Iterator[rhi.Device]:
    """A second device."""
    with rhi.create_device("null", validation=True) as device:
        yield device


@pytest.fixture
def recording(shared_recording: rhi.Device) -> Iterator[rhi.Device]:
    """The shared device that records its commands; its stream continues from test to test."""
    yield shared_recording
    check_working(shared_recording)


@pytest.fixture
def image(recording: rhi.Device) -> Iterator[rhi.Texture]:
    """A target of 4×4 texels."""
    with recording.texture((4, 4), rhi.Format.R8) as image:
        yield image


@pytest.fixture
def mesh(recording: rhi.Device) -> Iterator[rhi.Mesh]:
    """Two triangles without indices: 6 vertices."""
    with recording.mesh(rectangle()) as mesh:
        yield mesh


@pytest.fixture
def device(shared_device: rhi.Device) -> Iterator[rhi.Device]:
    """The shared second device."""
    yield shared_device
    check_working(shared_device)


@pytest.fixture
def fresh_device() -> Iterator[rhi.Device]:
    """A device for this test alone."""
    with rhi.create_device("null", validation=True) as device:
        yield device
