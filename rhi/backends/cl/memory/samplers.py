"""Samplers, and the descriptions of textures that kernels read: words in a small buffer.

`rhi.shading.ir.texture_words` defines the words. They are written when a texture is first bound with a sampler, or a
level is first bound as an image, and are stored with the texture.
"""

from __future__ import annotations

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.errors import translate_errors
from rhi.backends.cl.memory.planes import TexelPlane, allocate, find_address
from rhi.backends.cl.memory.textures import ClTexture, TextureWords
from rhi.contract.descriptors import Id, SamplerDescriptor, TextureKind
from rhi.shading.ir.texture_words import LevelLayout, describe_texture


class Samplers:
    """The samplers of a device, by id."""

    def __init__(self, context: cl.Context) -> None:
        self._context = context
        self._samplers: dict[Id, SamplerDescriptor] = {}

    def create(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        self._samplers[sampler] = descriptor

    def destroy(self, sampler: Id) -> None:
        del self._samplers[sampler]

    def describe(self, texture: ClTexture, sampler: Id) -> TextureWords:
        """Return the description of a texture that is read through a sampler, creating it on first use."""
        known = texture.words.get(sampler)
        if known is None:
            made, descriptor = texture.descriptor, self._samplers[sampler]
            levels = [_place(plane) for plane in texture.levels]
            kind = TextureKind.D2_ARRAY if made.samples > 1 else made.kind  # samples are layers
            words = describe_texture(made.format, kind, levels, descriptor)
            known = texture.words[sampler] = self._buffer(words)
        return known

    def describe_image(self, texture: ClTexture, level: int, layer: int) -> TextureWords:
        """Return the description of one level for loads and stores, creating it on first use; layer -1: all layers."""
        known = texture.words.get((level, layer))
        if known is None:
            made, place = texture.descriptor, _place(texture.levels[level])
            kind = made.kind
            if layer >= 0:
                start = place.start + layer * place.layer_bytes
                place, kind = place._replace(start=start, layers=1), TextureKind.D2
            words = describe_texture(made.format, kind, [place])
            known = texture.words[level, layer] = self._buffer(words)
        return known

    def _buffer(self, words: NDArray[np.int32]) -> TextureWords:
        with translate_errors("device.draw", "a texture's words"):
            memory = allocate(self._context, words.nbytes, words)
        return TextureWords(memory, find_address(memory))


def _place(plane: TexelPlane) -> LevelLayout:
    return LevelLayout(plane.start, plane.width, plane.height, plane.layers, plane.pitch, plane.layer_bytes)
