"""Random texels of every format, and skips for formats that a device declares unsupported."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import Device, Format
from rhi.conformance.reference import largest, smallest
from rhi.contract.formats import ChannelKind
from rhi.contract.limits import target_bytes


def require_format(device: Device, format: Format) -> None:
    """Skip the test if the device supports no textures of this format."""
    if format in device.capabilities.unsupported_formats:
        pytest.skip(f"{device.backend_name} declares {format.name} unsupported")


def require_renderable(device: Device, format: Format) -> None:
    """Skip the test if the device can't render to this format."""
    require_format(device, format)
    if format in device.capabilities.unrenderable_formats:
        pytest.skip(f"{device.backend_name} declares {format.name} unrenderable")


def require_blendable(device: Device, format: Format) -> None:
    """Skip the test if draws can't blend with this format."""
    if format in device.capabilities.unblendable_formats:
        pytest.skip(f"{device.backend_name} declares {format.name} unblendable")


def require_targets(device: Device, formats: Iterable[Format]) -> None:
    """Skip the test if a pass can't have color targets of these formats at once."""
    if target_bytes(formats) > device.capabilities.max_target_bytes:
        pytest.skip(f"{device.backend_name} declares max_target_bytes {device.capabilities.max_target_bytes}")


def require_images(device: Device, format: Format) -> None:
    """Skip the test if images can't have this format."""
    if format in device.capabilities.unstorable_formats:
        pytest.skip(f"{device.backend_name} declares images of {format.name} unsupported")


def require_point_sizes(device: Device) -> None:
    """Skip the test if the device's points are one texel."""
    if device.capabilities.max_point_size <= 1.0:
        pytest.skip(f"{device.backend_name} declares max_point_size 1")


def require_line_width(device: Device, width: float) -> None:
    """Skip the test if the device's lines can't be this wide."""
    if device.capabilities.max_line_width < width:
        pytest.skip(f"{device.backend_name} declares max_line_width {device.capabilities.max_line_width:g}")


def require_vertex_alignment(device: Device, step: int) -> None:
    """Skip the test if the places of vertices and their fields must be multiples of more bytes."""
    if step % device.capabilities.vertex_alignment:
        pytest.skip(f"{device.backend_name} declares vertex_alignment {device.capabilities.vertex_alignment}")


def require_samples(device: Device, samples: int) -> None:
    """Skip the test if the device's textures can't have this many samples."""
    if samples not in device.capabilities.sample_counts:
        pytest.skip(f"{device.backend_name} declares no textures of {samples} samples")


def random_texels(format: Format, *shape: int, seed: int = 0) -> NDArray[Any]:
    """Return (*shape, components) random texels over the format's whole range, both ends included; floats are
    finite."""
    rng = np.random.default_rng([seed, *shape])
    full = (*shape, format.components)
    if format is Format.R11G11B10F:  # each exponent below that of infinity, each fraction
        parts = (rng.integers(0, 31 << bits - 5, full, np.uint32) for bits in format.channel_bits)
        return sum((part << 11 * channel for channel, part in enumerate(parts)), np.zeros(full, np.uint32))
    if format.dtype.kind == "f":
        return rng.normal(0, 100, full).astype(format.dtype)
    # The two smallest numbers of a signed normalised format both mean -1, and a copy may return either.
    low = -largest(format) if format.kind is ChannelKind.SNORM else smallest(format)
    values = rng.integers(low, largest(format), full, endpoint=True).astype(format.dtype)
    ends = values.reshape(-1)[:2]
    ends[:] = (low, largest(format))[: len(ends)]
    return values


def squeezed(format: Format, texels: NDArray[Any]) -> NDArray[Any]:
    """Return texels in the shape of `Texture.read`: a single channel has no axis."""
    return texels[..., 0] if format.components == 1 else texels
