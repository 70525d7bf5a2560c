"""Texture tables in NumPy arrays, for `run_compute` and its like."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import TextureKind
from rhi.contract.formats import Format
from rhi.errors import refuse
from rhi.shading.ir.texture_pages import (
    GUTTER,
    PAGE_SAMPLER,
    WORDS_FORMAT,
    describe_pages,
    plan_pages,
    surround,
)
from rhi.shading.language import rules
from rhi.shading.language.bindings import TableBinding
from rhi.shading.numpy.host_textures import HostTexture

_MOST: Final = 1 << 15


class HostTextureTable:
    """A texture table in host memory: many images of different sizes.

    Attributes:
        pages: the pages, a 2D array.
        words: what describes the images, a 2D texture.
    """

    def __init__(self, images: Sequence[HostTexture]) -> None:
        """Create a table from copies of 2D textures of one format, each with its levels and its sampler.

        Raises:
            ValidationError `shading-arguments`: there are none, or they differ in their format, or one isn't
                2D, or holds integers or depth.
        """
        call, textures = "HostTextureTable", list(images)
        if not textures:
            refuse(rules.WRONG_ARGUMENTS, call, "no images", "one or more")
        form = textures[0].format
        for texture in textures:
            fits = texture.kind is TextureKind.D2 and texture.format is form
            if not fits or form.is_integer or form.is_depth:
                actual = f"{texture.kind.name} of {texture.format.name}"
                refuse(rules.WRONG_ARGUMENTS, call, actual, "2D textures of one format of colors")
        sizes = [[(level.shape[2], level.shape[1]) for level in texture.levels] for texture in textures]
        plan = plan_pages(sizes, _MOST, _MOST)
        if plan is None:
            refuse(rules.WRONG_ARGUMENTS, call, "images that fill no page", f"sides up to {_MOST - 2}")
        width, height = plan.size
        pages: NDArray[Any] = np.zeros((plan.layers, height, width, form.components), form.dtype)
        for texture, rectangles, turned in zip(textures, plan.levels, plan.transposed, strict=True):
            for level, r in zip(texture.levels, rectangles, strict=True):
                texels = surround(level[0], form, texture.sampler)
                page = pages[r.layer]
                rows = slice(r.y - GUTTER, r.y + r.height + GUTTER)
                columns = slice(r.x - GUTTER, r.x + r.width + GUTTER)
                page[rows, columns] = texels.swapaxes(0, 1) if turned else texels
        samplers = [texture.sampler for texture in textures]
        self._set(pages, form, describe_pages(plan, [levels[0] for levels in sizes], samplers))

    @classmethod
    def from_device(cls, table: TableBinding) -> HostTextureTable:
        """Return a copy of a device's `TextureTable`. Waits for the device."""
        pages: Any = table.owner
        words: Any = table.words
        copy = cls.__new__(cls)
        texels = pages.read_layers()
        copy._set(texels, pages.format, words.read())
        return copy

    def _set(self, pages: NDArray[Any], form: Format, words: NDArray[np.int32]) -> None:
        self.pages = HostTexture(pages, form, TextureKind.D2_ARRAY, PAGE_SAMPLER)
        self.words = HostTexture(words, WORDS_FORMAT)
