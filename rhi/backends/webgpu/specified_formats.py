"""The uses of formats as WebGPU's specification states them, for implementations that keep to it.

A page can't try them: it would have to wait for each error.
"""

from __future__ import annotations

from collections.abc import Set as AbstractSet

from rhi.backends.webgpu.webgpu_flags import GpuTextureUsage
from rhi.backends.webgpu.webgpu_textures import TRANSFERS
from rhi.contract import webgpu_formats
from rhi.contract.descriptors import TextureKind
from rhi.contract.formats import FLOAT32_FORMATS, Format


class SpecifiedFormats:
    """The uses of formats on a device with these features; `implementation.FormatUses`."""

    def __init__(self, features: AbstractSet[str]) -> None:
        packed: set[Format] = set()
        if "rg11b10ufloat-renderable" in features:
            packed.add(Format.R11G11B10F)
        stencil = {Format.D32FS8} if "depth32float-stencil8" in features else set()
        self._unsupported = webgpu_formats.UNSUPPORTED - stencil
        self._unrenderable = webgpu_formats.UNRENDERABLE - packed
        self._single = webgpu_formats.SINGLE_SAMPLED - packed
        self._unblendable = frozenset() if "float32-blendable" in features else FLOAT32_FORMATS

    def usage(self, format: Format, kind: TextureKind, samples: int) -> int:
        """Return all usages of textures like this, 0 if they can't exist."""
        flat = kind is not TextureKind.D3
        target = format not in self._unrenderable and (flat or not format.is_depth)
        if format in self._unsupported or (format.is_depth and not flat):
            return 0
        if samples > 1:
            multiplies = target and samples == 4 and format not in self._single
            return (
                int(GpuTextureUsage.TEXTURE_BINDING | GpuTextureUsage.RENDER_ATTACHMENT) if multiplies else 0
            )
        usage = TRANSFERS | (GpuTextureUsage.RENDER_ATTACHMENT if target else 0)
        stored = not format.is_depth and format not in webgpu_formats.UNSTORABLE
        return int(usage | (GpuTextureUsage.STORAGE_BINDING if stored else 0))

    def blends(self, format: Format) -> bool:
        """True if draws can blend with a format, and for integers, which never blend."""
        return format not in self._unblendable

    def resolves(self, format: Format) -> bool:
        """True if four samples of a format can be resolved."""
        return format not in webgpu_formats.UNRESOLVABLE

    def is_image(self, format: Format, access: str) -> bool:
        """True if images of a format allow this access."""
        absent = (
            webgpu_formats.UNLOADABLE if access == "read-write" else webgpu_formats.UNSTORABLE
        ) | self._unsupported
        return format not in absent
