"""The uses of formats that WebGPU's specification guarantees without optional features (section 26.1)."""

from __future__ import annotations

from typing import Final

from rhi.contract.formats import COLOR_FORMATS, ChannelKind, Format

_SNORM: Final = frozenset(form for form in Format if form.kind is ChannelKind.SNORM)
_UNORM16: Final = frozenset(f for f in Format if f.kind is ChannelKind.UNORM and f.channel_bits[0] == 16)
_INTEGERS: Final = frozenset(form for form in COLOR_FORMATS if form.is_integer)
_WORDS: Final = frozenset({Format.R32F, Format.R32UI, Format.R32I})
_STORABLE: Final = _WORDS | {
    Format.RGBA8,
    Format.RGBA8_SNORM,
    Format.RGBA8UI,
    Format.RGBA16F,
    Format.RGBA16UI,
    Format.RG32F,
    Format.RG32UI,
    Format.RG32I,
    Format.RGBA32F,
    Format.RGBA32UI,
    Format.RGBA32I,
}
_WIDE: Final = frozenset(
    {
        Format.RG32F,
        Format.RGBA32F,
        Format.R32UI,
        Format.RG32UI,
        Format.RGBA32UI,
        Format.R32I,
        Format.RG32I,
        Format.RGBA32I,
    }
)

UNSUPPORTED: Final = _UNORM16 | {Format.D32FS8}
UNRENDERABLE: Final = _SNORM | _UNORM16 | {Format.R11G11B10F}
"""Color formats that can't be targets."""
SINGLE_SAMPLED: Final = _WIDE | _SNORM | {Format.R11G11B10F}
UNRESOLVABLE: Final = _INTEGERS - _WIDE | {Format.R32F}
UNSTORABLE: Final = frozenset(COLOR_FORMATS) - _STORABLE
UNLOADABLE: Final = frozenset(COLOR_FORMATS) - _WORDS
"""Formats of images that can't be loaded from as well as stored to."""
