"""Devices that the renderer's tests open, in a module of its own: there are several files `conftest.py`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

import rhi


@contextmanager
def open_device(name: str, **options: Any) -> Iterator[rhi.Device]:
    """Create a device of a backend; the test is skipped where there is none."""
    try:
        device = rhi.create_device(name, **options)
    except rhi.DeviceError as error:
        pytest.skip(f"no {name} device here: {error.given or error.rule.sentence}")
    with device:
        yield device
