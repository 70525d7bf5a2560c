"""Merging that the kit can't ask of every platform: llvmpipe doesn't clamp the factors of signed targets, and
OpenGL leaves open how alpha is rounded to samples."""

from __future__ import annotations

import numpy as np
import pytest

from rhi import AlphaToCoverage, BlendColor, BlendFactor, BlendFunction, Device, Format
from rhi.conformance.compare import assert_near
from rhi.conformance.reference import blend_factor, channels_of, decode, encode
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.conformance.single_draws import draw_once


@pytest.mark.parametrize("factor", list(BlendFactor), ids=lambda f: f.name)
@pytest.mark.parametrize("of_source", [True, False], ids=["source", "destination"])
@pytest.mark.parametrize("format", [Format.R8_SNORM, Format.RGBA8_SNORM], ids=lambda f: f.name)
def test_factors_of_signed_normalised_targets_are_clamped(
    device: Device, format: Format, of_source: bool, factor: BlendFactor
) -> None:
    """1 - (-1) is 2, and as a factor 1 (OpenGL 4.5, 17.3.8)."""
    new, old, constant = (-1.0, 0.5, -0.5, -0.75), (-0.5, -1.0, 0.25, 0.5), (-0.25, 0.75, -1.0, 0.5)
    with device.texture((2, 2), format) as image, device.mesh(rectangle(color=new)) as mesh:
        with device.render_pass(image, clear=old):
            pass
        stored = decode(format, channels_of(format, image.read()))
        function = BlendFunction(*((factor, BlendFactor.ZERO) if of_source else (BlendFactor.ZERO, factor)))
        with device.render_pass(image), device.states(function, BlendColor(*constant)):
            device.draw(device.program(Colored), mesh)
        back = channels_of(format, image.read())
    factors = np.clip(blend_factor(factor, np.broadcast_to(new, stored.shape), stored, constant), -1.0, 1.0)
    expected = encode(format, (new if of_source else stored) * factors)
    assert_near(back, expected, 0.51, "rounding to the nearest stored number")


@pytest.mark.parametrize("samples", [4, 8])
def test_alpha_to_coverage_covers_as_many_samples_as_alpha_says(device: Device, samples: int) -> None:
    alphas = np.linspace(0.0, 1.0, 16)
    columns = [
        rectangle(-1 + i / 8, -1, -1 + (i + 1) / 8, 1, color=(1, 1, 1, a)) for i, a in enumerate(alphas)
    ]
    rows = np.concatenate(columns)
    covered = draw_once(device, (16, 1), Format.R8, rows, AlphaToCoverage.ON, samples=samples)[0] / 255.0
    assert_near(covered, np.floor(samples * alphas + 0.5) / samples, 0.003, "a mean in 8 bits")
