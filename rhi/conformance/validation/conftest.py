"""After each refusal the device must go on working."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from rhi import Device, Format
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle


@pytest.fixture(autouse=True)
def goes_on_working(request: pytest.FixtureRequest) -> Iterator[None]:
    """Use the device once more when the test is over."""
    devices = [
        request.getfixturevalue(name) for name in ("recording", "device") if name in request.fixturenames
    ]
    yield
    for device in devices:
        check_working(device)


def check_working(device: Device) -> None:
    """A write, a pass with a draw where there are draws, and a read."""
    with device.buffer(np.arange(4, dtype="u4")) as buffer:
        assert_same(buffer.read(), np.arange(4))
    capabilities = device.capabilities
    with device.texture((2, 2), Format.R8) as image, device.mesh(rectangle()) as mesh:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            if capabilities.draws:
                device.draw(device.program(Colored), mesh)
        assert_same(image.read(), 255 if capabilities.renders else 0)
