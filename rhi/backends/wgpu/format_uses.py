"""The uses of formats on an adapter, found by trying: drivers differ from what features promise.

They are found once for each adapter: wgpu-native keeps whatever it refuses, and with refused commands their
device.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import wgpu

from rhi.backends.webgpu.implementation import GpuObject, Host
from rhi.backends.webgpu.webgpu_flags import GpuShaderStage, GpuTextureUsage
from rhi.backends.webgpu.webgpu_formats import FORMATS
from rhi.backends.webgpu.webgpu_textures import TRANSFERS, make_texture
from rhi.contract.descriptors import TextureDescriptor, TextureKind
from rhi.contract.formats import ChannelKind, Format

_TRIANGLE: Final = """
@vertex fn vs() -> @builtin(position) vec4<f32> { return vec4<f32>(); }
@fragment fn fs() -> @location(0) vec4<f32> { return vec4<f32>(); }
"""
_ALWAYS_BLEND: Final = frozenset(
    {
        Format.R8,
        Format.RG8,
        Format.RGBA8,
        Format.RGBA8_SRGB,
        Format.R16F,
        Format.RG16F,
        Format.RGBA16F,
        Format.RGB10A2,
    }
)
_usages: Final[dict[object, dict[tuple[Format, TextureKind, int], int]]] = {}
"""The usages of textures that each adapter allows, by format, kind and number of samples."""


class TriedFormats:
    """The uses of formats on a device; `rhi.backends.webgpu.implementation.FormatUses`."""

    def __init__(self, host: Host) -> None:
        self._device = host.device
        self._usages = _usages.setdefault(host.key, {})
        self._module: GpuObject | None = None

    def _works(self, make: Callable[[], object]) -> bool:
        try:
            make()
        except wgpu.GPUError:
            return False
        return True

    def usage(self, format: Format, kind: TextureKind, samples: int) -> int:
        """Return all usages of textures like this, 0 if they can't exist."""
        key = (format, kind, samples)
        if key not in self._usages:
            base = TRANSFERS if samples == 1 else GpuTextureUsage.TEXTURE_BINDING
            target, image = GpuTextureUsage.RENDER_ATTACHMENT, GpuTextureUsage.STORAGE_BINDING
            more = [target | image, target, image, GpuTextureUsage(0)] if samples == 1 else [target]
            layers = {TextureKind.D2: 1, TextureKind.CUBE: 6}.get(kind, 2)
            probe = TextureDescriptor((4, 4), format, kind, layers, 1, samples)

            def can_make(usage: int) -> bool:
                return self._works(lambda: make_texture(self._device, probe, usage).destroy())

            self._usages[key] = next((int(base | use) for use in more if can_make(base | use)), 0)
        return self._usages[key]

    def blends(self, format: Format) -> bool:
        """True if draws can blend with a format, and for integers, which never blend."""
        return format.is_integer or format in _ALWAYS_BLEND or self._works(lambda: self._blend(format))

    def _blend(self, format: Format) -> None:
        if self._module is None:
            self._module = self._device.create_shader_module(code=_TRIANGLE)
        part = {"operation": "add", "src_factor": "one", "dst_factor": "one"}
        target: dict[str, Any] = {"format": FORMATS[format], "blend": {"color": part, "alpha": part}}
        self._device.create_render_pipeline(
            layout="auto",
            vertex={"module": self._module, "entry_point": "vs"},
            fragment={"module": self._module, "entry_point": "fs", "targets": [target]},
        )

    def resolves(self, format: Format) -> bool:
        """True if four samples of a format can be resolved."""
        always = format.kind in (ChannelKind.UNORM, ChannelKind.SRGB)
        return always or self._works(lambda: self._resolve(format))

    def _resolve(self, format: Format) -> None:
        source, target = (
            make_texture(
                self._device,
                TextureDescriptor((4, 4), format, samples=samples),
                GpuTextureUsage.RENDER_ATTACHMENT,
            )
            for samples in (4, 1)
        )
        color = {
            "view": source.create_view(),
            "resolve_target": target.create_view(),
            "load_op": "clear",
            "store_op": "store",
        }
        encoder = self._device.create_command_encoder()
        encoder.begin_render_pass(color_attachments=[color]).end()
        self._device.queue.submit([encoder.finish()])  # wgpu-native keeps commands that aren't submitted

    def is_image(self, format: Format, access: str) -> bool:
        """True if images of a format allow this access."""
        if not self.usage(format, TextureKind.D2, 1) & GpuTextureUsage.STORAGE_BINDING:
            return False
        image = {"access": access, "format": FORMATS[format], "view_dimension": "2d"}
        entry = {"binding": 0, "visibility": GpuShaderStage.COMPUTE, "storage_texture": image}
        return self._works(lambda: self._device.create_bind_group_layout(entries=[entry]))
