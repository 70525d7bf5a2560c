"""Filtered comparisons of depth under any mapping: a block of pixels that reads whole rows of texels gets what each
of its pixels would alone. The reference is float64 and shares no code with the kernels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
import rhi.shading as sl
from rhi import Comparison, Device, Filter, Format, SamplerDescriptor, Texture, Wrap
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import corners

SIZE, WIDTH, HEIGHT = (36, 28), 61, 43
REFERENCE, BORDER = 0.5, 0.75
TOLERANCE = 3e-4
"""Coordinates of float32 in texels, whose fractions are weights."""
PASSES = {
    Comparison.LESS: np.less,
    Comparison.LESS_EQUAL: np.less_equal,
    Comparison.GREATER: np.greater,
    Comparison.GREATER_EQUAL: np.greater_equal,
    Comparison.EQUAL: np.equal,
    Comparison.NOT_EQUAL: np.not_equal,
}


class Mapped(sl.FullScreen):
    """Compares depth at a linear map of the pixel; shows the result and the coordinates."""

    depth: sl.DepthTexture2D
    across: sl.Uniform[sl.vec4]
    origin: sl.Uniform[sl.vec4]

    def fragment(self) -> sl.vec4:
        pixel = sl.fragment_coordinate().xy
        uv = self.across.xy * pixel.x + self.across.zw * pixel.y + self.origin.xy
        return sl.vec4(self.depth.sample_compare_lod(uv, 0.5, 0.0), uv, 1.0)


@pytest.fixture(scope="module")
def device() -> Iterator[Device]:
    with rhi.create_device("cl") as device:
        yield device


@pytest.fixture(scope="module")
def depth(device: Device) -> Texture:
    """Depths 0 to 1 in small triangles, some of them the reference itself."""
    rng = np.random.default_rng(3)
    positions = np.ones((600, 4))
    positions[:, :2] = np.repeat(rng.uniform(-1, 1, (200, 2)), 3, axis=0) + rng.uniform(-0.2, 0.2, (600, 2))
    positions[:, 2] = np.repeat(rng.choice([0.1, 0.3, REFERENCE, 0.7, 0.9], 200), 3)
    depth = device.texture((WIDTH, HEIGHT), Format.D32F)
    with (
        device.texture((WIDTH, HEIGHT), Format.RGBA8) as image,
        device.mesh(corners(positions, (1, 1, 1, 1))) as mesh,
    ):
        with (
            device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.2),
            device.states(rhi.CullMode.NONE, rhi.DepthFunction.ALWAYS),
        ):
            device.draw(device.program(Colored), mesh)
    return depth


def compute_expected(
    depths: NDArray[np.float64], uv: NDArray[np.float64], wrap: Wrap, comparison: Comparison
) -> NDArray[np.float64]:
    """Filter comparisons of depths, shape (HEIGHT, WIDTH), at coordinates, shape (n, 2)."""
    at = uv * (WIDTH, HEIGHT) - 0.5
    whole = np.floor(at).astype(int)
    part = at - whole
    total = np.zeros(len(uv))
    for right in (0, 1):
        for below in (0, 1):
            x, y = whole[:, 0] + right, whole[:, 1] + below
            inside = (x >= 0) & (x < WIDTH) & (y >= 0) & (y < HEIGHT)
            if wrap is Wrap.REPEAT:
                x, y, inside = x % WIDTH, y % HEIGHT, np.full(len(x), True)
            elif wrap is Wrap.CLAMP:
                inside[:] = True
            texel = np.where(inside, depths[np.clip(y, 0, HEIGHT - 1), np.clip(x, 0, WIDTH - 1)], BORDER)
            weight = np.abs(1 - right - part[:, 0]) * np.abs(1 - below - part[:, 1])
            total += weight * PASSES[comparison](REFERENCE, texel)
    return total


@pytest.mark.parametrize("wrap", [Wrap.CLAMP, Wrap.BORDER, Wrap.REPEAT], ids=lambda wrap: wrap.name)
def test_comparisons_under_any_mapping_are_those_of_single_pixels(
    device: Device, depth: Texture, wrap: Wrap
) -> None:
    program, mesh = device.program(Mapped), device.mesh(3)
    depths = depth.read().astype(np.float64)
    assert len(np.unique(depths)) > 4
    rng = np.random.default_rng(5)
    varied = 0
    with device.texture(SIZE, Format.RGBA32F) as image:
        for number, comparison in enumerate(list(PASSES) * 4):
            sampler = SamplerDescriptor(
                Filter.LINEAR, Filter.LINEAR, None, wrap, wrap, border=(BORDER,) * 4, compare=comparison
            )
            scale, turn = 2.0 ** (number % 8 - 4), rng.uniform(0, 2 * np.pi)  # texels a pixel
            u, v = scale * np.array([np.cos(turn), np.sin(turn)])
            across = sl.vec4(u / WIDTH, v / HEIGHT, -v / WIDTH, u / HEIGHT)
            pixel = 0.5 * np.array(SIZE)
            center = rng.uniform(0.2, 0.8, 2) * (WIDTH, HEIGHT)
            origin = center - pixel[0] * np.array([u, v]) - pixel[1] * np.array([-v, u])
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw(
                    program,
                    mesh,
                    depth=depth.sampled(sampler),
                    across=device.uniform(across),
                    origin=device.uniform(sl.vec4(origin[0] / WIDTH, origin[1] / HEIGHT, 0.0, 0.0)),
                )
            back = image.read().reshape(-1, 4).astype(np.float64)
            expected = compute_expected(depths, back[:, 1:3], wrap, comparison)
            np.testing.assert_allclose(back[:, 0], expected, atol=TOLERANCE * max(1.0, scale))
            varied += len(np.unique(back[:, 0])) > 10
    assert varied >= 12
