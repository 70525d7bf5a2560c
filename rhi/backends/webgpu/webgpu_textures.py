"""Textures: creation, views, transfers and copies.

- Copies between textures and buffers have rows of multiples of 256 bytes; the device is told so.
- Depth and stencil are read and copied by programs (`tools`).
- A slice of a 3D texture can't be a target, so a 2D texture stands in for it: `attach` and `detach`.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.webgpu.command_encoder import Stream
from rhi.backends.webgpu.implementation import FormatUses, GpuObject
from rhi.backends.webgpu.tools import DEPTH_READ, STENCIL_READ, Tools
from rhi.backends.webgpu.webgpu_buffers import ANY_RESTART, Buffers
from rhi.backends.webgpu.webgpu_errors import translate_errors
from rhi.backends.webgpu.webgpu_flags import GpuTextureUsage
from rhi.backends.webgpu.webgpu_formats import COMPRESSED, DIMENSIONS, DUMMY_FORMAT, FORMATS
from rhi.contract.blocks import BLOCK
from rhi.contract.descriptors import BufferUsage, Id, Region, TextureDescriptor, TextureKind
from rhi.contract.texels import halve

TRANSFERS: Final = GpuTextureUsage.COPY_SRC | GpuTextureUsage.COPY_DST | GpuTextureUsage.TEXTURE_BINDING
_ROW: Final = 256
"""Alignment of the distance between rows in copies with buffers."""
"""The format of the dummy target of passes without targets."""


def make_texture(device: GpuObject, descriptor: TextureDescriptor, usage: int, form: str = "") -> GpuObject:
    """Return a new texture, of the format `form` if it is another than the descriptor's."""
    return device.create_texture(
        label=descriptor.label,
        size=(*descriptor.size, descriptor.layers),
        mip_level_count=descriptor.levels,
        sample_count=descriptor.samples,
        dimension="3d" if descriptor.kind is TextureKind.D3 else "2d",
        format=form or FORMATS[descriptor.format],
        usage=usage,
    )


class GpuTexture:
    """A texture: its object, its views, and the encoder that uses it."""

    __slots__ = ("descriptor", "form", "object", "serial", "views")

    def __init__(self, gpu_texture: GpuObject, descriptor: TextureDescriptor, form: str) -> None:
        self.object = gpu_texture
        self.descriptor = descriptor
        self.form = form
        self.serial = 0
        self.views: dict[tuple[object, ...], GpuObject] = {}

    def copy_location(self, level: int, x: int, y: int, layer: int) -> dict[str, Any]:
        """Return a copy location in the texture (`GPUTexelCopyTextureInfo`)."""
        return {"texture": self.object, "mip_level": level, "origin": (x, y, layer)}


