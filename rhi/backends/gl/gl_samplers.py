"""Samplers: GL sampler objects created from descriptors."""

from __future__ import annotations

import ctypes
from typing import Final

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_formats import map_enums
from rhi.backends.gl.gl_states import COMPARISONS
from rhi.contract.descriptors import Filter, Id, SamplerDescriptor, Wrap

_WRAPS: Final = map_enums(Wrap, MIRROR="MIRRORED_REPEAT", CLAMP="CLAMP_TO_EDGE", BORDER="CLAMP_TO_BORDER")
_FILTERS: Final = map_enums(Filter)
_MINIFIERS: Final[dict[tuple[Filter, Filter | None], int]] = {
    (texel, mip): getattr(enums, f"{texel.name}_MIPMAP_{mip.name}") for texel in Filter for mip in Filter
} | {(texel, None): value for texel, value in _FILTERS.items()}


class Samplers:
    """The samplers of one context.

    Attributes:
        names: GL's names, by id; id 0 is no sampler.
    """

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
