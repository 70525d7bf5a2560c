"""Which formats a device declares that it lacks."""

from __future__ import annotations

import pytest

from rhi import Device, Format


def require_format(device: Device, format: Format) -> None:
    """Skip the test where no texture of this format can be made."""
    if format in device.capabilities.unsupported_formats:
        pytest.skip(f"{device.backend_name} declares {format.name} unsupported")


def require_renderable(device: Device, format: Format) -> None:
    """Skip the test where this format can't be a color target."""
    require_format(device, format)
    if format in device.capabilities.unrenderable_formats:
        pytest.skip(f"{device.backend_name} declares {format.name} unrenderable")
