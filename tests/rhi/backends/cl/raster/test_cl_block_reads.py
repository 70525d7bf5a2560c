"""Blocks of pixels whose texels lie beside each other: what they read at once is what each lane reads by
itself."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import CullMode, Device, Format, SamplerDescriptor, TextureKind, Wrap

SIZE = (36, 20)
"""That of the target: blocks of 4 × 4 pixels, all of them whole."""

Floats = NDArray[np.float32]


class ReadCoordinates(sl.Struct):
    """Where a pixel reads: `start + x across + y down`, in texels; the layer is the sum of products with
    `layers`."""

    start: sl.vec2
    across: sl.vec2
    down: sl.vec2
    layers: sl.vec2
    is_filtered: int


class Reading(sl.Shader):
    """Shows bilinear samples, or texels."""

    coordinates: sl.Uniform[ReadCoordinates]
    image: sl.Texture2DArray

    def vertex(self) -> sl.vec4:
        corner = sl.vertex_index()
        return sl.vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        pixel = sl.vec2(sl.ivec2(sl.fragment_coordinate().xy))
        position = (
            self.coordinates.start + self.coordinates.across * pixel.x + self.coordinates.down * pixel.y
        )
        layer = self.coordinates.layers.x * pixel.x + self.coordinates.layers.y * pixel.y
        if self.coordinates.is_filtered == 0:
            return self.image.load(sl.ivec3(sl.vec3(position, layer)))
        return self.image.sample_lod(sl.vec3(position / sl.vec2(self.image.size().xy), layer), 0.0)


class RowReading(sl.Shader):
    """Reads the same texels, a row of them at once."""

    work_group = (32,)
    coordinates: sl.Uniform[ReadCoordinates]
    image: sl.Texture2DArray
    texels: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        at = sl.global_id().xy
        position = (
            self.coordinates.start
            + self.coordinates.across * float(at.x)
            + self.coordinates.down * float(at.y)
        )
        layer = self.coordinates.layers.x * float(at.x) + self.coordinates.layers.y * float(at.y)
        texel = self.image.load(sl.ivec3(sl.vec3(position, layer)))
        if at.x < SIZE[0]:
            self.texels[SIZE[0] * at.y + at.x] = texel


def show(device: Device, image: object, *, is_filtered: int, **coordinates: tuple[float, float]) -> Floats:
    target = device.texture(SIZE, Format.RGBA32F)
    values = {"start": (0, 0), "across": (1, 0), "down": (0, 1), "layers": (0, 0)} | coordinates
    constants = device.uniform(ReadCoordinates(is_filtered=is_filtered, **values))
    with device.render_pass(target, clear=(9, 9, 9, 9)), device.states(CullMode.NONE):
        device.draw(device.program(Reading), device.mesh(3), image=image, coordinates=constants)
    return np.asarray(target.read())


STEPS: dict[str, dict[str, tuple[float, float]]] = {
    "as large": {"start": (3.25, 2.75)},
    "as large, beyond all edges": {"start": (-9.5, -7.25), "across": (1.5, 0), "down": (0, 1.75)},
    "twice as large": {"start": (10.25, 10.75), "across": (0.5, 0), "down": (0, 0.5)},
    "half as large, the widest that is read at once": {"start": (7, 3), "across": (2, 0), "down": (0, 2)},
    "a little too wide": {"start": (7, 3), "across": (2.2, 0), "down": (0, 2.2)},
    "mirrored": {"start": (60.3, 40.6), "across": (-1, 0), "down": (0, -1)},
    "turned": {"start": (30.4, 9.1), "across": (0.8, 0.6), "down": (-0.6, 0.8)},
    "slanted in a row only": {"start": (9.0, 9.0), "across": (1, 0.3), "down": (0, 1)},
    "slanted in a column only": {"start": (9.0, 9.0), "across": (1, 0), "down": (0.3, 1)},
    "a layer for each row": {"start": (9.3, 9.3), "layers": (0, 0.7)},
    "a layer for each column": {"start": (9.3, 9.3), "layers": (0.7, 0)},
}


@pytest.mark.parametrize("wrap", [Wrap.CLAMP, Wrap.REPEAT])
def test_half_floats_are_filtered_like_the_same_numbers_in_float32(device: Device, wrap: Wrap) -> None:
    """Texels of 16 bytes are always read lane by lane. Both compute the same, to the last bit."""
    texels = np.random.default_rng(0).normal(0.0, 100.0, (5, 44, 76, 4)).astype(np.float16)
    sampler = SamplerDescriptor(mip=None, wrap_u=wrap, wrap_v=wrap)
    halves, singles = (
        device.texture(texels.astype(f.dtype), f, kind=TextureKind.D2_ARRAY).sampled(sampler)
        for f in (Format.RGBA16F, Format.RGBA32F)
    )
    for name, step in STEPS.items():
        expected = show(device, singles, is_filtered=1, **step)
        assert len(np.unique(expected)) > 100, name
        np.testing.assert_array_equal(show(device, halves, is_filtered=1, **step), expected, name)


@pytest.mark.parametrize("format", [Format.RGBA16F, Format.R32F, Format.RGBA8])
def test_a_load_is_the_texel_wherever_a_block_or_a_row_of_pixels_reads(
    device: Device, format: Format
) -> None:
    numbers = np.random.default_rng(1).integers(0, 256, (3, 23, 41, format.channels))
    texels = (numbers / (255.0 if format is Format.RGBA8 else 1.0)).astype(np.float32)
    image = device.texture(numbers.astype(format.dtype), format, kind=TextureKind.D2_ARRAY)
    texels_read, rows = device.storage(sl.vec4, SIZE[0] * SIZE[1]), device.program(RowReading)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    for start, across, down, layers in (
        ((0, 0), (1, 0), (0, 1), (0, 0)),
        ((4, 8), (1, 0), (0, 1), (0, 0)),
        ((7, 5), (1, 0), (0, 1), (0, 0)),
        ((-3, -2), (1, 0), (0, 1), (0, 0)),
        ((0, 2**30), (1, 0), (0, 1), (0, 0)),
        ((0, 0), (2, 0), (0, 1), (0, 0)),
        ((39, 0), (-1, 0), (0, 1), (0, 0)),
        ((0, 0), (1, 0), (1, 1), (0, 0)),
        ((0, 0), (1, 1), (0, 1), (0, 0)),
        ((0, 0), (1, 0), (0, 1), (0.0625, 0)),
        ((0, 0), (1, 0), (0, 1), (0, 0.375)),
    ):
        u, v = (start[i] + across[i] * x + down[i] * y for i in (0, 1))
        layer = (layers[0] * x + layers[1] * y).astype(int)
        inside = (u >= 0) & (u < 41) & (v >= 0) & (v < 23) & (layer < 3)
        expected = np.zeros((*x.shape, 4), np.float32)
        expected[..., 3] = inside if format.channels < 4 else 0
        expected[inside, : format.channels] = texels[layer[inside], v[inside], u[inside]]
        values: dict[str, tuple[float, float]] = {
            "start": start,
            "across": across,
            "down": down,
            "layers": layers,
        }
        read = show(device, image, is_filtered=0, **values)
        np.testing.assert_allclose(read, expected, rtol=1e-6, err_msg=f"{values}")
        device.dispatch(
            rows,
            (2, SIZE[1]),
            coordinates=ReadCoordinates(is_filtered=0, **values),
            image=image,
            texels=texels_read,
        )
        np.testing.assert_array_equal(texels_read.read().reshape(read.shape), read, f"{values}")
