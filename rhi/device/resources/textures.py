"""Textures, samplers, and the parts of a texture that are bound or rendered to.

- Row 0 of every array is the top row. `read` and `write` use the format's own dtype; nothing is converted
  silently.
- A `Texture` can be bound directly, with a default sampler for its format. `sampled(...)` binds it with
  another sampler, `image(...)` binds one level for loads and stores, and `at(...)` is one level and layer as
  a render target.
"""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from rhi.contract import limits
from rhi.contract.blocks import BLOCK, CompressedFormat, decode_level
from rhi.contract.descriptors import (
    ALL_LAYERS,
    Access,
    Filter,
    Id,
    Region,
    SamplerDescriptor,
    TextureDescriptor,
    TextureKind,
)
from rhi.contract.formats import ChannelKind, Format
from rhi.contract.texels import add_channel_axis, convert_float64
from rhi.device.core.core import Core
from rhi.device.resources.buffers import Buffer, StorageBuffer, check_buffer
from rhi.device.resources.exchange import ArrayExchange
from rhi.device.resources.images import (
    convert_to_image,
    tip_for_texels,
    write_image,
)
from rhi.device.resources.lifetime import Resource, drop, retire
from rhi.device.resources.locks import Lock
from rhi.device.resources.readbacks import Readback
from rhi.errors import rules
from rhi.errors.arguments import ArgumentChecker, FieldChecker
from rhi.errors.data_classes import dataclass
from rhi.errors.device_objects import DeviceObject
from rhi.shading.language.bindings import ImageBinding, TextureBinding

_LINEAR = SamplerDescriptor()
_NEAREST = SamplerDescriptor(minify=Filter.NEAREST, magnify=Filter.NEAREST, mip=Filter.NEAREST)


@dataclass(frozen=True, slots=True)
class Sampler(DeviceObject):
    """A sampler: filtering, wrapping and comparison of texture reads. Equal descriptors share one id."""

    id: Id
    descriptor: SamplerDescriptor

    def __post_init__(self) -> None:
        fields = FieldChecker(self)
        fields.integers("id", minimum=1)
        fields.instance("descriptor", self.descriptor, SamplerDescriptor, "an rhi.SamplerDescriptor")