class Textures:
    """The textures of a device, by id; `rhi.backends.webgpu.command_encoder.PassTargets`."""

    def __init__(
        self, device: GpuObject, stream: Stream, buffers: Buffers, tools: Tools, uses: FormatUses
    ) -> None:
        self.objects: dict[Id, GpuTexture] = {}
        self._device = device
        self._stream = stream
        self._buffers = buffers
        self._tools = tools
        self.usage = uses.usage
        self._stand_ins: list[tuple[GpuObject, dict[str, Any], tuple[int, int, int]]] = []
        self._dummies: dict[tuple[int, int, int], GpuObject] = {}
        stream.targets = self

    def __getitem__(self, texture: Id) -> GpuTexture:
        return self.objects[texture]

    # -- creation ----------------------------------------------------------------------------------------

    def make(self, descriptor: TextureDescriptor, usage: int, form: str = "") -> GpuObject:
        """Return a new texture of the device."""
        return make_texture(self._device, descriptor, usage, form)

    def create(self, texture: Id, descriptor: TextureDescriptor) -> None:
        if descriptor.compressed is not None:
            form, usage = COMPRESSED[descriptor.compressed], int(TRANSFERS)
        else:
            form = FORMATS[descriptor.format]
            usage = self.usage(descriptor.format, descriptor.kind, descriptor.samples)
        call = f"device.texture({descriptor.size}, {descriptor.format}, layers={descriptor.layers})"
        with translate_errors(call, memory=True):
            self.objects[texture] = GpuTexture(self.make(descriptor, usage, form), descriptor, form)
        if descriptor.kind is TextureKind.D3:
            # Without this, reading an unwritten slice makes wgpu clear all slices, also those that copies
            # wrote.
            for level in range(descriptor.levels):
                (width, height), depth = descriptor.level_size(level), descriptor.level_layers(level)
                texels = bytes(width * height * depth * descriptor.format.transfer_bytes)
                self.write(texture, level, Region(0, 0, width, height, 0, depth), texels)

    def destroy(self, texture: Id) -> None:
        removed = self.objects.pop(texture)
        removed.views.clear()
        removed.object.destroy()

    # -- views -------------------------------------------------------------------------------------------

    def use(self, texture: Id) -> GpuTexture:
        """Return a texture that the open encoder will use."""
        gpu_texture = self.objects[texture]
        gpu_texture.serial = self._stream.serial
        return gpu_texture

    def view(
        self,
        texture: Id,
        dimension: str,
        level: int,
        levels: int,
        layer: int,
        layers: int,
        aspect: str = "all",
    ) -> GpuObject:
        """Return a view of a texture, which the open encoder will use."""
        gpu_texture = self.use(texture)
        key = (dimension, level, levels, layer, layers, aspect)
        view = gpu_texture.views.get(key)
        if view is None:
            form = {"stencil-only": "stencil8", "depth-only": gpu_texture.form.removesuffix("-stencil8")}.get(
                aspect
            )
            with translate_errors("view"):
                view = gpu_texture.views[key] = gpu_texture.object.create_view(
                    dimension=dimension,
                    base_mip_level=level,
                    mip_level_count=levels,
                    base_array_layer=layer,
                    array_layer_count=layers,
                    aspect=aspect,
                    format=form,
                )
        return view

    def sampled_view(self, texture: Id) -> GpuObject:
        """Return the view of a texture for sampling: all of it, or its depth."""
        descriptor = self.objects[texture].descriptor
        layers = descriptor.layers if descriptor.kind in (TextureKind.D2_ARRAY, TextureKind.CUBE) else 1
        aspect = "depth-only" if descriptor.format.is_depth else "all"
        return self.view(texture, DIMENSIONS[descriptor.kind], 0, descriptor.levels, 0, layers, aspect)

    def image_view(self, texture: Id, kind: TextureKind, level: int, layer: int) -> GpuObject:
        """Return the view of a level of a texture for loads and stores; `layer` −1 shows all layers."""
        if kind is TextureKind.D3:
            return self.view(texture, "3d", level, 1, 0, 1)
        if kind is TextureKind.D2:
            return self.view(texture, "2d", level, 1, max(0, layer), 1)
        layers = self.objects[texture].descriptor.layers if layer < 0 else 1
        return self.view(texture, "2d-array", level, 1, max(0, layer), layers)

    # -- targets -----------------------------------------------------------------------------------------

    def attach(self, encoder: GpuObject, texture: Id, level: int, layer: int, loads: bool) -> GpuObject:
        gpu_texture = self.use(texture)
        descriptor = gpu_texture.descriptor
        if descriptor.kind is not TextureKind.D3:
            return self.view(texture, "2d", level, 1, layer, 1)
        width, height = descriptor.level_size(level)
        usage = GpuTextureUsage.COPY_SRC | GpuTextureUsage.COPY_DST | GpuTextureUsage.RENDER_ATTACHMENT
        flat = self.make(TextureDescriptor((width, height), descriptor.format), usage)
        copy_location, size = gpu_texture.copy_location(level, 0, 0, layer), (width, height, 1)
        if loads:
            encoder.copy_texture_to_texture(copy_location, {"texture": flat}, size)
        self._stand_ins.append((flat, copy_location, size))
        return flat.create_view()

    def detach(self, encoder: GpuObject) -> None:
        for flat, copy_location, size in self._stand_ins:
            encoder.copy_texture_to_texture({"texture": flat}, copy_location, size)
        self._stand_ins.clear()

    def name_format(self, texture: Id) -> str:
        return FORMATS[self.objects[texture].descriptor.format]

    def has_stencil(self, texture: Id) -> bool:
        return self.objects[texture].descriptor.format.has_stencil

    def dummy(self, size: tuple[int, int], samples: int) -> GpuObject:
        key = (*size, samples)
        if key not in self._dummies:
            self._dummies.clear()
            descriptor = TextureDescriptor(size, DUMMY_FORMAT, samples=samples)
            with translate_errors(f"a pass of {size}", memory=True):
                self._dummies[key] = self.make(descriptor, GpuTextureUsage.RENDER_ATTACHMENT).create_view()
        return self._dummies[key]

    # -- transfers ---------------------------------------------------------------------------------------

    def write(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        target, r = self.objects[texture], region
        self._stream.settle()
        self._buffers.before_write(target)
        compressed = target.descriptor.compressed
        width, height = r.width, r.height
        row, rows = width * target.descriptor.format.transfer_bytes, height
        if compressed is not None:
            # At the edge of a level, WebGPU copies whole blocks.
            width, height = (-(-size // BLOCK) * BLOCK for size in (width, height))
            row, rows = width // BLOCK * compressed.block_bytes, height // BLOCK
        with translate_errors("write_texture"):
            self._device.queue.write_texture(
                target.copy_location(level, r.x, r.y, r.layer),
                memoryview(data).tobytes(),
                {"offset": 0, "bytes_per_row": row, "rows_per_image": rows},
                (width, height, r.layers),
            )

    def read(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        source, r = self.objects[texture], region
        format = source.descriptor.format
        if format.is_depth:
            size = 4 * r.width * r.height * r.layers
            between, staging = self._buffers.temporary(size), self._buffers.stage(size)
            self._read_depth(texture, level, r, between, 0, 4 * r.width, stencil)
            self._stream.outside().copy_buffer_to_buffer(between, 0, staging, 0, -(-size // 4) * 4)
            data = self._buffers.collect(staging, size)
            shape = (r.layers, r.height, r.width, 1)
            if stencil:
                return np.frombuffer(data, np.uint32).astype(np.uint8).reshape(shape)
            return np.frombuffer(data, np.float32).reshape(shape).copy()
        row = r.width * format.transfer_bytes
        padded = -(-row // _ROW) * _ROW
        size = padded * r.height * r.layers
        staging = self._buffers.stage(size)
        self._stream.outside().copy_texture_to_buffer(*self._copy_sides(source, level, r, staging, 0, padded))
        data = self._buffers.collect(staging, size)
        rows = np.frombuffer(data, np.uint8).reshape(r.layers, r.height, padded)[:, :, :row]
        shape = (r.layers, r.height, r.width, format.components)
        return rows.copy().view(format.dtype).reshape(shape)  # rows without padding would be read-only

    @staticmethod
    def _copy_sides(
        texture: GpuTexture, level: int, r: Region, buffer: GpuObject, offset: int, row_bytes: int
    ) -> tuple[GpuObject, GpuObject, tuple[int, int, int]]:
        """Return a copy's location in a texture, its location in a buffer, and its size."""
        layout = {"buffer": buffer, "offset": offset, "bytes_per_row": row_bytes, "rows_per_image": r.height}
        return texture.copy_location(level, r.x, r.y, r.layer), layout, (r.width, r.height, r.layers)

    def copy_to_buffer(
        self, source: Id, level: int, region: Region, target: Id, offset: int, row_bytes: int
    ) -> None:
        encoder, r = self._stream.outside(), region
        texture, buffer = self.use(source), self._buffers.use(target)
        self._buffers.note_device_write(buffer)
        buffer.restarts = ANY_RESTART
        if not texture.descriptor.format.is_depth:
            encoder.copy_texture_to_buffer(
                *self._copy_sides(texture, level, r, buffer.object, offset, row_bytes)
            )
        elif buffer.descriptor.usage is not BufferUsage.READBACK:
            self._read_depth(source, level, r, buffer.object, offset, row_bytes, False)
        else:  # programs can't write it
            row = 4 * r.width
            between = self._buffers.temporary(row * r.height * r.layers)
            self._read_depth(source, level, r, between, 0, row, False)
            encoder = self._stream.outside()
            rows, step = (1, row * r.height * r.layers) if row_bytes == row else (r.height * r.layers, row)
            for number in range(rows):
                encoder.copy_buffer_to_buffer(
                    between, number * row, buffer.object, offset + number * row_bytes, step
                )

    def copy_from_buffer(
        self, source: Id, offset: int, row_bytes: int, target: Id, level: int, region: Region
    ) -> None:
        encoder = self._stream.outside()
        buffer = self._buffers.use(source).object
        copy_location, layout, size = self._copy_sides(
            self.use(target), level, region, buffer, offset, row_bytes
        )
        encoder.copy_buffer_to_texture(layout, copy_location, size)

    def _read_depth(
        self,
        texture: Id,
        level: int,
        r: Region,
        target: GpuObject,
        offset: int,
        row_bytes: int,
        stencil: bool,
    ) -> None:
        encoder = self._stream.outside()
        aspect, code = ("stencil-only", STENCIL_READ) if stencil else ("depth-only", DEPTH_READ)
        view = self.view(texture, "2d-array", level, 1, r.layer, r.layers, aspect)
        constants = self._tools.constants([r.x, r.y, r.width, r.height, offset // 4, row_bytes // 4, 0, 0])
        groups = (-(-r.width // 8), -(-r.height // 8), r.layers)
        with translate_errors("read_texture"):
            self._tools.compute(encoder, code, [view, {"buffer": target}, constants], *groups)

    # -- copies between textures -------------------------------------------------------------------------

    def copy(
        self,
        source: Id,
        source_level: int,
        source_region: Region,
        target: Id,
        target_level: int,
        x: int,
        y: int,
        layer: int,
    ) -> None:
        encoder, r = self._stream.outside(), source_region
        old, new = self.use(source), self.use(target)
        size = (r.width, r.height, r.layers)
        if old.descriptor.format.is_depth:
            self._copy_depth(encoder, source, source_level, r, target, target_level, x, y, layer)
        elif old is new:
            row = -(-r.width * old.descriptor.format.transfer_bytes // _ROW) * _ROW
            between = self._buffers.temporary(row * r.height * r.layers)
            encoder.copy_texture_to_buffer(*self._copy_sides(old, source_level, r, between, 0, row))
            into = Region(x, y, r.width, r.height, layer, r.layers)
            copy_location, layout, _ = self._copy_sides(new, target_level, into, between, 0, row)
            encoder.copy_buffer_to_texture(layout, copy_location, size)
        else:
            # Mesa's lavapipe copies only the first of several slices of a volume to layers, so each is copied.
            volumes = {texture.descriptor.kind is TextureKind.D3 for texture in (old, new)}
            layers = 1 if len(volumes) == 2 else r.layers
            for first in range(0, r.layers, layers):
                encoder.copy_texture_to_texture(
                    old.copy_location(source_level, r.x, r.y, r.layer + first),
                    new.copy_location(target_level, x, y, layer + first),
                    (r.width, r.height, layers),
                )

    def copy_whole(self, source: Id) -> GpuObject:
        """Return a copy of a texture, made at this point of the stream."""
        encoder, old = self._stream.outside(), self.use(source)
        descriptor = old.descriptor
        with translate_errors("a copy of a texture", memory=True):
            copy = self.make(descriptor, TRANSFERS, old.form)
        for level in range(descriptor.levels):
            size = (*descriptor.level_size(level), descriptor.level_layers(level))
            encoder.copy_texture_to_texture(
                old.copy_location(level, 0, 0, 0), {"texture": copy, "mip_level": level}, size
            )
        return copy

    def _copy_depth(
        self,
        encoder: GpuObject,
        source: Id,
        source_level: int,
        r: Region,
        target: Id,
        target_level: int,
        x: int,
        y: int,
        layer: int,
    ) -> None:
        old, new = self.objects[source], self.objects[target]
        size = (r.width, r.height)
        whole = (r.x, r.y) == (x, y) == (0, 0) and size == old.descriptor.level_size(source_level)
        if whole and size == new.descriptor.level_size(target_level) and old is not new:
            encoder.copy_texture_to_texture(
                old.copy_location(source_level, 0, 0, r.layer),
                new.copy_location(target_level, 0, 0, layer),
                (*size, r.layers),
            )
            return
        form, has_stencil = old.form, old.descriptor.format.has_stencil
        for number in range(r.layers):
            depth, stencil = self._depth_views(
                encoder, source, source_level, r.layer + number, old is new, has_stencil
            )
            into = self.view(target, "2d", target_level, 1, layer + number, 1)
            with translate_errors("copy_texture"):
                self._tools.draw_depth(encoder, form, depth, stencil, into, r, x, y)

    def _depth_views(
        self, encoder: GpuObject, texture: Id, level: int, layer: int, copied: bool, has_stencil: bool
    ) -> tuple[GpuObject, GpuObject | None]:
        """Return the views of the depth and the stencil of a layer, or of a copy of it."""
        if not copied:
            depth = self.view(texture, "2d", level, 1, layer, 1, "depth-only")
            return depth, self.view(
                texture, "2d", level, 1, layer, 1, "stencil-only"
            ) if has_stencil else None
        gpu_texture = self.objects[texture]
        descriptor = gpu_texture.descriptor
        size = descriptor.level_size(level)
        between = self.make(
            TextureDescriptor(size, descriptor.format), TRANSFERS | GpuTextureUsage.RENDER_ATTACHMENT
        )
        encoder.copy_texture_to_texture(
            gpu_texture.copy_location(level, 0, 0, layer), {"texture": between}, (*size, 1)
        )
        depth = between.create_view(aspect="depth-only", format=gpu_texture.form.removesuffix("-stencil8"))
        return depth, between.create_view(aspect="stencil-only", format="stencil8") if has_stencil else None

    def resolve(self, source: Id, target: Id) -> None:
        encoder = self._stream.outside()
        view, into = self.attach(encoder, source, 0, 0, True), self.attach(encoder, target, 0, 0, False)
        color = {"view": view, "resolve_target": into, "load_op": "load", "store_op": "store"}
        with translate_errors("resolve_texture"):
            encoder.begin_render_pass(color_attachments=[color]).end()

    def generate_mipmaps(self, texture: Id) -> None:
        gpu_texture = self.objects[texture]
        descriptor = gpu_texture.descriptor
        usage = self.usage(descriptor.format, descriptor.kind, 1)
        if (
            descriptor.kind is TextureKind.D3
            or not usage & GpuTextureUsage.RENDER_ATTACHMENT
            or descriptor.format.is_integer
        ):
            self._halve_on_cpu(texture, descriptor)
            return
        encoder = self._stream.outside()
        with translate_errors("generate_mipmaps"):
            for layer in range(descriptor.layers):
                for level in range(1, descriptor.levels):
                    source = self.view(texture, "2d", level - 1, 1, layer, 1)
                    target = self.view(texture, "2d", level, 1, layer, 1)
                    self._tools.halve(encoder, gpu_texture.form, source, target)

    def _halve_on_cpu(self, texture: Id, descriptor: TextureDescriptor) -> None:
        above = self.read(texture, 0, Region(0, 0, *descriptor.size, 0, descriptor.layers), False)
        for level in range(1, descriptor.levels):
            above = halve(descriptor.format, above, descriptor.level_layers(level))
            width, height = descriptor.level_size(level)
            region = Region(0, 0, width, height, 0, len(above))
            self.write(texture, level, region, np.ascontiguousarray(above).data)
