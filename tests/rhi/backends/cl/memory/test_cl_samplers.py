"""Descriptions of textures: what they say, and when they are written."""

from __future__ import annotations

import numpy as np
from cl_kit import ClKit, describe_program

from rhi.contract.descriptors import Binding, BindingKind, SamplerDescriptor, TextureDescriptor, TextureKind
from rhi.contract.formats import Format
from rhi.shading.ir.texture_words import (
    LEVEL_WORDS,
    ChannelEncoding,
    LevelWord,
    TextureWord,
    describe_texture,
)

TEXTURE_SOURCE = """
kernel void show(global const uchar *texels, global const int *description, global int *words, int count) {
    for (int i = 0; i < count; ++i) words[i] = description[i];
}
"""
TEXTURE_BINDINGS = (
    Binding("source", BindingKind.TEXTURE, 0),
    Binding("words", BindingKind.STORAGE, 0, True, None, 4),
)
IMAGE_SOURCE = TEXTURE_SOURCE.replace("const uchar", "uchar")
IMAGE_BINDINGS = (Binding("source", BindingKind.IMAGE, 0, True), TEXTURE_BINDINGS[1])


def read_description(cl_kit: ClKit, source: str, bindings: tuple[Binding, ...], count: int) -> list[int]:
    words = cl_kit.buffer(np.zeros(count, "i4"))
    cl_kit.backend.bind_storage(0, words, 0, 4 * count)
    cl_kit.dispatch(cl_kit.program(describe_program(source, bindings)))
    return np.frombuffer(cl_kit.backend.read_buffer(words, 0, 4 * count), np.int32).tolist()


def sampler(cl_kit: ClKit, descriptor: SamplerDescriptor) -> int:
    sampler_id = cl_kit.new_id()
    cl_kit.backend.create_sampler(sampler_id, descriptor)
    return sampler_id


def test_a_kernel_receives_sizes_levels_and_sampler(cl_kit: ClKit) -> None:
    texture = cl_kit.texture(TextureDescriptor((13, 7), Format.RG8, levels=3))
    cl_kit.backend.bind_texture(0, texture, sampler(cl_kit, SamplerDescriptor()))
    count = TextureWord.LEVELS + 3 * LEVEL_WORDS
    words = read_description(cl_kit, TEXTURE_SOURCE, TEXTURE_BINDINGS, count)
    assert words[TextureWord.ENCODING] == ChannelEncoding.UNORM8
    assert (words[TextureWord.CHANNELS], words[TextureWord.TEXEL_BYTES], words[TextureWord.LEVEL_COUNT]) == (
        2,
        2,
        3,
    )
    level = words[TextureWord.LEVELS + LEVEL_WORDS :]
    assert [level[LevelWord.WIDTH], level[LevelWord.HEIGHT], level[LevelWord.ROW]] == [6, 3, 8]


def test_an_image_of_one_layer_is_flat_and_begins_there(cl_kit: ClKit) -> None:
    texture = cl_kit.texture(TextureDescriptor((5, 3), Format.R32F, TextureKind.D2_ARRAY, layers=4))
    words = {}
    for layer in (-1, 2):
        cl_kit.backend.bind_image(0, texture, 0, layer)
        words[layer] = read_description(
            cl_kit, IMAGE_SOURCE, IMAGE_BINDINGS, TextureWord.LEVELS + LEVEL_WORDS
        )
    whole, single_layer = (words[layer][TextureWord.LEVELS :] for layer in (-1, 2))
    assert (whole[LevelWord.DEPTH], single_layer[LevelWord.DEPTH]) == (4, 1)
    assert (single_layer[LevelWord.START] - whole[LevelWord.START]) * 16 == 2 * whole[LevelWord.LAYER] * 4


def test_words_are_made_once_for_a_texture_and_a_sampler(cl_kit: ClKit) -> None:
    backend = cl_kit.backend
    texture = cl_kit.texture(TextureDescriptor((4, 4), Format.R8))
    first, second = (sampler(cl_kit, SamplerDescriptor(mip=None)) for _ in range(2))
    stored = backend._textures[texture]
    assert backend._samplers.describe(stored, first) is backend._samplers.describe(stored, first)
    assert backend._samplers.describe(stored, first) is not backend._samplers.describe(stored, second)
    assert len(stored.words) == 2


def test_integers_are_never_filtered() -> None:
    words = describe_texture(Format.R8UI, TextureKind.D2, [], SamplerDescriptor())
    assert (words[TextureWord.MINIFY], words[TextureWord.MAGNIFY]) == (0, 0)
    words = describe_texture(Format.R8, TextureKind.D2, [], SamplerDescriptor())
    assert (words[TextureWord.MINIFY], words[TextureWord.MAGNIFY]) == (1, 1)
