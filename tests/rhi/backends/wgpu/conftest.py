"""A device on wgpu, or a skip where there is none."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import rhi
from rhi.backends.wgpu import find_obstacle


@pytest.fixture(scope="session")
def usable() -> None:
    obstacle = find_obstacle()
    if obstacle is not None:
        pytest.skip(obstacle)


@pytest.fixture
def device(usable: None) -> Iterator[rhi.Device]:
    with rhi.create_device("wgpu") as device:
        yield device
