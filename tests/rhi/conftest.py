"""Fixtures of the interface's own tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from null_kit import Kit, make_kit

import rhi


@pytest.fixture
def kit() -> Iterator[Kit]:
    with rhi.create_device("null") as device:
        yield make_kit(device)
