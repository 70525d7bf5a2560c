"""Images of high range and blocks in materials, compared with the reference ray tracer.

Blocks are made here from their definitions, so that the exact value of each texel is known: the reference's image
has it as a float.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.lab.exam.case import Measures
from renderer.lab.exam.ray_traced_cases import TestViews, TracedImage, measure_traced_views, trace_image
from renderer.lab.exam.scenes import make_camera
from renderer.lab.measure.ray_tracer.surfaces import decode_srgb
from renderer.scene import Camera, ImageBlocks, Scene, SceneBuilder, TextureMap
from renderer.scene.arrays import Floats
from rhi import CompressedFormat, SamplerDescriptor
from rhi.math import multiply, scaling, translation

_PLAIN: Final = SamplerDescriptor(mip=None)


def paint_light(brightest: float, height: int = 4, width: int = 6) -> NDArray[np.float32]:
    """Paint linear light (height, width, 3) from 1/2,000 of the brightest texel to it, in random order."""
    values = np.geomspace(brightest / 2000.0, brightest, height * width * 3)
    return np.random.default_rng(99).permutation(values).reshape(height, width, 3).astype(np.float32)


def make_screen_scene(brightest: float, emissive: float, plain_sizes: int = 0) -> Scene:
    """Make a screen that emits an image of high range, before a lit wall of as many boxes as there are sizes of
    images of 8 bits."""
    builder = SceneBuilder("screen")
    box, texels = builder.add_mesh(BUILT_IN["box"]()), np.random.default_rng(4)

    def add_box(position: Any, size: Any, **material: Any) -> None:
        node = builder.add_node(multiply(translation(position), scaling(size)))
        builder.add_objects(node, box, builder.add_material(**material))

    screen = TextureMap(builder.add_image(paint_light(brightest)), sampler=_PLAIN)
    factor = (emissive, 0.8 * emissive, emissive)
    add_box(
        (0.0, 0.4, 0.0), (2.4, 1.6, 0.2), base_color=(0.1, 0.1, 0.1), emissive=factor, emissive_texture=screen
    )
    for number in range(plain_sizes):
        image = np.tile(texels.integers(60, 256, 4).astype(np.uint8), (4, 3 + number, 1))
        texture = TextureMap(builder.add_image(image), sampler=_PLAIN)
        add_box((0.32 * number - 1.4, -0.6, 0.3), (0.3, 0.3, 0.3), texture=texture)
    add_box((0.0, 0.0, -0.4), (6.0, 4.0, 0.1), base_color=(0.4, 0.5, 0.6))
    builder.lights.add_point((1.0, 1.0, 1.5), 5.0)
    builder.lights.add_directional((-0.4, -0.6, -1.0), intensity=0.8)
    return builder.build()


def make_screen_views() -> TestViews:
    """Make screens of several strengths, in arrays and in a table, lit while they are drawn and afterwards."""
    camera = make_camera((0.3, 0.3, 2.2), (0.0, 0.1, 0.0))
    bright, far = make_screen_scene(40.0, 0.1), make_screen_scene(6e4, 5e-5)
    return {
        "while surfaces are drawn": (bright, camera, "forward"),
        "from a geometry buffer": (bright, camera, "deferred"),
        "texels up to 60,000 of a faint material": (far, camera, "clustered_deferred"),
        "in a table with images of 8 bits": (
            make_screen_scene(40.0, 0.1, plain_sizes=10),
            camera,
            "deferred",
        ),
    }


_WEIGHTS: Final = np.array([0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64])


def _pack(fields: list[tuple[int, int]], size: int) -> NDArray[np.uint8]:
    """Pack numbers, each with its bits, the first into the lowest bits."""
    word = at = 0
    for value, bits in fields:
        word |= value << at
        at += bits
    return np.frombuffer(word.to_bytes(size, "little"), np.uint8)


def _make_bc1(rng: np.random.Generator) -> tuple[NDArray[np.uint8], Floats]:
    """A block of BC1, and its texels (4, 4, 4): two ends of 5, 6 and 5 bits, and two thirds between them."""
    low, high = rng.integers(0, (12, 24, 12)), rng.integers((20, 40, 20), (32, 64, 32))
    indices = np.minimum(np.arange(16) // 4, 3)
    ends = [int(r) << 11 | int(g) << 5 | int(b) for r, g, b in (high, low)]
    block = _pack([(ends[0], 16), (ends[1], 16), *((int(index), 2) for index in indices)], 8)
    first, second = (np.append(color / (31.0, 63.0, 31.0), 1.0) for color in (high, low))
    palette = np.stack([first, second, (2.0 * first + second) / 3.0, (first + 2.0 * second) / 3.0])
    return block, palette[indices].reshape(4, 4, 4)


def _make_bc5(rng: np.random.Generator) -> tuple[NDArray[np.uint8], Floats]:
    """A block of BC5, and its texels (4, 4, 4): two channels of 8 values each, and a unit normal's third."""
    fields, channels = list[tuple[int, int]](), []
    for axis in range(2):
        low, high = (int(value) for value in (rng.integers(80, 120), rng.integers(130, 180)))
        indices = np.indices((4, 4))[axis].reshape(-1) * 2
        fields += [(high, 8), (low, 8), *((int(index), 3) for index in indices)]
        steps = np.array([0, 7, 1, 2, 3, 4, 5, 6])
        channels.append(((7 - steps) * high + steps * low)[indices] / (7.0 * 255.0))
    across = np.stack(channels, axis=-1) * 2.0 - 1.0
    toward = np.sqrt(1.0 - (across**2).sum(axis=-1))
    texels = np.stack([*channels, toward * 0.5 + 0.5, np.ones(16)], axis=-1)
    return _pack(fields, 16), texels.reshape(4, 4, 4)


