"""Textures in block-compressed formats, as shaders read them: every format, levels, layers, and parts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import CompressedFormat, Device, TextureKind
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.reference import decode, linear_to_srgb
from rhi.contract.blocks import decode_level
from rhi.shading import Shader, StorageRW, Texture2D, Texture2DArray, global_id, vec4

pytestmark = pytest.mark.requires("shading", "compute", "max_texture_slots")


class LoadTexels(Shader):
    """Loads the texels of a level."""

    source: Texture2D
    results: StorageRW[vec4]

    def compute(self) -> None:
        at = global_id()
        self.results[(at.z * 16 + at.y) * 16 + at.x] = self.source.load(at.xy, at.z)


class LoadLayers(Shader):
    """Loads the texels of the layers of an array."""

    source: Texture2DArray
    results: StorageRW[vec4]

    def compute(self) -> None:
        at = global_id()
        self.results[(at.z * 16 + at.y) * 16 + at.x] = self.source.load(at)


def random_blocks(format: CompressedFormat, *shape: int) -> NDArray[np.uint8]:
    """Return (*shape, bytes) blocks. Those of BC7 have each mode, those of BC6H are finite."""
    blocks = np.random.default_rng(shape).integers(0, 256, (*shape, format.block_bytes), np.uint8)
    if format.name.startswith("BC7"):
        mode = np.arange(blocks[..., 0].size).reshape(shape) % 8
        blocks[..., 0] = (blocks[..., 0].astype(int) << mode + 1 | 1 << mode) & 255
    return blocks


def assert_decoded(format: CompressedFormat, actual: NDArray[Any], blocks: NDArray[np.uint8]) -> None:
    """Compare (height, width, 4) values with those of (rows, columns, bytes) blocks."""
    height, width = actual.shape[:2]
    texels = decode_level(format, blocks[None], width, height)[0]
    expected = decode(format.decoded, texels).reshape(height, width, 4)
    if format.name.startswith("BC6H"):
        assert_same(actual, expected)
        return
    if format.name.startswith("BC7"):
        slack: Any = 1e-6
    else:
        across = np.pad(expected, [(0, -height % 4), (0, -width % 4), (0, 0)], mode="edge")
        tiles = across.reshape(-(-height // 4), 4, -(-width // 4), 4, 4)
        spread = (tiles.max((1, 3)) - tiles.min((1, 3))).repeat(4, 0).repeat(4, 1)[:height, :width]
        step = 1.0 / (127 if format.name.endswith("_SNORM") else 255)
        slack = np.maximum(2.01 * step, step + 0.03 * spread)
    if format.name.endswith("_SRGB"):  # a table may be off by half a step of 8 bits
        actual, expected = (
            np.concatenate([linear_to_srgb(v[..., :3]), v[..., 3:]], axis=-1) for v in (actual, expected)
        )
        slack = 0.5 / 255 + slack
    reason = (
        "BC7 is exact; Direct3D asks for 1 stored number and 3 % of what the ends of BC1 to BC5 differ by"
    )
    assert_near(actual, expected, slack, reason)


@pytest.mark.parametrize("format", list(CompressedFormat), ids=lambda f: f.name)
def test_blocks_are_read_as_texels(device: Device, format: CompressedFormat) -> None:
    blocks = random_blocks(format, 4, 4)
    with device.texture(blocks, format) as texture, device.storage(vec4, 256) as results:
        assert texture.size == (16, 16)
        device.dispatch(device.program(LoadTexels), (16, 16), source=texture, results=results)
        assert_decoded(format, results.read().reshape(16, 16, 4), blocks)


@pytest.mark.parametrize(
    "format", [CompressedFormat.BC1, CompressedFormat.BC5, CompressedFormat.BC7], ids=lambda f: f.name
)
def test_levels_of_any_size_consist_of_whole_blocks(device: Device, format: CompressedFormat) -> None:
    """13×6 texels, then 6×3, 3×1 and 1×1."""
    shapes = [(2, 4), (1, 2), (1, 1), (1, 1)]
    levels = [random_blocks(format, *shape) for shape in shapes]
    with device.texture((13, 6), format, levels=None) as texture, device.storage(vec4, 256 * 4) as results:
        assert texture.levels == 4
        for level, blocks in enumerate(levels):
            texture.write(blocks, level=level)
        device.dispatch(device.program(LoadTexels), (16, 16, 4), source=texture, results=results)
        texels = results.read().reshape(4, 16, 16, 4)
        for level, blocks in enumerate(levels):
            width, height = max(1, 13 >> level), max(1, 6 >> level)
            assert_decoded(format, texels[level, :height, :width], blocks)


def test_blocks_replace_their_texels_only(device: Device) -> None:
    format = CompressedFormat.BC1
    old, new = random_blocks(format, 4, 4), random_blocks(format, 2, 1)
    with device.texture(old, format) as texture, device.storage(vec4, 256) as results:
        texture.write(new, x=8, y=4)
        device.dispatch(device.program(LoadTexels), (16, 16), source=texture, results=results)
        old[1:3, 2:3] = new
        assert_decoded(format, results.read().reshape(16, 16, 4), old)


@pytest.mark.parametrize("format", [CompressedFormat.BC3, CompressedFormat.BC6H], ids=lambda f: f.name)
def test_layers_of_blocks_are_written_at_once(device: Device, format: CompressedFormat) -> None:
    blocks = random_blocks(format, 3, 4, 4)
    with (
        device.texture((16, 16), format, kind=TextureKind.D2_ARRAY, layers=3) as texture,
        device.storage(vec4, 3 * 256) as results,
    ):
        texture.write(blocks[1:], layer=1)
        texture.write(blocks[0])
        device.dispatch(device.program(LoadLayers), (16, 16, 3), source=texture, results=results)
        texels = results.read().reshape(3, 16, 16, 4)
        for layer in range(3):
            assert_decoded(format, texels[layer], blocks[layer])
