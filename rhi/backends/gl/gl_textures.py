"""Textures, all with immutable storage.

- They are GL's own: moderngl has one depth format, and no stencil, views or storage textures.
- Rows are transferred as they are: row 0 is the top row on both sides.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_errors import drain_errors, find_error
from rhi.backends.gl.gl_formats import CLEAR_FORMATS, COMPRESSED, PIXEL_FORMATS, PixelFormat, map_enums
from rhi.contract.descriptors import Id, Region, TextureDescriptor, TextureKind

_ANY_SIZE: Final = (1 << 31) - 1
_TARGETS: Final = map_enums(TextureKind, D2="TEXTURE_2D", D3="TEXTURE_3D", CUBE="TEXTURE_CUBE_MAP")
_TRANSFERS: Final = {
    enums.PACK_ALIGNMENT: 1,
    enums.PACK_ROW_LENGTH: 0,
    enums.PACK_IMAGE_HEIGHT: 0,
    enums.PACK_SKIP_PIXELS: 0,
    enums.PACK_SKIP_ROWS: 0,
    enums.PACK_SKIP_IMAGES: 0,
    enums.PACK_SWAP_BYTES: 0,
    enums.UNPACK_ALIGNMENT: 1,
    enums.UNPACK_ROW_LENGTH: 0,
    enums.UNPACK_IMAGE_HEIGHT: 0,
    enums.UNPACK_SKIP_PIXELS: 0,
    enums.UNPACK_SKIP_ROWS: 0,
    enums.UNPACK_SKIP_IMAGES: 0,
    enums.UNPACK_SWAP_BYTES: 0,
}


@dataclass(frozen=True, slots=True)
class GlTexture:
    """A texture: GL's name and target, its descriptor, and its format for GL."""

    name: int
    target: int
    descriptor: TextureDescriptor
    pixel: PixelFormat


