"""Texture tables: many images of different sizes, which shaders read by their numbers in one draw.

The images lie in the layers of one 2D array texture (`pages`), each mip level in a rectangle of its own with
its own texels. A second texture describes them. So a table takes two texture
slots, whatever the number of images.
`rhi.shading.ir.texture_pages` plans the rectangles; `rhi.shading.parser.texture_tables` reads them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Region, SamplerDescriptor, TextureDescriptor, TextureKind, Wrap
from rhi.contract.formats import Format
from rhi.contract.limits import full_levels, lack, plain_faults, single_sample_faults
from rhi.device.core.core import Core
from rhi.device.resources.images import as_texels, infer_format
from rhi.device.resources.lifetime import Resource
from rhi.device.resources.textures import Sampler, Texture
from rhi.errors import rules
from rhi.errors.arguments import ArgumentChecker, to_integer
from rhi.shading.ir.texture_pages import (
    GUTTER,
    PAGE_SAMPLER,
    WORDS_FORMAT,
    LevelRectangle,
    PagePlan,
    Size,
    border_texel,
    describe_pages,
    gutter_sources,
    plan_pages,
    surround,
)
from rhi.shading.language.bindings import TableBinding, TextureBinding

CALL: Final = "device.texture_table"


class TextureTable(TableBinding, Resource):
    """Many 2D images of different sizes, created by `device.texture_table` and bound as `sl.TextureTable`.

    `len(table)` is the number of images.

    Attributes:
        pages: the 2D array texture that holds all levels of all images.
        sizes: (width, height) of each image.
        levels: the number of mip levels of each image.
        samplers: how each image is read.
    """

    __slots__ = ("_plan", "levels", "pages", "samplers", "sizes")

    def __init__(
        self,
        core: Core,
        plan: PagePlan,
        pages: Texture,
        words: Texture,
        sizes: Sequence[Size],
        samplers: Sequence[SamplerDescriptor],
    ) -> None:
        super().__init__(pages.id, core.sampler(PAGE_SAMPLER), pages, words)
        self._plan = plan
        self.pages = pages
        self.sizes = tuple(sizes)
        self.levels = tuple(len(levels) for levels in plan.levels)
        self.samplers = tuple(samplers)

    def __len__(self) -> int:
        return len(self.sizes)

    def __repr__(self) -> str:
        return f"TextureTable({self.pages.label!r}, {len(self)} images, {self.format.name})"

    @property
    def format(self) -> Format:
        """The texel format of all images."""
        return self.pages.format

    @property
    def label(self) -> str:
        """The table's name in messages and tools."""
        return self.pages.label

    @property
    def bytes(self) -> int:
        """The memory of the pages and of the texture that describes them, in bytes."""
        words = self._described
        width, height = words.size
        return self._plan.texels * self.format.transfer_bytes + width * height * words.format.transfer_bytes

    @property
    def _described(self) -> Texture:
        return cast("Texture", self.words)

    @property
    def image_bytes(self) -> int:
        """The memory of the images with their mip levels, each by itself, in bytes."""
        texels = sum(r.width * r.height for levels in self._plan.levels for r in levels)
        return texels * self.format.transfer_bytes

    def destroy(self) -> None:
        """Destroy both textures once the GPU no longer uses them. A second call does nothing."""
        self.pages.destroy()
        self._described.destroy()

    def copy_from(self, texture: Texture, index: int) -> None:
        """Replace the texels of an image by those of a texture, which has its size, format and levels. The
        copy is made on the device.

        Raises:
            ValidationError: `texture-levels` for an image that the table doesn't have, `texture-format` or
                `texture-size` for a texture that differs.
        """
        core, call = self.pages.core, "TextureTable.copy_from"
        if not 0 <= index < len(self):
            core.refuse(rules.TEXTURE_LEVELS, call, f"image {index}", f"0 to {len(self) - 1}")
        check_source(core, call, texture, self.format)
        actual = texture.size, texture.levels
        if actual != (self.sizes[index], self.levels[index]):
            given = f"{texture!r} with {texture.levels} levels"
            width, height = self.sizes[index]
            core.refuse(rules.TEXTURE_SIZE, call, given, f"{width}×{height}, {self.levels[index]} levels")
        core.check_usable(self.pages, call)
        self.fill(texture, index)

    def fill(self, texture: Texture, index: int) -> None:
        """Copy a texture that fits to an image's rectangles and their borders."""
        core, sampler = self.pages.core, self.samplers[index]
        core.check_ready()
        for level, rectangle in enumerate(self._plan.levels[index]):
            if self._plan.transposed[index]:
                self._write_transposed(texture, level, rectangle, sampler)
            else:
                self._copy(texture, level, rectangle, sampler)

    def _write_transposed(
        self, texture: Texture, level: int, r: LevelRectangle, sampler: SamplerDescriptor
    ) -> None:
        """Write a level with its axes exchanged: no command copies so."""
        texels = texture.read(level)
        texels = texels.reshape(*texels.shape[:2], self.format.components)
        turned = surround(texels, self.format, sampler).swapaxes(0, 1)
        self.pages.write(np.ascontiguousarray(turned)[None], 0, r.layer, r.x - GUTTER, r.y - GUTTER)

    def _copy(self, texture: Texture, level: int, r: LevelRectangle, sampler: SamplerDescriptor) -> None:
        """Copy a level and what its border repeats."""
        left, right = gutter_sources(sampler.wrap_u, r.width)
        above, below = gutter_sources(sampler.wrap_v, r.height)
        columns = ((0, r.x, r.width), (left, r.x - GUTTER, 1), (right, r.x + r.width, 1))
        rows = ((0, r.y, r.height), (above, r.y - GUTTER, 1), (below, r.y + r.height, 1))
        border = (
            border_texel(self.format, sampler) if Wrap.BORDER in (sampler.wrap_u, sampler.wrap_v) else None
        )
        for (column, x, width), (row, y, height) in product(columns, rows):
            if column < 0 or row < 0:
                assert border is not None
                texels = np.broadcast_to(border, (1, height, width, len(border)))
                self.pages.write(np.ascontiguousarray(texels), 0, r.layer, x, y)
            else:
                source = Region(column, row, width, height)
                backend = self.pages.core.backend
                backend.copy_texture(texture.id, level, source, self.pages.id, 0, x, y, r.layer)


