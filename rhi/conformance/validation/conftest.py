"""After each refusal the device must go on working."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from rhi.conformance.validation.refusal import check_working


@pytest.fixture(autouse=True)
def goes_on_working(request: pytest.FixtureRequest) -> Iterator[None]:
    """Use the test's devices once more when the test is over."""
    devices = [
        request.getfixturevalue(name) for name in ("recording", "device") if name in request.fixturenames
    ]
    yield
    for device in devices:
        check_working(device)