def _make_bc7(rng: np.random.Generator) -> tuple[NDArray[np.uint8], Floats]:
    """A block of BC7 in its mode 6, and its texels (4, 4, 4): two ends of 7 bits and one shared, 16 values."""
    ends = np.stack([rng.integers(0, 60, 4), rng.integers(70, 128, 4)])
    ends[:, 3] = 127
    indices = np.arange(16)
    fields = [(1 << 6, 7), *((int(end), 7) for channel in ends.T for end in channel), (0, 1), (1, 1)]
    fields += [(int(index), 3 if texel == 0 else 4) for texel, index in enumerate(indices)]
    first, second = ends[0] * 2, ends[1] * 2 + 1
    weights = _WEIGHTS[indices][:, None]
    texels = ((64 - weights) * first + weights * second + 32 >> 6) / 255.0
    return _pack(fields, 16), texels.reshape(4, 4, 4)


_MAKERS: Final = {"BC1_SRGB": _make_bc1, "BC5": _make_bc5, "BC7_SRGB": _make_bc7}


def make_block_image(
    format: str, seed: int, rows: int = 2, columns: int = 3
) -> tuple[ImageBlocks, NDArray[np.float32]]:
    """Make an image of random blocks, and its texels (height, width, 4) as linear light or data."""
    rng = np.random.default_rng(seed)
    pairs = [_MAKERS[format](rng) for _ in range(rows * columns)]
    blocks = np.stack([block for block, _ in pairs]).reshape(rows, columns, -1)
    texels = np.stack([texel for _, texel in pairs]).reshape(rows, columns, 4, 4, 4).swapaxes(1, 2)
    values = texels.reshape(4 * rows, 4 * columns, 4)
    if format.endswith("_SRGB"):
        values[..., :3] = decode_srgb(values[..., :3])
    image = ImageBlocks(CompressedFormat[format], (4 * columns, 4 * rows), (blocks,))
    return image, values.astype(np.float32)


def make_block_scene(*, is_reference: bool) -> Scene:
    """Make boxes whose images are blocks, or what these mean."""
    builder = SceneBuilder("blocks")
    box = builder.add_mesh(BUILT_IN["box"]())
    textures = [
        TextureMap(builder.add_image(make_block_image(format, seed)[is_reference]), sampler=_PLAIN)
        for seed, format in enumerate(("BC1_SRGB", "BC7_SRGB", "BC7_SRGB", "BC5"))
    ]
    fields = "texture", "texture", "texture", "normal_texture"
    for number, (field, texture) in enumerate(zip(fields, textures, strict=True)):
        values: dict[str, Any] = {field: texture, "specular_color": (0.0, 0.0, 0.0)}
        node = builder.add_node(translation((1.15 * (number % 2) - 0.55, 0.55 - 1.15 * (number // 2), 0.0)))
        builder.add_objects(node, box, builder.add_material(**values))
    builder.lights.add_directional((-0.4, -0.6, -1.0), intensity=0.9)
    return builder.build()


def make_block_views() -> TestViews:
    """Make boxes whose images are blocks, lit while they are drawn and afterwards."""
    camera = make_camera((0.2, 0.15, 2.4), (0.05, 0.0, 0.0))
    scene = make_block_scene(is_reference=False)
    return {
        "while surfaces are drawn": (scene, camera, "forward"),
        "from a geometry buffer": (scene, camera, "deferred"),
    }


def _trace_texels(_scene: Scene, camera: Camera) -> TracedImage:
    return trace_image(make_block_scene(is_reference=True), camera)


MEASURES: Final[Measures] = {
    99: partial(measure_traced_views, make_screen_views),
    100: partial(measure_traced_views, make_block_views, trace=_trace_texels),
}
