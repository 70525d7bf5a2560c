"""Samples of multi-sampled textures, read one by one: colors, integers and depth.

Where samples lie is left to the device. Depth that rises along an axis tells the place of each; coverage must
agree.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Device, Format, Texture
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import require_renderable, require_samples
from rhi.conformance.shaders import Bare, Colored, Positions, UintColored
from rhi.conformance.shapes import VertexRows, corners, rectangle

pytestmark = pytest.mark.requires("draws", "shading")

SIZE = (8, 8)
COUNTS = pytest.mark.parametrize("samples", [2, 4, 8])
RIGHT = (0.0, 1.0, 1.0, 0.0, 1.0, 0.0)  # at the corners of `rectangle`, from 0 at the left to 1
DOWN = (1.0, 1.0, 0.0, 1.0, 0.0, 0.0)


class Sample(sl.Struct):
    """The sample to read, and the place of texel (0, 0)."""

    number: int
    origin: sl.ivec2


class ReadSample(Positions):
    """Reads one sample of each texel."""

    source: sl.Texture2DSamples
    sample: sl.Uniform[Sample]

    def fragment(self, v: Bare) -> sl.vec4:
        return self.source.load(
            sl.ivec2(sl.fragment_coordinate().xy) + self.sample.origin, self.sample.number
        )


class ReadUintSample(Positions):
    """Reads one sample of unsigned integers."""

    source: sl.UintTexture2DSamples
    sample: sl.Uniform[Sample]

    def fragment(self, v: Bare) -> sl.uvec4:
        return self.source.load(sl.ivec2(sl.fragment_coordinate().xy), self.sample.number)


class ReadEachSample(sl.Shader):
    """Reads each sample of a texel in an invocation of its own, and the size."""

    source: sl.Texture2DSamples
    results: sl.StorageRW[sl.vec4]
    sizes: sl.StorageRW[sl.ivec2]

    def compute(self) -> None:
        i = sl.global_id().x
        self.results[i] = self.source.load(sl.ivec2(3, 4), i)
        self.sizes[i] = self.source.size()


def read_samples(
    device: Device,
    source: Texture,
    format: Format = Format.RGBA32F,
    reader: Any = ReadSample,
    origin: tuple[int, int] = (0, 0),
) -> NDArray[Any]:
    """Return the texels of each sample as (samples, rows, columns, channels)."""
    require_renderable(device, format)
    rows = []
    with device.texture(SIZE, format) as target, device.mesh(rectangle()) as mesh:
        for number in range(source.samples):
            with device.render_pass(target):
                parameters = Sample(number=number, origin=origin)
                device.draw(device.program(reader), mesh, source=source, sample=parameters)
            rows.append(target.read())
    return np.stack(rows)


def measure_sample_positions(device: Device, samples: int, format: Format = Format.D32F) -> NDArray[Any]:
    """Return the places of the samples in texel units from a texel's top left, (samples, rows, columns,
    2)."""
    axes = []
    with device.texture(SIZE, format, samples=samples) as depth:
        for slope in (RIGHT, DOWN):
            with device.render_pass([], depth, clear_depth=0), device.mesh(rectangle(depth=slope)) as mesh:
                device.draw(device.program(Colored), mesh)
            axes.append(read_samples(device, depth, Format.R32F).astype(np.float64) * 8)
    return np.stack(axes, -1) - np.stack(np.meshgrid(np.arange(8), np.arange(8)), -1)


def split() -> VertexRows:
    """Return a red and a green triangle that share a diagonal."""
    red, green = (3.0, 0.0, 0.0, 1.0), (0.0, 5.0, 0.0, 1.0)
    return np.concatenate(
        [corners([(-1, 1), (-1, -1), (1, -0.7)], red), corners([(-1, 1), (1, -0.7), (1, 1)], green)]
    )


@COUNTS
@pytest.mark.parametrize("format", [Format.D32F, Format.D24S8], ids=lambda format: format.name)
def test_depth_is_read_at_the_position_of_each_sample(device: Device, samples: int, format: Format) -> None:
    require_samples(device, samples)
    positions = measure_sample_positions(device, samples, format)
    assert_near(
        positions,
        np.broadcast_to(positions[:, :1, :1], positions.shape),
        4e-4,
        "depth within 2e-5, of 8 texels",
    )
    corner_positions = positions[:, 0, 0]
    assert (corner_positions > 0).all()
    assert (corner_positions < 1).all()
    assert len(np.unique(np.round(corner_positions, 2), axis=0)) == samples, corner_positions


@COUNTS
def test_each_sample_has_the_color_of_the_triangle_that_covers_its_position(
    device: Device, samples: int
) -> None:
    require_samples(device, samples)
    positions = measure_sample_positions(device, samples)[:, 0, 0]
    with device.texture(SIZE, Format.RGBA16F, samples=samples) as image:
        for step in range(16):  # an edge in each sixteenth of the texels in column 4
            edge = 4 + (step + 0.5) / 16
            sides = (
                rectangle(right=edge / 4 - 1, color=(0.25, 0, 0, 1)),
                rectangle(left=edge / 4 - 1, color=(0, 3, 0, 1)),
            )
            with device.render_pass(image, clear=(0, 0, 0, 0)), device.mesh(np.concatenate(sides)) as mesh:
                device.draw(device.program(Colored), mesh)
            middle = read_samples(device, image)[:, :, 4]
            left = positions[:, 0] < edge - 4
            expected = np.where(left[:, None], (0.25, 0, 0, 1), (0, 3, 0, 1))
            sure = (
                np.abs(positions[:, 0] - (edge - 4)) > 1 / 128
            )  # a step of half a subtexel of 1/256 and the tolerance
            assert_same(middle[sure], np.broadcast_to(expected[:, None], middle.shape)[sure])


@COUNTS
def test_the_mean_of_the_samples_that_are_read_is_the_resolved_texel(device: Device, samples: int) -> None:
    require_samples(device, samples)
    with (
        device.texture(SIZE, Format.RGBA16F, samples=samples) as image,
        device.texture(SIZE, Format.RGBA16F) as resolved,
        device.mesh(split()) as mesh,
    ):
        with device.render_pass(image, clear=(0, 0, 0, 0), resolve=resolved):
            device.draw(device.program(Colored), mesh)
        mean = resolved.read().astype(np.float64)
        texels = read_samples(device, image).astype(np.float64)
    assert ((mean[..., 0] > 0) & (mean[..., 1] > 0)).any(), "no texel has both colors"
    assert_near(texels.mean(0), mean, 4e-3, "a mean in half floats")


def test_samples_of_integers_are_read_as_they_are(device: Device) -> None:
    require_samples(device, 4)
    format = Format.RGBA8UI
    if format in device.capabilities.single_sampled_formats:
        pytest.skip(f"{device.backend_name} declares {format.name} single-sampled")
    with device.texture(SIZE, format, samples=4) as image, device.mesh(split()) as mesh:
        with device.render_pass(image, clear=(7, 7, 7, 7)):
            device.draw(device.program(UintColored), mesh)
        texels = read_samples(device, image, format, ReadUintSample).reshape(-1, 4)
    assert {tuple(texel) for texel in texels.tolist()} == {(3, 0, 0, 1), (0, 5, 0, 1), (7, 7, 7, 7)}


def test_a_sample_outside_the_texture_is_zero(device: Device) -> None:
    require_samples(device, 4)
    with device.texture(SIZE, Format.RGBA8, samples=4) as image:
        with device.render_pass(image, clear=(1, 1, 1, 1)):
            pass
        shifted = read_samples(device, image, origin=(3, -2))
    assert_same(shifted[:, 2:, :5], 1)
    assert_same(shifted[:, :2], 0)
    assert_same(shifted[:, :, 5:], 0)


@pytest.mark.requires("compute")
@COUNTS
def test_a_dispatch_reads_samples_and_the_size(device: Device, samples: int) -> None:
    """Each invocation reads another sample of the same texel."""
    require_samples(device, samples)
    with (
        device.texture((9, 8), Format.RGBA8, samples=samples) as image,
        device.mesh(split()) as mesh,
        device.storage(sl.vec4, samples) as results,
        device.storage(sl.ivec2, samples) as sizes,
    ):
        with device.render_pass(image, clear=(0, 0, 1, 0)):
            device.draw(device.program(Colored), mesh)
        program = device.program(ReadEachSample)
        device.dispatch(program, samples, source=image, results=results, sizes=sizes)
        assert_same(results.read(), read_samples(device, image)[:, 4, 3])
        assert_same(sizes.read(), (9, 8))
