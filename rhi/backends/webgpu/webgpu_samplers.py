"""Samplers. For textures that can't be filtered there is a nearest-texel version, created on first use."""

from __future__ import annotations

from rhi.backends.webgpu.implementation import GpuObject
from rhi.backends.webgpu.webgpu_errors import translate_errors
from rhi.backends.webgpu.webgpu_formats import WRAPS, word
from rhi.contract.descriptors import Filter, Id, SamplerDescriptor

_ALL_LEVELS = 32.0
_LEVEL_0 = 0.25
"""The largest level of detail that reads level 0 alone and still tells minification from magnification."""


class Samplers:
    """The samplers of a device, by id."""

    def __init__(self, device: GpuObject) -> None:
        self._device = device
        self._descriptors: dict[Id, SamplerDescriptor] = {}
        self._samplers: dict[tuple[Id, bool, bool], GpuObject] = {}

    def create(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        self._descriptors[sampler] = descriptor

    def destroy(self, sampler: Id) -> None:
        del self._descriptors[sampler]
        for key in [key for key in self._samplers if key[0] == sampler]:
            del self._samplers[key]

    def get(self, sampler: Id, filters: bool, compares: bool) -> GpuObject:
        """Return a sampler; without `filters`, one that reads single texels."""
        key = (sampler, filters, compares)
        if key not in self._samplers:
            self._samplers[key] = self._make(
                self._descriptors.get(sampler, SamplerDescriptor()), filters, compares
            )
        return self._samplers[key]

    def _make(self, descriptor: SamplerDescriptor, filters: bool, compares: bool) -> GpuObject:
        def filter_of(filter_mode: Filter | None) -> str:
            return word(filter_mode.value) if filters and filter_mode is not None else "nearest"

        linear = filters and descriptor.minify is descriptor.magnify is descriptor.mip is Filter.LINEAR
        settings: dict[str, object] = {}
        if compares:
            settings["compare"] = (
                word(descriptor.compare.value) if descriptor.compare is not None else "always"
            )
        with translate_errors("device.sampler"):
            return self._device.create_sampler(
                address_mode_u=WRAPS[descriptor.wrap_u],
                address_mode_v=WRAPS[descriptor.wrap_v],
                address_mode_w=WRAPS[descriptor.wrap_w],
                mag_filter=filter_of(descriptor.magnify),
                min_filter=filter_of(descriptor.minify),
                mipmap_filter=filter_of(descriptor.mip),
                lod_min_clamp=0.0,
                lod_max_clamp=_LEVEL_0 if descriptor.mip is None else _ALL_LEVELS,
                max_anisotropy=int(descriptor.max_anisotropy) if linear else 1,
                **settings,
            )
