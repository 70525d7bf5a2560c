"""Random writes, copies and reads of parts of textures, against NumPy arrays: all kinds, levels and layers."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES
from nights import rotate_seed
from numpy.typing import NDArray

import rhi
from rhi import Format, Region, Texture, TextureKind

BACKENDS: Final = ("gl", "cl", "wgpu", "null")
FORMATS: Final = (
    Format.RGBA8, Format.R8, Format.R32F, Format.RG16F, Format.RGBA32I, Format.RGB10A2, Format.R16UI,
)  # fmt: skip
SHAPES: Final = (
    (TextureKind.D2, 9, 5, None),
    (TextureKind.D2_ARRAY, 7, 5, 3),
    (TextureKind.D3, 6, 4, 4),
    (TextureKind.CUBE, 8, 8, None),
)
"""Kind, width, height, and layers where the kind doesn't say them."""
STEPS: Final = 30

Levels = list[NDArray[Any]]
"""The texels of each level: (layers, height, width, components)."""


@pytest.fixture(scope="module", params=BACKENDS)
def running_device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    if request.param not in [backend.name for backend in rhi.report() if backend.usable]:
        pytest.skip(f"{request.param} doesn't work here")
    with rhi.create_device(request.param) as device:
        yield device


def make_texture(
    device: rhi.Device, format: Format, shape: tuple[Any, int, int, int | None], levels: int
) -> tuple[Texture, Levels]:
    kind, width, height, layers = shape
    texture = device.texture((width, height), format, kind=kind, layers=layers, levels=levels)
    return texture, [np.array(texture.read_layers(level)) for level in range(levels)]


def draw_texels(numbers: np.random.Generator, format: Format, shape: tuple[int, ...]) -> NDArray[Any]:
    if format.dtype.kind == "f":
        return numbers.random(shape).astype(format.dtype)
    limits = np.iinfo(format.dtype)  # type: ignore[type-var]
    return numbers.integers(limits.min, limits.max, shape, format.dtype, endpoint=True)


def draw_box(rng: random.Random, *levels: NDArray[Any]) -> tuple[list[int], list[list[int]]]:
    """Return a size (layers, height, width) that fits into all these levels, and an origin in each."""
    size = [
        rng.randint(1, min(lengths)) for lengths in zip(*(level.shape[:3] for level in levels), strict=True)
    ]
    return size, [
        [rng.randint(0, length - part) for length, part in zip(level.shape[:3], size, strict=True)]
        for level in levels
    ]


def box(origin: list[int], size: list[int]) -> tuple[slice, ...]:
    return tuple(slice(start, start + length) for start, length in zip(origin, size, strict=True))


def overlaps(size: list[int], first: list[int], second: list[int]) -> bool:
    return all(abs(a - b) < length for a, b, length in zip(first, second, size, strict=True))


def run_steps(device: rhi.Device, seed: int) -> None:
    """Do the same to textures and arrays, and compare them after each step that reads, and at the end."""
    rng, numbers = random.Random(seed), np.random.default_rng(seed)
    format = rng.choice(FORMATS)
    pairs = [make_texture(device, format, shape, rng.choice([1, 3])) for shape in SHAPES]
    done: list[str] = []
    for _ in range(STEPS):
        texture, arrays = rng.choice(pairs)
        level = rng.randrange(len(arrays))
        texels = arrays[level]
        match rng.randrange(4):
            case 0:
                size, ((z, y, x),) = draw_box(rng, texels)
                values = draw_texels(numbers, format, (*size, texels.shape[3]))
                texture.write(values if texture.kind is not TextureKind.D2 else values[0], level, z, x, y)
                texels[box([z, y, x], size)] = values
                done.append(f"write {texture.kind.name} {level} {size} at {z, y, x}")
            case 1 | 2:
                target, target_arrays = rng.choice([(texture, arrays), rng.choice(pairs)])
                target_level = rng.randrange(len(target_arrays))
                into = target_arrays[target_level]
                size, (source_origin, origin) = draw_box(rng, texels, into)
                if into is texels and overlaps(size, source_origin, origin):
                    continue
                layers, height, width = size
                region = Region(source_origin[2], source_origin[1], width, height, source_origin[0], layers)
                texture.copy_to(
                    target,
                    level=level,
                    region=region,
                    target_level=target_level,
                    x=origin[2],
                    y=origin[1],
                    layer=origin[0],
                )
                into[box(origin, size)] = texels[box(source_origin, size)].copy()
                done.append(f"copy {texture.kind.name} {level} {region} to {target.kind.name} {origin}")
            case _:
                (_, height, width), ((z, y, x),) = draw_box(rng, texels)
                back = texture.read(level, z, Region(x, y, width, height))
                expected = texels[z, y : y + height, x : x + width]
                np.testing.assert_array_equal(back.reshape(expected.shape), expected, "\n".join(done))
    for texture, arrays in pairs:
        for level, texels in enumerate(arrays):
            message = "\n".join([f"seed {seed}, {format.name}, {texture.kind.name}, level {level}", *done])
            np.testing.assert_array_equal(texture.read_layers(level), texels, message)
        texture.destroy()


@pytest.mark.nightly_cases("*-1?", reason=FEWER_CASES)
@pytest.mark.parametrize("seed", range(20))
def test_parts_of_textures_are_written_copied_and_read_as_arrays_are(
    running_device: rhi.Device, seed: int
) -> None:
    run_steps(running_device, rotate_seed(seed))


@pytest.mark.parametrize("source", SHAPES, ids=lambda shape: shape[0].name)
@pytest.mark.parametrize("target", SHAPES, ids=lambda shape: shape[0].name)
def test_layers_of_each_kind_are_copied_to_those_of_each_other(
    running_device: rhi.Device, source: Any, target: Any
) -> None:
    """Between all levels, and as many layers as both have."""
    (old, texels), (new, into) = (
        make_texture(running_device, Format.RGBA8, kind, 3) for kind in (source, target)
    )
    numbers = np.random.default_rng(3)
    for level, level_texels in enumerate(texels):
        level_texels[...] = draw_texels(numbers, Format.RGBA8, level_texels.shape)
        old.write(level_texels if old.kind is not TextureKind.D2 else level_texels[0], level)
        for target_level, target_texels in enumerate(into):
            size = np.minimum(level_texels.shape, target_texels.shape)[:3].tolist()
            layers, height, width = size
            old.copy_to(
                new, level=level, region=Region(0, 0, width, height, 0, layers), target_level=target_level
            )
            target_texels[box([0, 0, 0], size)] = level_texels[box([0, 0, 0], size)]
            np.testing.assert_array_equal(new.read_layers(target_level), target_texels)
    old.destroy()
    new.destroy()
