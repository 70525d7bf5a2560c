"""Samplers, and the descriptions of textures that kernels read: words in a small buffer.

`rhi.shading.ir.texture_words` defines the words. They are written when a texture is first bound with a
sampler, or a level is first bound as an image, and are stored with the texture.
"""

from __future__ import annotations

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.memory.cl_textures import ClTexture, TextureWords
from rhi.backends.cl.memory.planes import TexelPlane, allocate, buffer_address
from rhi.contract.descriptors import Id, SamplerDescriptor, TextureKind
from rhi.shading.ir.texture_words import LevelLayout, TextureWord, describe_texture
from rhi.shading.opencl.opencl_textures import FUNCTION_COUNT


class Samplers:
    """The samplers of a device, by id.

    Attributes:
        texture_functions: the addresses of functions that kernels may call to sample, which stand in memory to which
            all descriptions point.
    """

    def __init__(self, context: cl.Context) -> None:
        self._context = context
        self.texture_functions = np.zeros(FUNCTION_COUNT, np.uint64)
        self._samplers: dict[Id, SamplerDescriptor] = {}

    def create(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        self._samplers[sampler] = descriptor

    def destroy(self, sampler: Id) -> None:
        del self._samplers[sampler]

    def describe(self, texture: ClTexture, sampler: Id) -> TextureWords:
        """Return the description of a texture that is read through a sampler, creating it on first use."""
        memory = texture.words.get(sampler)
        if memory is None:
            described_texture, descriptor = texture.descriptor, self._samplers[sampler]
            levels = [_level_layout(plane) for plane in texture.levels]
            kind = (
                TextureKind.D2_ARRAY if described_texture.samples > 1 else described_texture.kind
            )  # samples are layers
            words = describe_texture(described_texture.format, kind, levels, descriptor)
            memory = texture.words[sampler] = self._buffer(words)
        return memory

    def describe_image(self, texture: ClTexture, level: int, layer: int) -> TextureWords:
        """Return the description of one level for loads and stores, creating it on first use; layer -1: all
        layers."""
        memory = texture.words.get((level, layer))
        if memory is None:
            described_texture, layout = texture.descriptor, _level_layout(texture.levels[level])
            kind = described_texture.kind
            if layer >= 0:
                start = layout.start + layer * layout.layer_bytes
                layout, kind = layout._replace(start=start, layers=1), TextureKind.D2
            words = describe_texture(described_texture.format, kind, [layout])
            memory = texture.words[level, layer] = self._buffer(words)
        return memory

    def _buffer(self, words: NDArray[np.int32]) -> TextureWords:
        address = np.array(self.texture_functions.ctypes.data, np.uint64).reshape(1).view(np.int32)
        words[TextureWord.FUNCTIONS : TextureWord.FUNCTIONS + 2] = address
        with translate_errors("device.draw", "a texture's words"):
            memory = allocate(self._context, words.nbytes, words)
        return TextureWords(memory, buffer_address(memory))


def _level_layout(plane: TexelPlane) -> LevelLayout:
    return LevelLayout(plane.start, plane.width, plane.height, plane.layers, plane.pitch, plane.layer_bytes)
