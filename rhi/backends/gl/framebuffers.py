"""Framebuffers: created when a pass first uses a set of attachments, deleted with any of their textures."""

from __future__ import annotations

import ctypes
from typing import Final, TypeAlias

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_textures import Textures
from rhi.contract.descriptors import ALL_LAYERS, Attachment, DepthAttachment, Id, PassDescriptor, TextureKind
from rhi.contract.formats import ChannelKind
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DRIVER

_AttachmentKey: TypeAlias = tuple[object, ...]

_LAYERED: Final = (TextureKind.D2_ARRAY, TextureKind.D3, TextureKind.CUBE)


class Framebuffers:
    """The framebuffers of one context."""

    def __init__(self, gl: EntryPoints, textures: Textures) -> None:
        self._gl = gl
        self._textures = textures
        self._names: dict[_AttachmentKey, int] = {}
        self._keys: dict[Id, set[_AttachmentKey]] = {}  # by texture
        self._attached: dict[_AttachmentKey, set[Id]] = {}

    def get_or_create(self, descriptor: PassDescriptor) -> int:
        """Return GL's name of the framebuffer for a pass, creating it on first use."""
        colors, depth = descriptor.colors, descriptor.depth
        key: _AttachmentKey = tuple((color.texture, color.level, color.layer) for color in colors)
        if depth is not None:
            key = (*key, "depth", depth.texture, depth.level, depth.layer)
        elif not colors:
            key = (descriptor.size, descriptor.samples)
        return self._names.get(key) or self._create(key, descriptor)

    def get_for_color(self, texture: Id) -> int:
        """Return GL's name of a framebuffer whose only attachment is level 0, layer 0 of `texture`, for
        resolves."""
        key = ((texture, 0, 0),)
        descriptor = PassDescriptor(self._textures[texture].descriptor.size, (Attachment(texture),))
        return self._names.get(key) or self._create(key, descriptor)

    def forget(self, texture: Id) -> None:
        """Delete the framebuffers that have `texture` as an attachment."""
        for key in list(self._keys.get(texture, ())):
            self._gl.delete(self._gl.DeleteFramebuffers, self._names.pop(key))
            for attached in self._attached.pop(
                key
            ):  # a texture may outlive thousands of textures that it shared a framebuffer with
                self._keys[attached].remove(key)
        self._keys.pop(texture, None)

    def _create(self, key: _AttachmentKey, descriptor: PassDescriptor) -> int:
        gl = self._gl
        name = gl.create(gl.CreateFramebuffers)
        for index, color in enumerate(descriptor.colors):
            self._attach(name, enums.COLOR_ATTACHMENT0 + index, color)
        points = [enums.COLOR_ATTACHMENT0 + index for index in range(len(descriptor.colors))]
        gl.NamedFramebufferDrawBuffers(name, len(points), (ctypes.c_uint * 8)(*points))
        if descriptor.depth is not None:
            kind = self._textures[descriptor.depth.texture].descriptor.format.kind
            has_stencil = kind is ChannelKind.DEPTH_STENCIL
            point = enums.DEPTH_STENCIL_ATTACHMENT if has_stencil else enums.DEPTH_ATTACHMENT
            self._attach(name, point, descriptor.depth)
        elif not descriptor.colors:
            gl.NamedFramebufferParameteri(name, enums.FRAMEBUFFER_DEFAULT_WIDTH, descriptor.size[0])
            gl.NamedFramebufferParameteri(name, enums.FRAMEBUFFER_DEFAULT_HEIGHT, descriptor.size[1])
            samples = descriptor.samples if descriptor.samples > 1 else 0
            gl.NamedFramebufferParameteri(name, enums.FRAMEBUFFER_DEFAULT_SAMPLES, samples)
        status = gl.CheckNamedFramebufferStatus(name, enums.FRAMEBUFFER)
        if status != enums.FRAMEBUFFER_COMPLETE:
            gl.delete(gl.DeleteFramebuffers, name)
            raise DeviceError(DEVICE_DRIVER, "device.render_pass", f"framebuffer status {status:#06x}")
        self._names[key] = name
        used = {color.texture for color in descriptor.colors}
        if descriptor.depth is not None:
            used.add(descriptor.depth.texture)
        self._attached[key] = used
        for texture in used:
            self._keys.setdefault(texture, set()).add(key)
        return name

    def _attach(self, name: int, point: int, attachment: Attachment | DepthAttachment) -> None:
        texture = self._textures[attachment.texture]
        level, layer = attachment.level, attachment.layer
        if texture.descriptor.kind in _LAYERED and layer != ALL_LAYERS:
            self._gl.NamedFramebufferTextureLayer(name, point, texture.name, level, layer)
        else:
            self._gl.NamedFramebufferTexture(name, point, texture.name, level)