def create_table(
    core: Core,
    images: Any,
    format: Format | None,
    samplers: Any,
    levels: int | None,
    label: str,
    *,
    make_texture: Callable[..., Texture],
) -> TextureTable:
    """Create a table; see `Device.texture_table`.

    Args:
        make_texture: that of the device. Textures of arrays live until they are copied.
    """
    check = ArgumentChecker(CALL, core.refuse)
    check.text("label", label)
    levels = check.integer_or_none("levels", levels)
    if not isinstance(images, (list, tuple)) or not images:
        check.fail("images", images, "a list of one or more images")
    requested = _list_samplers(check, samplers, len(images))
    sources = [
        image if isinstance(image, TextureBinding | np.ndarray | tuple) else as_texels(image)
        for image in images
    ]
    if format is None:
        format = _infer_format(check, sources[0])
    check.choice("format", format, Format)
    check_format(core, format)
    textures: list[Texture | None] = []
    sizes: list[list[Size]] = []  # of the levels of each image
    descriptors, created = [], []
    try:
        for source, sampler in zip(sources, requested, strict=True):
            descriptors.append(_check_sampler(check, sampler))
            if isinstance(source, tuple):
                textures.append(None)
                sizes.append(_list_level_sizes(check, source, levels))
                continue
            if isinstance(source, np.ndarray):
                texture = make_texture(source, format, levels=_limit_levels(source, levels), label=label)
                created.append(texture)
            else:
                texture = _get_texture(check, source)
                check_source(core, CALL, texture, format)
                if source is not texture:
                    descriptors[-1] = _check_sampler(check, core.sampler_descriptors[source.sampler])
            textures.append(texture)
            sizes.append([texture.descriptor.level_size(level) for level in range(texture.levels)])
        plan = plan_table(core, sizes)
        largest = [levels_of_image[0] for levels_of_image in sizes]
        pages = Texture(core, page_descriptor(plan, format, label))
        words = make_texture(describe_pages(plan, largest, descriptors), WORDS_FORMAT, label=label)
        table = TextureTable(core, plan, pages, words, largest, descriptors)
        for index, filled in enumerate(textures):
            if filled is not None:
                table.fill(filled, index)
    finally:
        for texture in created:
            texture.destroy()
    return table


def _list_samplers(check: ArgumentChecker, samplers: Any, count: int) -> Sequence[Any]:
    """Return the requested sampler of each image."""
    requested = SamplerDescriptor() if samplers is None else samplers
    if not isinstance(requested, (list, tuple)):
        return [requested] * count
    if len(requested) != count:
        check.fail("samplers", f"{len(requested)} samplers", f"one, or {count}, one for each image")
    return requested


