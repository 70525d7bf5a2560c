"""Texels of every format, and which formats a device declares that it lacks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import Device, Format
from rhi.conformance.reference import largest, smallest
from rhi.contract.formats import ChannelKind


def require_format(device: Device, format: Format) -> None:
    """Skip the test where no texture of this format can be made."""
    if format in device.capabilities.unsupported_formats:
        pytest.skip(f"{device.backend_name} declares {format.name} unsupported")


def require_renderable(device: Device, format: Format) -> None:
    """Skip the test where this format can't be a color target."""
    require_format(device, format)
    if format in device.capabilities.unrenderable_formats:
        pytest.skip(f"{device.backend_name} declares {format.name} unrenderable")


def require_samples(device: Device, samples: int) -> None:
    """Skip the test where textures have fewer samples at most."""
    if samples > device.capabilities.max_samples:
        pytest.skip(f"{device.backend_name} declares max_samples {device.capabilities.max_samples}")


def random_texels(format: Format, *shape: int, seed: int = 0) -> NDArray[Any]:
    """(*shape, channels) texels that use the format's whole range, its ends included."""
    rng = np.random.default_rng([seed, *shape])
    full = (*shape, format.channels)
    if format.dtype.kind == "f":
        return rng.normal(0, 100, full).astype(format.dtype)
    # Of the two smallest numbers of a signed format, which both mean -1, copies may give either.
    low = -largest(format) if format.kind is ChannelKind.SNORM else smallest(format)
    values = rng.integers(low, largest(format), full, endpoint=True).astype(format.dtype)
    ends = values.reshape(-1)[:2]
    ends[:] = (low, largest(format))[: len(ends)]
    return values


def squeezed(format: Format, texels: NDArray[Any]) -> NDArray[Any]:
    """As `Texture.read` gives them: without the axis of a single channel."""
    return texels[..., 0] if format.channels == 1 else texels
