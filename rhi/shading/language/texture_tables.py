"""The annotation of texture tables: many images of different sizes behind one binding.

A shader reads an image by its number, `self.images[index].sample(uv)`; the number may differ from invocation
to invocation. `rhi.shading.parser.texture_tables` says how a table is read, `device.texture_table` makes one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rhi.contract.descriptors import TextureKind
from rhi.contract.layout import FLOAT
from rhi.shading.language.bindings import TableBinding
from rhi.shading.language.textures import SampledTexture
from rhi.shading.language.types import LANGUAGE_NAMES, TextureType

if TYPE_CHECKING:
    from rhi.shading.language.vectors import ivec2, uint, vec2, vec4

LANGUAGE_NAMES.add("TextureTable")


class TableTexture:
    """One image of a `TextureTable`: shaders call its methods, as those of a `Texture2D`."""

    if TYPE_CHECKING:

        def sample(self, at: vec2) -> vec4: ...
        def sample_bias(self, at: vec2, bias: float) -> vec4: ...
        def sample_lod(self, at: vec2, lod: float) -> vec4: ...
        def sample_grad(self, at: vec2, dx: vec2, dy: vec2) -> vec4: ...
        def load(self, texel: ivec2, level: int = 0) -> vec4: ...
        def size(self, level: int = 0) -> ivec2: ...
        def levels(self) -> int: ...


class TextureTable(SampledTexture):
    """Many 2D textures of different sizes, read as floats: `self.images[index].sample(uv)`."""

    shading_type = TextureType(TextureKind.D2_ARRAY, FLOAT, table=True)

    if TYPE_CHECKING:

        def __get__(self, instance: object, owner: Any = None) -> TextureTable: ...
        def __set__(self, instance: object, value: TableBinding) -> None: ...
        def __getitem__(self, index: int | uint) -> TableTexture: ...
        def __len__(self) -> int: ...