@dataclass(frozen=True, slots=True)
class TextureTarget:
    """A mip level and layer of a texture, as the target of a render pass; without a layer, all of them."""

    texture: Texture
    level: int = 0
    layer: int | None = 0

    @property
    def attached_layer(self) -> int:
        """The layer as the backend takes it."""
        return ALL_LAYERS if self.layer is None else self.layer

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the level."""
        return self.texture.descriptor.level_size(self.level)


class Texture(TextureBinding, ArrayExchange, Resource):
    """A texture on the device. `np.asarray(texture)` and `from_dlpack(texture)` of other libraries read its
    level 0, with an axis for layers where there are several.

    Attributes:
        id: the texture's id in the command stream.
        descriptor: size, format, kind, layers, levels and samples; these are also attributes of the texture.
        requested: the descriptor as it was asked for. It differs if the device doesn't store the blocks of a
            compressed format: they are decoded when they are written.
    """

    __slots__ = ("_bindings", "core", "descriptor", "destroyed", "id", "requested")

    def __init__(
        self, core: Core, descriptor: TextureDescriptor, compressed: CompressedFormat | None = None
    ) -> None:
        core.check_ready()
        self.requested = descriptor
        if compressed is not None:
            self.requested = replace(descriptor, compressed=compressed)
            step = core.capabilities.compressed_size_step
            whole = not any(size % step for size in descriptor.size)
            if compressed in core.capabilities.compressed_formats and whole:
                descriptor = self.requested
        core.require("device.texture", limits.texture_faults(descriptor, core.capabilities))
        core.require("device.texture", limits.compressed_faults(self.requested))
        self.core = core
        self.descriptor = descriptor
        integer_or_depth = descriptor.format.is_integer or descriptor.format.is_depth
        sampler = core.sampler(_NEAREST if integer_or_depth else _LINEAR)
        self.id = core.create_id()
        core.create(core.backend.create_texture, self.id, descriptor, _count_bytes(descriptor))
        self.destroyed = False
        self._bindings: dict[object, ref[Any]] = {}
        super().__init__(self.id, sampler)

    def __del__(self) -> None:
        if not getattr(self, "destroyed", True):  # it isn't there if creation failed
            drop(self, self.id)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of level 0."""
        return self.descriptor.size

    @property
    def format(self) -> Format:
        """The texel format."""
        return self.descriptor.format

    @property
    def kind(self) -> TextureKind:
        """The texture's kind: 2D, 2D array, 3D or cube."""
        return self.descriptor.kind

    @property
    def layers(self) -> int:
        """Number of array layers, 6 for a cube, the depth of a 3D texture."""
        return self.descriptor.layers

    @property
    def levels(self) -> int:
        """Number of mip levels."""
        return self.descriptor.levels

    @property
    def samples(self) -> int:
        """Number of samples per texel; 1 unless the texture is multi-sampled."""
        return self.descriptor.samples

    @property
    def compressed(self) -> CompressedFormat | None:
        """The block format that `write` takes, or None. The device stores the blocks if it can, else their
        decoded texels."""
        return self.requested.compressed

    @property
    def label(self) -> str:
        """The texture's name in messages and tools."""
        return self.descriptor.label

    def __repr__(self) -> str:
        return limits.show_texture(self.requested)

    def destroy(self) -> None:
        """Destroy the texture once the GPU no longer uses it. A second call does nothing."""
        if not self.destroyed:
            self.core.check_thread("destroy")
            self.core.program = None
            retire(self)

    # -- parts -------------------------------------------------------------------------------------------

    def at(self, level: int = 0, layer: int | None = 0) -> TextureTarget:
        """Return one level and layer as a render target. With `layer=None` it has all layers, among which
        vertex stages choose by a `TargetLayer`, if the device has `capabilities.layered_rendering`.

        Examples:
            >>> layers = device.texture((16, 16), rhi.Format.RGBA8, kind=rhi.TextureKind.D2_ARRAY, layers=4)
            >>> with device.render_pass(layers.at(layer=2), clear=(1, 1, 1, 1)):
            ...     pass
            >>> layers.read(layer=2)[0, 0].tolist()
            [255, 255, 255, 255]
        """
        layer = ArgumentChecker("Texture.at", self.core.refuse).integer_or_none("layer", layer)
        level, first = self._check("Texture.at", level, 0 if layer is None else layer)
        self.core.require("Texture.at", limits.plain_faults(self.requested))
        return TextureTarget(self, level, None if layer is None else first)

    def sampled(self, sampler: Sampler | SamplerDescriptor) -> TextureBinding:
        """Return a binding that reads this texture through another sampler.

        It is the same object as long as a program or a variable refers to it, so draws that call this again
        bind nothing again.

        Examples:
            >>> nearest = rhi.SamplerDescriptor(rhi.Filter.NEAREST, rhi.Filter.NEAREST)
            >>> with device.render_pass(image):
            ...     device.draw(device.program(Show), device.mesh(3), albedo=albedo.sampled(nearest))
        """
        core, call = self.core, "Texture.sampled"
        self._check(call)
        if isinstance(sampler, Sampler):
            descriptor = sampler.descriptor
            if core.sampler_descriptors.get(sampler.id) is descriptor:
                return self._intern_sampled(sampler.id)
        else:
            allowed = "a Sampler from device.sampler(…), or an rhi.SamplerDescriptor"
            descriptor = ArgumentChecker(call, core.refuse).instance(
                "sampler", sampler, SamplerDescriptor, allowed
            )
        return self._intern_sampled(core.sampler(descriptor))

    def _intern_sampled(self, sampler: Id) -> TextureBinding:
        """Return the binding with a sampler. It refers to the texture, so the texture refers to it weakly."""
        bindings = self._bindings
        reference = bindings.get(sampler)
        binding: TextureBinding | None = None if reference is None else reference()
        if binding is None:
            binding = TextureBinding(self.id, sampler, self)
            bindings[sampler] = ref(binding)
        return binding

    def image(self, level: int = 0, layer: int | None = None) -> ImageBinding:
        """Return a binding of one level, with all layers or one, for a shader's loads and stores. It is the
        same object as long as a program or a variable refers to it."""
        layer = ArgumentChecker("Texture.image", self.core.refuse).integer_or_none("layer", layer)
        level, first = self._check("Texture.image", level, layer or 0)
        layer = None if layer is None else first
        if self.requested.compressed is not None:  # seldom: a list of faults takes a microsecond
            self.core.require("Texture.image", limits.plain_faults(self.requested))
        key = level, layer
        reference = self._bindings.get(key)
        binding: ImageBinding | None = None if reference is None else reference()
        if binding is None:
            binding = ImageBinding(self.id, level, layer, self)
            self._bindings[key] = ref(binding)
        return binding

    # -- memory ------------------------------------------------------------------------------------------

    def _view(self) -> None:
        """Return None: the texels of no backend are in the order of an array."""

    def _read_array(self) -> NDArray[Any]:
        """Return level 0 of all layers as one array."""
        if self.layers == 1:
            return self.read()
        return np.stack([self.read(layer=layer) for layer in range(self.layers)])

    def read(self, level: int = 0, layer: int = 0, region: Region | None = None) -> NDArray[Any]:
        """Return one layer: (height, width, channels), or (height, width) for one channel; top row first.

        Waits for the device. Depth is read as float32. A packed format has one number per texel.

        Examples:
            >>> with device.render_pass(image, clear=(1, 0.5, 0, 1)):
            ...     pass
            >>> image.read()[0, 0].tolist()  # the top left texel
            [255, 128, 0, 255]
        """
        level, where = self._region("Texture.read", level, layer, region)
        texels = self._read("Texture.read", level, where, False)
        return texels[0, :, :, 0] if self.format.components == 1 else texels[0]

    def save(self, path: str | Path, level: int = 0, layer: int = 0) -> None:
        """Write one layer to an image file, as a screen would show it; the path's ending says in what format.

        Bytes are written as they are. Floats are linear light from 0 to 1, and written as sRGB; depth as
        grey. `R16` keeps its 16 bits in a PNG. Waits for the device.

        Raises:
            ValidationError: `texture-format` for integers, `image-file` for an ending that isn't known.
            DeviceError: `image-library` without Pillow.

        Examples:
            >>> image.save("frame.png")
        """
        if not isinstance(path, (str, Path)):
            ArgumentChecker("Texture.save", self.core.refuse).fail("path", path, "a str or a Path")
        image = convert_to_image(self.format, self.read(level, layer))
        if image is None:
            self.core.refuse(
                rules.TEXTURE_FORMAT, "Texture.save", self.format.name, "a format of colors or depth"
            )
        write_image(image, path)

    def _repr_png_(self) -> bytes | None:
        """Return the image for a notebook; None for formats that `save` refuses."""
        if self.destroyed or self.core.closed or self.samples > 1 or self.compressed is not None:
            return None
        image = convert_to_image(self.format, self.read())
        file = io.BytesIO()
        if image is not None:
            write_image(image, file, "png")
        return file.getvalue() or None

    def read_layers(self, level: int = 0) -> NDArray[Any]:
        """Return all layers: (layers, height, width, channels). Waits for the device."""
        level, region = self._whole("Texture.read_layers", level, self.core)
        return self._read("Texture.read_layers", level, region, False)

    def read_stencil(self, level: int = 0, layer: int = 0, region: Region | None = None) -> NDArray[np.uint8]:
        """Return the stencil values of one layer: (height, width) uint8. Waits for the device."""
        call = "Texture.read_stencil"
        level, where = self._region(call, level, layer, region)
        stencil: NDArray[np.uint8] = self._read(call, level, where, True)
        return stencil[0, :, :, 0]

    def read_async(self, level: int = 0, layer: int = 0, region: Region | None = None) -> Readback:
        """Begin to read one layer, as `read` does, and return its future at once.

        Without `capabilities.texture_buffer_copies` the texels are read now, and the future is done.

        Examples:
            >>> read = image.read_async()
            >>> read.result().shape
            (48, 64, 4)
        """
        call, core = "Texture.read_async", self.core
        self.core.require(call, limits.plain_faults(self.requested))
        level, where = self._region(call, level, layer, region)
        self.core.require(call, limits.single_sample_faults(self.descriptor))
        shape: tuple[int, ...] = (where.height, where.width)
        if self.format.components > 1:
            shape = (*shape, self.format.components)
        row_bytes = self._tight_row(where)
        readback = Readback(core, self.format.dtype, shape, where.height, row_bytes, _lowest(self.format))
        core.check_ready()
        if core.capabilities.texture_buffer_copies:
            core.backend.copy_texture_to_buffer(self.id, level, where, readback.take_memory(), 0, row_bytes)
            readback.begin()
        else:
            readback.complete(self._read(call, level, where, False))
        return readback

    def write(self, texels: NDArray[Any], level: int = 0, layer: int = 0, x: int = 0, y: int = 0) -> None:
        """Replace texels from (x, y) on.

        `texels` is (height, width, channels), (height, width) for one channel, or (layers, height, width,
        channels) for several layers from `layer` on; of volumes and layers of one channel (layers, height,
        width). For a format of red, green, blue and alpha it may lack alpha, which becomes 1; that copies the
        array, and so does float64, which is rounded to the format's floats. To a compressed texture, write
        blocks: (rows, columns, bytes) of uint8, with or without layers in front, from multiples of 4 texels on.

        Raises:
            ValidationError: `texture-data` for a wrong dtype or shape, `texture-region` beyond an edge,
                `texture-format` for depth, `texture-samples` for multi-sampled textures.

        Examples:
            >>> image.write(np.full((8, 8, 4), 255, np.uint8), x=16, y=8)
            >>> image.read()[8, 16].tolist()
            [255, 255, 255, 255]
        """
        call = "Texture.write"
        check = ArgumentChecker(call, self.core.refuse)
        level, layer = self._check(call, level, layer)
        if self.compressed is not None:
            blocks = check.array("texels", texels)
            x, y = check.integer("x", x), check.integer("y", y)
            self._write_blocks(call, self.compressed, blocks, level, layer, x, y)
            return
        self.core.require(call, limits.written_faults(self.descriptor))
        self.core.require(call, limits.single_sample_faults(self.descriptor))
        self.core.check_ready()
        array = check.array("texels", texels)
        components = self.format.components
        has_layers = self.descriptor.kind is not TextureKind.D2
        array = add_channel_axis(array, components, has_layers)
        if array.ndim == 2 and components == 1:
            array = array[None, :, :, None]
        elif array.ndim == 3:
            array = array[None]
        if array.ndim == 4 and array.shape[3] == 3 and components == 4 and not self.format.is_integer:
            array = _add_alpha(array, self.format)
        converted = convert_float64(array, self.format)
        if converted is None:
            largest = np.abs(array[np.isfinite(array)]).max()
            self.core.refuse(
                rules.TEXTURE_DATA, call, f"{largest} of float64", f"what {self.format.dtype} holds"
            )
        array = converted
        if array.dtype != self.format.dtype or array.ndim != 4 or array.shape[3] != components:
            allowed = f"(height, width, {components}) of {self.format.dtype}"
            tip = tip_for_texels(np.asarray(texels), self.format.dtype, has_layers)
            given = f"shape {np.shape(texels)} of {array.dtype}"
            self.core.refuse(rules.TEXTURE_DATA, call, given, allowed, tip)
        layers, height, width = array.shape[:3]
        region = Region(check.integer("x", x), check.integer("y", y), width, height, layer, layers)
        self._check_region(call, level, region)
        self.core.upload_bytes += array.nbytes
        self.core.backend.write_texture(
            self.id, level, region, np.ascontiguousarray(array).view(np.uint8).data
        )

    def _write_blocks(
        self,
        call: str,
        compressed: CompressedFormat,
        blocks: NDArray[Any],
        level: int,
        layer: int,
        x: int,
        y: int,
    ) -> None:
        """Write blocks as they are, or decode them if the device doesn't store them."""
        if blocks.ndim == 3:
            blocks = blocks[None]
        if blocks.dtype != np.uint8 or blocks.ndim != 4 or blocks.shape[3] != compressed.block_bytes:
            allowed = f"(rows, columns, {compressed.block_bytes}) of uint8"
            self.core.refuse(rules.TEXTURE_DATA, call, f"shape {blocks.shape} of {blocks.dtype}", allowed)
        layers, rows, columns = blocks.shape[:3]
        right, bottom = (
            size - at for size, at in zip(self.descriptor.level_size(level), (x, y), strict=True)
        )
        region = Region(
            x, y, min(columns * BLOCK, max(right, 0)), min(rows * BLOCK, max(bottom, 0)), layer, layers
        )
        whole = columns * BLOCK - region.width < BLOCK and rows * BLOCK - region.height < BLOCK
        if x % BLOCK or y % BLOCK or not whole:
            allowed = f"blocks inside {self.descriptor.level_size(level)}, from multiples of {BLOCK} on"
            self.core.refuse(rules.TEXTURE_REGION, call, f"{columns}×{rows} blocks at {x}, {y}", allowed)
        self._check_region(call, level, region)
        data: NDArray[Any] = np.ascontiguousarray(blocks)
        if self.descriptor.compressed is None:
            data = decode_level(compressed, data, region.width, region.height)
        self.core.check_ready()
        self.core.upload_bytes += data.nbytes
        self.core.backend.write_texture(self.id, level, region, data.reshape(-1).view(np.uint8).data)

    def generate_mipmaps(self) -> None:
        """Generate mip levels 1…, each from the one above, by a box filter in linear light.

        A texel is the mean of all that it covers: 2 texels along an even axis, 3 along an odd one.

        Examples:
            >>> texture = device.texture((32, 32), rhi.Format.RGBA8, levels=None)
            >>> texture.write(np.full((32, 32, 4), 255, np.uint8))
            >>> texture.generate_mipmaps()
            >>> texture.read(level=5).tolist()
            [[[255, 255, 255, 255]]]
        """
        self._generate_mipmaps(self.core)

    def _generate_mipmaps(self, core: Core) -> None:
        """Send a `generate_mipmaps` to `core`: the texture's own, or a command buffer's."""
        call = "Texture.generate_mipmaps"
        self._check(call, core=core)
        self.core.require(call, limits.mipmap_faults(self.requested))
        if self.levels > 1:
            core.check_ready()
            core.backend.generate_mipmaps(self.id)

    def copy_to(
        self,
        target: Texture,
        *,
        level: int = 0,
        region: Region | None = None,
        target_level: int = 0,
        x: int = 0,
        y: int = 0,
        layer: int = 0,
    ) -> None:
        """Copy a region (None: the whole level) to (x, y, layer) of `target_level`; the formats must be
        equal.

        Examples:
            >>> image.copy_to(image, region=rhi.Region(0, 0, 4, 4), x=8, y=8)
        """
        self._copy(self.core, target, level, region, target_level, x, y, layer)

    def _copy(
        self,
        core: Core,
        target: Texture,
        level: int,
        region: Region | None,
        target_level: int,
        x: int,
        y: int,
        layer: int,
    ) -> None:
        """Send a `copy_to` to `core`."""
        call = "Texture.copy_to"
        check = ArgumentChecker(call, self.core.refuse)
        check.instance("target", target, Texture, "a Texture")
        level, source_region = self._whole(call, level, core, region)
        target_level, layer = target._check(call, target_level, layer, core)
        x, y = check.integer("x", x), check.integer("y", y)
        end = Region(x, y, source_region.width, source_region.height, layer, source_region.layers)
        arguments = (self.requested, level, source_region, target.requested, target_level, end)
        core.require(call, limits.texture_copy_faults(*arguments, same=target is self))
        core.check_ready()
        core.backend.copy_texture(self.id, level, source_region, target.id, target_level, x, y, layer)

    def copy_to_buffer(
        self,
        target: Buffer | StorageBuffer[Any],
        *,
        level: int = 0,
        region: Region | None = None,
        offset: int = 0,
        row_bytes: int | None = None,
    ) -> None:
        """Copy a region (None: the whole level) to bytes of a buffer from `offset` on, on the device.

        The texels are those that `read` returns, depth as float32. Rows begin `row_bytes` apart (None: as
        tightly as the device can), and the rows of a layer follow those of the layer before.

        Raises:
            ValidationError: `buffer-alignment` for an offset that isn't a multiple of
                `capabilities.copy_offset_alignment`, or rows that aren't of `copy_row_alignment`, or either
                that aren't whole texels; `buffer-range` beyond the end; `device-capability` without
                `capabilities.texture_buffer_copies`.
        """
        self._copy_to_buffer(self.core, target, level, region, offset, row_bytes)

    def _copy_to_buffer(
        self,
        core: Core,
        target: Buffer | StorageBuffer[Any],
        level: int,
        region: Region | None,
        offset: int,
        row_bytes: int | None,
    ) -> None:
        """Send a `copy_to_buffer` to `core`."""
        call = "Texture.copy_to_buffer"
        level, region = self._whole(call, level, core, region)
        buffer, offset, row_bytes = self._check_rows(call, target, level, region, offset, row_bytes, core)
        core.backend.copy_texture_to_buffer(self.id, level, region, buffer.id, offset, row_bytes)

    def copy_from_buffer(
        self,
        source: Buffer | StorageBuffer[Any],
        *,
        level: int = 0,
        region: Region | None = None,
        offset: int = 0,
        row_bytes: int | None = None,
    ) -> None:
        """Copy bytes of a buffer from `offset` on to a region (None: the whole level), on the device.

        The layout and the errors are those of `copy_to_buffer`. Not for depth formats.
        """
        self._copy_from_buffer(self.core, source, level, region, offset, row_bytes)

    def _copy_from_buffer(
        self,
        core: Core,
        source: Buffer | StorageBuffer[Any],
        level: int,
        region: Region | None,
        offset: int,
        row_bytes: int | None,
    ) -> None:
        """Send a `copy_from_buffer` to `core`."""
        call = "Texture.copy_from_buffer"
        self.core.require(call, limits.written_faults(self.descriptor))
        level, region = self._whole(call, level, core, region)
        buffer, offset, row_bytes = self._check_rows(call, source, level, region, offset, row_bytes, core)
        core.backend.copy_buffer_to_texture(buffer.id, offset, row_bytes, self.id, level, region)

    def _check_rows(
        self,
        call: str,
        buffer: Buffer | StorageBuffer[Any],
        level: int,
        region: Region,
        offset: int,
        row_bytes: int | None,
        core: Core,
    ) -> tuple[Buffer, int, int]:
        """Check the layout of a region's rows in a buffer; return the buffer, the offset and the row
        pitch."""
        check = ArgumentChecker(call, self.core.refuse)
        buffer = check_buffer(check, "buffer", buffer)
        offset, row_bytes = check.integer("offset", offset), check.integer_or_none("row_bytes", row_bytes)
        core.check_usable(buffer, call)
        row_bytes = self._tight_row(region) if row_bytes is None else row_bytes
        faults = limits.row_faults(
            self.requested, level, region, offset, row_bytes, buffer.size, core.capabilities
        )
        core.require(call, faults)
        core.check_ready()
        return buffer, offset, row_bytes

    def _tight_row(self, region: Region) -> int:
        """Return the smallest row pitch in bytes of a region in a buffer."""
        texel = self.format.transfer_bytes
        step = max(texel, self.core.capabilities.copy_row_alignment)
        return -(-region.width * texel // step) * step

    def resolve_to(self, target: Texture) -> None:
        """Resolve this multi-sampled texture to `target`: average the samples; size and format must be
        equal.

        Examples:
            >>> samples = device.texture((64, 48), rhi.Format.RGBA8, samples=4)
            >>> with device.render_pass(samples, clear=(1, 1, 1, 1)):
            ...     device.draw(program, mesh, tint=(1, 0, 0, 1))
            >>> samples.resolve_to(image)
        """
        self._resolve(self.core, target)

    def _resolve(self, core: Core, target: Texture) -> None:
        """Send a `resolve_to` to `core`."""
        call = "Texture.resolve_to"
        ArgumentChecker(call, self.core.refuse).instance("target", target, Texture, "a Texture")
        self._check(call, core=core)
        target._check(call, core=core)
        self.core.require(
            call, limits.resolve_faults(self.requested, target.requested, self.core.capabilities)
        )
        core.check_ready()
        core.backend.resolve_texture(self.id, target.id)

    def lock(self, access: Access, level: int = 0, layer: int = 0, region: Region | None = None) -> Lock:
        """Create a lock: `with texture.lock(Access.WRITE) as texels:`, (height, width, channels), top row
        first.

        Examples:
            >>> with image.lock(rhi.Access.WRITE, region=rhi.Region(0, 0, 4, 4)) as texels:
            ...     texels[:] = 255
        """
        call = "Texture.lock"
        ArgumentChecker(call, self.core.refuse).choice("access", access, Access)
        self.core.require(call, limits.plain_faults(self.requested))
        if self.format.is_depth and access.writes:
            self.core.refuse(rules.TEXTURE_FORMAT, call, self.format.name, "a color format, or Access.READ")
        self.core.require(call, limits.single_sample_faults(self.descriptor))
        level, where = self._region(call, level, layer, region)
        return Lock(
            self,
            access,
            read=lambda: self._read(call, level, where, False)[0].copy(),
            make=lambda: np.zeros((where.height, where.width, self.format.components), self.format.dtype),
            write=lambda texels: self.write(texels, level, where.layer, where.x, where.y),
        )

    # -- checks ------------------------------------------------------------------------------------------

    def _check(self, call: str, level: int = 0, layer: int = 0, core: Core | None = None) -> tuple[int, int]:
        """Refuse a texture that can't be used now, and return a level and layer that it has."""
        check = ArgumentChecker(call, self.core.refuse)
        level, layer = check.integer("level", level), check.integer("layer", layer)
        core = core or self.core
        core.check_open()
        core.check_usable(self, call)
        if level or layer:  # every texture has the first of both
            self.core.require(call, limits.level_faults(self.descriptor, level, layer))
        return level, layer

    def _check_region(self, call: str, level: int, region: Region) -> None:
        self._check(call)
        self.core.require(call, limits.region_faults(self.descriptor, level, region))

    def _whole(self, call: str, level: int, core: Core, region: Region | None = None) -> tuple[int, Region]:
        """Return a level, and `region` or else all texels and layers of the level."""
        level, _ = self._check(call, level, core=core)
        if region is not None:
            return level, self._as_region(call, region)
        width, height = self.descriptor.level_size(level)
        return level, Region(0, 0, width, height, 0, self.descriptor.level_layers(level))

    def _region(self, call: str, level: int, layer: int, region: Region | None) -> tuple[int, Region]:
        """Return a level, and `region` or else all texels of the layer; either says which layer it is."""
        level, layer = self._check(call, level, layer)
        if region is None:
            return level, Region(0, 0, *self.descriptor.level_size(level), layer)
        region = self._as_region(call, region)
        if layer and not region.layer:
            region = replace(region, layer=layer)
        self._check_region(call, level, region)
        if region.layers != 1 or region.layer != (layer or region.layer):
            tip = "Texture.read_layers reads all layers of a level"
            self.core.refuse(
                rules.TEXTURE_REGION, call, f"{region}, layer={layer}", "a region of one layer", tip
            )
        return level, region

    def _as_region(self, call: str, region: Region) -> Region:
        allowed = "an rhi.Region(x, y, width, height), or None"
        return ArgumentChecker(call, self.core.refuse).instance("region", region, Region, allowed)

    def _read(self, call: str, level: int, region: Region, stencil: bool) -> NDArray[Any]:
        self._check(call)
        self.core.require(call, limits.read_faults(self.requested, level, region, stencil))
        self.core.check_ready()
        texels = self.core.backend.read_texture(self.id, level, region, stencil)
        lowest = _lowest(self.format)
        return texels if lowest is None else np.maximum(texels, texels.dtype.type(lowest))


def _lowest(format: Format) -> int | None:
    """Return the number that means −1 in a signed normalised format. The one below means it too, and some
    drivers store that, so it is read as this one."""
    return 1 - (1 << format.channel_bits[0] - 1) if format.kind is ChannelKind.SNORM else None


def _add_alpha(texels: NDArray[Any], format: Format) -> NDArray[Any]:
    """Return (…, 3) texels with an alpha of 1."""
    padded = np.empty((*texels.shape[:3], 4), texels.dtype)
    for channel in range(3):  # six times as fast as all three at once
        padded[..., channel] = texels[..., channel]
    padded[..., 3] = 1 if format.dtype.kind == "f" else np.iinfo(format.dtype).max  # type: ignore[type-var]
    return padded


def _count_bytes(descriptor: TextureDescriptor) -> int:
    """Return the size of all levels, layers and samples in bytes; their alignment on the device isn't
    counted."""
    texels = 0
    for level in range(descriptor.levels):
        width, height = descriptor.level_size(level)
        texels += width * height * descriptor.level_layers(level)
    return texels * descriptor.samples * descriptor.format.channels * descriptor.format.dtype.itemsize
