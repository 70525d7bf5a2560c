"""Buffers, textures and samplers.

- Tables are dictionaries by id; the two that a draw goes through hold moderngl's bound C methods, which cost a
  tenth of a ctypes call with as many arguments.
- A STREAM buffer is mapped once, persistently and coherently; writing it is a copy into that memory, unordered
  as the contract allows.
- Textures are GL's own (moderngl has no depth formats beyond one, no stencil, views or storage), all with
  immutable storage. Rows go over as they are: row 0 is the top row on both sides.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import moderngl
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.errors import drain_errors, find_error
from rhi.backends.gl.formats import CLEAR_FORMATS, PIXEL_FORMATS, PixelFormat
from rhi.backends.gl.states import COMPARISONS
from rhi.contract.descriptors import (
    BufferDescriptor,
    BufferUsage,
    Filter,
    Id,
    Region,
    SamplerDescriptor,
    TextureDescriptor,
    TextureKind,
    Wrap,
)

__rhi_internal__ = True

BindRange: TypeAlias = Callable[[int, int, int], object]
"""(slot, offset, size)"""

_STREAM_FLAGS: Final = enums.MAP_WRITE_BIT | enums.MAP_PERSISTENT_BIT | enums.MAP_COHERENT_BIT
_MODERNGL_MAX_SIZE: Final = (1 << 31) - 1  # of an external buffer; its ranges are 64-bit

_TARGETS: Final = {
    TextureKind.D2: enums.TEXTURE_2D,
    TextureKind.D2_ARRAY: enums.TEXTURE_2D_ARRAY,
    TextureKind.D3: enums.TEXTURE_3D,
    TextureKind.CUBE: enums.TEXTURE_CUBE_MAP,
}
_WRAPS: Final = {
    Wrap.REPEAT: enums.REPEAT,
    Wrap.MIRROR: enums.MIRRORED_REPEAT,
    Wrap.CLAMP: enums.CLAMP_TO_EDGE,
    Wrap.BORDER: enums.CLAMP_TO_BORDER,
}
_FILTERS: Final = {Filter.NEAREST: enums.NEAREST, Filter.LINEAR: enums.LINEAR}
_MINIFIERS: Final = {
    (Filter.NEAREST, None): enums.NEAREST,
    (Filter.LINEAR, None): enums.LINEAR,
    (Filter.NEAREST, Filter.NEAREST): enums.NEAREST_MIPMAP_NEAREST,
    (Filter.LINEAR, Filter.NEAREST): enums.LINEAR_MIPMAP_NEAREST,
    (Filter.NEAREST, Filter.LINEAR): enums.NEAREST_MIPMAP_LINEAR,
    (Filter.LINEAR, Filter.LINEAR): enums.LINEAR_MIPMAP_LINEAR,
}


class Buffers:
    """All buffers of one context.

    Attributes:
        bind_uniform, bind_storage: by id, the functions that bind a range of a buffer to a slot.
        objects: by id, the moderngl buffers.
    """

    def __init__(self, context: moderngl.Context, gl: EntryPoints) -> None:
        self._context = context
        self._gl = gl
        self.objects: dict[Id, moderngl.Buffer] = {}
        self.bind_uniform: dict[Id, BindRange] = {}
        self.bind_storage: dict[Id, BindRange] = {}
        self._mappings: dict[Id, memoryview] = {}

    def create(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        drain_errors(self._gl)
        create = self._create_stream if descriptor.usage is BufferUsage.STREAM else self._create_static
        made, mapping = create(descriptor.size)
        error = find_error(self._gl, f"device.buffer(size={descriptor.size})")
        if error is not None:
            made.release()
            raise error
        if mapping is not None:
            self._mappings[buffer] = mapping
        if descriptor.label:
            self._gl.ObjectLabel(enums.BUFFER, made.glo, -1, descriptor.label.encode())
        self.objects[buffer] = made
        self.bind_uniform[buffer] = made.mglo.bind_to_uniform_block
        self.bind_storage[buffer] = made.mglo.bind_to_storage_buffer

    def _create_static(self, size: int) -> tuple[moderngl.Buffer, None]:
        made = self._context.buffer(reserve=size)
        self._gl.ClearNamedBufferSubData(
            made.glo, enums.R8UI, 0, size, enums.RED_INTEGER, enums.UNSIGNED_BYTE, None
        )
        return made, None

    def _create_stream(self, size: int) -> tuple[moderngl.Buffer, memoryview | None]:
        gl = self._gl
        name = gl.create(gl.CreateBuffers)
        gl.NamedBufferStorage(name, size, None, _STREAM_FLAGS)
        address = gl.MapNamedBufferRange(name, 0, size, _STREAM_FLAGS)
        made = self._context.external_buffer(name, min(size, _MODERNGL_MAX_SIZE))
        if not address:
            return made, None
        ctypes.memset(address, 0, size)
        return made, memoryview((ctypes.c_char * size).from_address(address)).cast("B")

    def destroy(self, buffer: Id) -> None:
        del self.bind_uniform[buffer], self.bind_storage[buffer]
        self._mappings.pop(buffer, None)
        self.objects.pop(buffer).release()

    def write(self, buffer: Id, offset: int, data: BytesLike) -> None:
        mapping = self._mappings.get(buffer)
        if mapping is None:
            self.objects[buffer].mglo.write(data, offset)
            return
        try:
            mapping[offset : offset + len(data)] = data  # type: ignore[arg-type]
        except (ValueError, TypeError, NotImplementedError):  # not a row of bytes; nothing was copied
            source = np.frombuffer(memoryview(data), np.uint8)
            mapping[offset : offset + len(source)] = source.data

    def read(self, buffer: Id, offset: int, size: int) -> bytes:
        if buffer not in self._mappings:
            return bytes(self.objects[buffer].mglo.read(size, offset))
        data = ctypes.create_string_buffer(size)
        self._gl.GetNamedBufferSubData(self.objects[buffer].glo, offset, size, data)
        return data.raw

    def copy(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        self._gl.CopyNamedBufferSubData(
            self.objects[source].glo, self.objects[target].glo, source_offset, target_offset, size
        )

    def clear(self, buffer: Id, offset: int, size: int, value: int) -> None:
        self._gl.ClearNamedBufferSubData(
            self.objects[buffer].glo, enums.R32UI, offset, size, enums.RED_INTEGER, enums.UNSIGNED_INT,
            ctypes.byref(ctypes.c_uint(value)),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Texture:
    """A texture: GL's name and target, and what it was made from."""

    name: int
    target: int
    descriptor: TextureDescriptor
    pixel: PixelFormat