def _list_level_sizes(check: ArgumentChecker, size: tuple[Any, ...], levels: int | None) -> list[Size]:
    """Return the sizes of the levels of an image of `size`, or refuse it."""
    numbers = [to_integer(value) for value in size]
    if len(numbers) != 2 or not all(number is not None and number > 0 for number in numbers):
        check.fail("images", size, "(width, height) above 0, textures, arrays and images")
    width, height = (number or 1 for number in numbers)
    count = full_levels(width, height) if levels is None else min(max(levels, 1), full_levels(width, height))
    return [(max(width >> level, 1), max(height >> level, 1)) for level in range(count)]


def _check_sampler(check: ArgumentChecker, sampler: Any) -> SamplerDescriptor:
    """Return the descriptor of a sampler that a table can have, or refuse it."""
    descriptor = sampler.descriptor if isinstance(sampler, Sampler) else sampler
    check.instance("samplers", descriptor, SamplerDescriptor, "an rhi.SamplerDescriptor")
    if descriptor.compare is not None:
        check.fail("samplers", descriptor, "samplers that don't compare")
    return cast("SamplerDescriptor", descriptor)


def _get_texture(check: ArgumentChecker, source: TextureBinding) -> Texture:
    """Return the texture of an image that is on the device, or refuse it."""
    if not isinstance(source.owner, Texture):
        check.fail("images", source, "textures, arrays and images")
    return source.owner


def _infer_format(check: ArgumentChecker, source: NDArray[Any] | TextureBinding | tuple[Any, ...]) -> Format:
    """Return the format of a table whose first image this is, or refuse it."""
    if isinstance(source, tuple):
        check.fail("format", None, "a format: that of images given by their sizes doesn't follow")
    if not isinstance(source, np.ndarray):
        return _get_texture(check, source).format
    format = infer_format(source)
    if format is None:
        allowed = "1 to 4 channels of uint8, uint16, float16 or float32, or a format"
        check.fail("images", f"shape {source.shape} of {source.dtype}", allowed)
    return format


def _limit_levels(source: NDArray[Any], levels: int | None) -> int | None:
    """Return the mip levels of an array: as many as are asked for, if it has so many."""
    if levels is None or source.ndim < 2:
        return levels
    return min(levels, full_levels(source.shape[1], source.shape[0]))


def check_source(core: Core, call: str, texture: Texture, format: Format) -> None:
    """Refuse a texture that can't be an image of a table of this format."""
    core.check_usable(texture, call)
    core.require(call, plain_faults(texture.requested))
    core.require(call, single_sample_faults(texture.descriptor))
    if texture.kind is not TextureKind.D2:
        core.refuse(rules.TEXTURE_FORMAT, call, f"{texture!r}, {texture.kind.name}", "2D textures")
    if texture.format is not format:
        tip = "make a table for each format"
        core.refuse(rules.TEXTURE_FORMAT, call, f"{texture!r}", f"{format.name}, as the table has", tip)


def check_format(core: Core, format: Format) -> None:
    """Refuse a format that can't be filtered."""
    if format.is_integer or format.is_depth:
        allowed = "a format of colors"
        tip = "tables are read as floats: bind a texture of its own, such as a Texture2DArray"
        core.refuse(rules.TEXTURE_FORMAT, CALL, format.name, allowed, tip)
    if format in core.capabilities.unfilterable_formats:
        core.require(CALL, iter([lack(format.name, "unfilterable_formats")]))


def plan_table(core: Core, sizes: Sequence[Sequence[Size]]) -> PagePlan:
    """Return the pages for images with these sizes of levels, or refuse them."""
    capabilities = core.capabilities
    side = capabilities.max_texture_size
    for width, height in (levels[0] for levels in sizes):
        if max(width, height) + 2 * GUTTER > side:
            allowed = f"up to {side - 2 * GUTTER} each way: a border of a texel is around each image"
            core.refuse(rules.TEXTURE_SIZE, CALL, f"{width}×{height}", allowed)
    plan = plan_pages(sizes, side, capabilities.max_texture_layers)
    if plan is None:
        given = f"{len(sizes)} images"
        allowed = f"what {capabilities.max_texture_layers} pages of {side}×{side} hold"
        core.refuse(rules.TEXTURE_SIZE, CALL, given, allowed, "make several tables")
    return plan


def page_descriptor(plan: PagePlan, format: Format, label: str) -> TextureDescriptor:
    """Return the descriptor of a table's pages."""
    return TextureDescriptor(plan.size, format, TextureKind.D2_ARRAY, plan.layers, 1, 1, label)
