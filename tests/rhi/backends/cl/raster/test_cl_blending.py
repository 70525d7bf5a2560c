"""Blending that the kit can't ask of every platform: llvmpipe doesn't clamp the factors of signed targets."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import rhi
from rhi import BlendColor, BlendFactor, BlendFunction, Device, Format
from rhi.conformance.compare import assert_near
from rhi.conformance.reference import blend_factor, channels_of, decode, encode
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle


@pytest.fixture(scope="module")
def device() -> Iterator[Device]:
    with rhi.create_device("cl") as device:
        yield device


@pytest.mark.parametrize("factor", list(BlendFactor), ids=lambda f: f.name)
@pytest.mark.parametrize("format", [Format.R8_SNORM, Format.RGBA8_SNORM], ids=lambda f: f.name)
def test_factors_of_signed_normalised_targets_are_clamped(device: Device, format: Format, factor: BlendFactor) -> None:
    """1 - (-1) is 2, and as a factor 1 (OpenGL 4.5, 17.3.8)."""
    new, old, constant = (-1.0, 0.5, -0.5, -0.75), (-0.5, -1.0, 0.25, 0.5), (-0.25, 0.75, -1.0, 0.5)
    with device.texture((2, 2), format) as image, device.mesh(rectangle(color=new)) as mesh:
        with device.render_pass(image, clear=old):
            pass
        stored = decode(format, channels_of(format, image.read()))
        states = BlendFunction(BlendFactor.ZERO, factor), BlendColor(*constant)
        with device.render_pass(image), device.states(*states):
            device.draw(device.program(Colored), mesh)
        back = channels_of(format, image.read())
    factors = np.clip(blend_factor(factor, np.broadcast_to(new, stored.shape), stored, constant), -1.0, 1.0)
    assert_near(back, encode(format, stored * factors), 0.51, "rounding to the nearest stored number")