class Textures:
    """All textures of one context; `names` are GL's, by id."""

    def __init__(self, gl: EntryPoints) -> None:
        self._gl = gl
        self._textures: dict[Id, Texture] = {}
        self.names: dict[Id, int] = {}
        gl.PixelStorei(enums.PACK_ALIGNMENT, 1)
        gl.PixelStorei(enums.UNPACK_ALIGNMENT, 1)

    def __getitem__(self, texture: Id) -> Texture:
        return self._textures[texture]

    def create(self, texture: Id, descriptor: TextureDescriptor) -> None:
        gl = self._gl
        drain_errors(gl)
        target = enums.TEXTURE_2D_MULTISAMPLE if descriptor.samples > 1 else _TARGETS[descriptor.kind]
        name = gl.create(gl.CreateTextures, target)
        pixel = PIXEL_FORMATS[descriptor.format]
        width, height = descriptor.size
        if descriptor.samples > 1:
            gl.TextureStorage2DMultisample(name, descriptor.samples, pixel.internal, width, height, True)
        elif descriptor.kind in (TextureKind.D2, TextureKind.CUBE):
            gl.TextureStorage2D(name, descriptor.levels, pixel.internal, width, height)
        else:
            gl.TextureStorage3D(name, descriptor.levels, pixel.internal, width, height, descriptor.layers)
        call = f"device.texture({descriptor.size}, {descriptor.format}, layers={descriptor.layers})"
        error = find_error(gl, call)
        if error is not None:
            gl.delete(gl.DeleteTextures, name)
            raise error
        clear = CLEAR_FORMATS[descriptor.format]
        for level in range(descriptor.levels):
            gl.ClearTexImage(name, level, clear.format, clear.type, None)
        if descriptor.samples == 1:  # for texel fetches without a sampler, of integers too
            gl.TextureParameteri(name, enums.TEXTURE_MIN_FILTER, enums.NEAREST_MIPMAP_NEAREST)
            gl.TextureParameteri(name, enums.TEXTURE_MAG_FILTER, enums.NEAREST)
        if descriptor.label:
            gl.ObjectLabel(enums.TEXTURE, name, -1, descriptor.label.encode())
        self._textures[texture] = Texture(name, target, descriptor, pixel)
        self.names[texture] = name

    def destroy(self, texture: Id) -> None:
        del self._textures[texture]
        self._gl.delete(self._gl.DeleteTextures, self.names.pop(texture))

    def write(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        made, r = self._textures[texture], region
        pixels = np.frombuffer(memoryview(data), np.uint8).ctypes.data
        _, texel, kind = made.pixel
        if made.target == enums.TEXTURE_2D:
            self._gl.TextureSubImage2D(made.name, level, r.x, r.y, r.width, r.height, texel, kind, pixels)
        else:
            self._gl.TextureSubImage3D(
                made.name, level, r.x, r.y, r.layer, r.width, r.height, r.layers, texel, kind, pixels
            )

    def read(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        made, r = self._textures[texture], region
        _, texel, kind = made.pixel
        dtype = made.descriptor.format.dtype
        if stencil:
            texel, kind, dtype = enums.STENCIL_INDEX, enums.UNSIGNED_BYTE, np.dtype(np.uint8)
        channels = made.descriptor.format.channels
        pixels = np.empty((r.layers, r.height, r.width, channels), dtype)
        self._gl.GetTextureSubImage(
            made.name, level, r.x, r.y, r.layer, r.width, r.height, r.layers, texel, kind, pixels.nbytes,
            pixels.ctypes.data,
        )  # fmt: skip
        return pixels

    def copy(
        self, source: Id, source_level: int, source_region: Region, target: Id, target_level: int, x: int, y: int,
        layer: int,
    ) -> None:  # fmt: skip
        old, new, r = self._textures[source], self._textures[target], source_region
        self._gl.CopyImageSubData(
            old.name, old.target, source_level, r.x, r.y, r.layer,
            new.name, new.target, target_level, x, y, layer, r.width, r.height, r.layers,
        )  # fmt: skip


class Samplers:
    """All samplers of one context; `names` by id, 0 being no sampler."""

    def __init__(self, gl: EntryPoints) -> None:
        self._gl = gl
        self.names: dict[Id, int] = {0: 0}

    def create(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        gl = self._gl
        name = gl.create(gl.CreateSamplers)
        settings = {
            enums.TEXTURE_MIN_FILTER: _MINIFIERS[descriptor.minify, descriptor.mip],
            enums.TEXTURE_MAG_FILTER: _FILTERS[descriptor.magnify],
            enums.TEXTURE_WRAP_S: _WRAPS[descriptor.wrap_u],
            enums.TEXTURE_WRAP_T: _WRAPS[descriptor.wrap_v],
            enums.TEXTURE_WRAP_R: _WRAPS[descriptor.wrap_w],
        }
        if descriptor.compare is not None:
            settings[enums.TEXTURE_COMPARE_MODE] = enums.COMPARE_REF_TO_TEXTURE
            settings[enums.TEXTURE_COMPARE_FUNC] = COMPARISONS[descriptor.compare]
        for parameter, value in settings.items():
            gl.SamplerParameteri(name, parameter, value)
        gl.SamplerParameterfv(name, enums.TEXTURE_BORDER_COLOR, (ctypes.c_float * 4)(*descriptor.border))
        if descriptor.max_anisotropy > 1.0:
            gl.SamplerParameterf(name, enums.TEXTURE_MAX_ANISOTROPY, descriptor.max_anisotropy)
        self.names[sampler] = name

    def destroy(self, sampler: Id) -> None:
        self._gl.delete(self._gl.DeleteSamplers, self.names.pop(sampler))