class Textures:
    """The textures of one context.

    Attributes:
        names: GL's names, by id.
        adopting: the GL name of a texture of other code that the next `create` takes over; 0 for none.
    """

    def __init__(self, gl: EntryPoints) -> None:
        self._gl = gl
        self._textures: dict[Id, GlTexture] = {}
        self.names: dict[Id, int] = {}
        self.adopting = 0
        self._adopted: dict[Id, int] = {}  # GL's maximum level that the owner of an adopted texture had set
        self.set_transfers()

    def set_transfers(self) -> None:
        """Set how texels are transferred: tightly packed, between GL and the CPU's memory."""
        for parameter, value in _TRANSFERS.items():
            self._gl.PixelStorei(parameter, value)
        self._gl.BindBuffer(enums.PIXEL_PACK_BUFFER, 0)
        self._gl.BindBuffer(enums.PIXEL_UNPACK_BUFFER, 0)

    def __getitem__(self, texture: Id) -> GlTexture:
        return self._textures[texture]

    def describe(self, name: int) -> TextureDescriptor | str:
        """Return the descriptor of a texture of other code, or the reason why it can't be used."""
        gl, value = self._gl, ctypes.c_int()

        def get(parameter: int, level: int = 0) -> int:
            gl.GetTextureLevelParameteriv(name, level, parameter, ctypes.byref(value))
            return value.value

        if not gl.IsTexture(name):
            return f"{name}, the name of no texture that both contexts share"
        gl.GetTextureParameteriv(name, enums.TEXTURE_TARGET, ctypes.byref(value))
        target = value.value
        kind = next((kind for kind, number in _TARGETS.items() if number == target), None)
        size = get(enums.TEXTURE_WIDTH), get(enums.TEXTURE_HEIGHT)
        internal = get(enums.TEXTURE_INTERNAL_FORMAT)
        format = next(
            (candidate for candidate, pixel in PIXEL_FORMATS.items() if pixel.internal == internal), None
        )
        if kind is None or format is None:
            return f"a texture of target {target:#06x} and format {internal:#06x}"
        layers = 6 if kind is TextureKind.CUBE else get(enums.TEXTURE_DEPTH)
        most = max(*size, layers if kind is TextureKind.D3 else 1).bit_length()
        levels = next((level for level in range(1, most) if not get(enums.TEXTURE_WIDTH, level)), most)
        return TextureDescriptor(size, format, kind, layers, levels)

    def create(self, texture: Id, descriptor: TextureDescriptor) -> None:
        gl = self._gl
        drain_errors(gl)
        if self.adopting:
            self._textures[texture] = GlTexture(
                self.adopting, _TARGETS[descriptor.kind], descriptor, PIXEL_FORMATS[descriptor.format]
            )
            self.names[texture] = self.adopting
            last = ctypes.c_int()
            gl.GetTextureParameteriv(self.adopting, enums.TEXTURE_MAX_LEVEL, ctypes.byref(last))
            gl.TextureParameteri(
                self.adopting, enums.TEXTURE_MAX_LEVEL, descriptor.levels - 1
            )  # otherwise the texture is incomplete
            self._adopted[texture] = last.value
            return
        target = enums.TEXTURE_2D_MULTISAMPLE if descriptor.samples > 1 else _TARGETS[descriptor.kind]
        name = gl.create(gl.CreateTextures, target)
        pixel = PIXEL_FORMATS[descriptor.format]
        if descriptor.compressed is not None:
            pixel = pixel._replace(internal=COMPRESSED[descriptor.compressed])
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
        for level in range(descriptor.levels if descriptor.compressed is None else 0):
            gl.ClearTexImage(name, level, clear.format, clear.type, None)
        if descriptor.samples == 1:  # so that texel fetches without a sampler work, for integers too
            gl.TextureParameteri(name, enums.TEXTURE_MIN_FILTER, enums.NEAREST_MIPMAP_NEAREST)
            gl.TextureParameteri(name, enums.TEXTURE_MAG_FILTER, enums.NEAREST)
        if descriptor.label:
            gl.ObjectLabel(enums.TEXTURE, name, -1, descriptor.label.encode())
        self._textures[texture] = GlTexture(name, target, descriptor, pixel)
        self.names[texture] = name

    def destroy(self, texture: Id) -> None:
        del self._textures[texture]
        name = self.names.pop(texture)
        if texture not in self._adopted:
            self._gl.delete(self._gl.DeleteTextures, name)
        else:
            last = self._adopted.pop(texture)
            if self._gl.IsTexture(name):
                self._gl.TextureParameteri(name, enums.TEXTURE_MAX_LEVEL, last)

    def write(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        pixels, gl_texture = np.frombuffer(memoryview(data), np.uint8), self._textures[texture]
        if gl_texture.descriptor.compressed is None:
            self._upload(gl_texture, level, region, pixels.ctypes.data)
            return
        r = region
        internal = gl_texture.pixel.internal
        target = gl_texture.target
        if target == enums.TEXTURE_2D:
            self._gl.CompressedTextureSubImage2D(
                gl_texture.name, level, r.x, r.y, r.width, r.height, internal, len(pixels), pixels.ctypes.data
            )
        else:
            self._gl.CompressedTextureSubImage3D(
                gl_texture.name,
                level,
                r.x,
                r.y,
                r.layer,
                r.width,
                r.height,
                r.layers,
                internal,
                len(pixels),
                pixels.ctypes.data,
            )

    def _upload(self, gl_texture: GlTexture, level: int, region: Region, pixels: int) -> None:
        """Write texels from an address, or from an offset in the buffer that is bound for unpacking."""
        r, (_, texel, kind) = region, gl_texture.pixel
        if gl_texture.target == enums.TEXTURE_2D:
            self._gl.TextureSubImage2D(
                gl_texture.name, level, r.x, r.y, r.width, r.height, texel, kind, pixels
            )
        else:
            self._gl.TextureSubImage3D(
                gl_texture.name, level, r.x, r.y, r.layer, r.width, r.height, r.layers, texel, kind, pixels
            )

    def read(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        gl_texture, r = self._textures[texture], region
        _, texel, kind = gl_texture.pixel
        dtype = gl_texture.descriptor.format.dtype
        if stencil:
            texel = enums.STENCIL_INDEX
            kind = enums.UNSIGNED_BYTE
            dtype = np.dtype(np.uint8)
        components = gl_texture.descriptor.format.components
        pixels = np.empty((r.layers, r.height, r.width, components), dtype)
        self._gl.GetTextureSubImage(
            gl_texture.name,
            level,
            r.x,
            r.y,
            r.layer,
            r.width,
            r.height,
            r.layers,
            texel,
            kind,
            pixels.nbytes,
            pixels.ctypes.data,
        )
        return pixels

    def copy_to_buffer(
        self, source: Id, level: int, region: Region, buffer: int, offset: int, row_bytes: int
    ) -> None:
        """Copy texels to GL's buffer `buffer`."""
        gl = self._gl
        gl_texture = self._textures[source]
        r = region
        _, texel, kind = gl_texture.pixel
        gl.PixelStorei(enums.PACK_ROW_LENGTH, row_bytes // gl_texture.descriptor.format.transfer_bytes)
        gl.BindBuffer(enums.PIXEL_PACK_BUFFER, buffer)
        gl.GetTextureSubImage(
            gl_texture.name,
            level,
            r.x,
            r.y,
            r.layer,
            r.width,
            r.height,
            r.layers,
            texel,
            kind,
            _ANY_SIZE,
            offset,
        )
        gl.BindBuffer(enums.PIXEL_PACK_BUFFER, 0)
        gl.PixelStorei(enums.PACK_ROW_LENGTH, 0)

    def copy_from_buffer(
        self, buffer: int, offset: int, row_bytes: int, target: Id, level: int, region: Region
    ) -> None:
        """Copy texels from GL's buffer `buffer`."""
        gl, gl_texture = self._gl, self._textures[target]
        gl.PixelStorei(enums.UNPACK_ROW_LENGTH, row_bytes // gl_texture.descriptor.format.transfer_bytes)
        gl.BindBuffer(enums.PIXEL_UNPACK_BUFFER, buffer)
        self._upload(gl_texture, level, region, offset)
        gl.BindBuffer(enums.PIXEL_UNPACK_BUFFER, 0)
        gl.PixelStorei(enums.UNPACK_ROW_LENGTH, 0)

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
        old = self._textures[source]
        new = self._textures[target]
        r = source_region
        self._gl.CopyImageSubData(
            old.name,
            old.target,
            source_level,
            r.x,
            r.y,
            r.layer,
            new.name,
            new.target,
            target_level,
            x,
            y,
            layer,
            r.width,
            r.height,
            r.layers,
        )
