"""Texel and index formats.

- A `Format` has channels of one kind, and the NumPy dtype that `Texture.read` and `Texture.write` use.
  Everything else that depends on formats is derived from these parts. A port adds
  only its API's name of the format.
- In a packed format all channels of a texel share one number, the first channel in its lowest bits. Arrays
  have one number per texel, as stored; `rhi.contract.texels` packs and unpacks them.
- Depth formats read back as float32, however they are stored; stencil reads back as uint8.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rhi.errors.choices import Choice


class ChannelKind(Choice):
    """The encoding of a channel, which decides the type that a shader reads."""

    UNORM = "unorm"
    SNORM = "snorm"
    FLOAT = "float"
    UINT = "uint"
    INT = "int"
    SRGB = "srgb"
    DEPTH = "depth"
    DEPTH_STENCIL = "depth_stencil"


def _bounds(kind: ChannelKind, bits: int) -> tuple[float, float]:
    """Return the smallest and the largest finite number of a channel."""
    if kind is ChannelKind.FLOAT:
        if bits < 16:  # 5 bits of exponent, no sign
            return 0.0, 2.0**16 - 2.0 ** (20 - bits)
        largest = float(np.finfo(f"f{bits // 8}").max)
        return -largest, largest
    if kind is ChannelKind.INT:
        return -(1 << bits - 1), (1 << bits - 1) - 1
    if kind is ChannelKind.UINT:
        return 0, (1 << bits) - 1
    return (-1.0 if kind is ChannelKind.SNORM else 0.0), 1.0


class Format(Choice):
    """A texel format: (channels, kind, NumPy dtype of one channel, bytes of a stored texel).

    The parts are also attributes: `channels`, `kind`, `dtype` and `texel_bytes`. Packed formats also name the
    bits of each channel, and their `dtype` is the dtype of a whole texel. Fixed-point depth formats name the
    bits of a depth.

    Attributes:
        depth_steps: the integer that represents depth 1 in a fixed-point depth format; 0 for other formats.
        components: numbers of `dtype` per texel in arrays: the channels, or 1 in a packed format.
        channel_bits: bits of each channel, in the order of the channels.
        channel_bounds: the smallest and the largest finite number of each channel. Normalised channels hold 0
            to 1 or −1 to 1.
    """

    R8 = (1, ChannelKind.UNORM, "u1", 1)
    RG8 = (2, ChannelKind.UNORM, "u1", 2)
    RGBA8 = (4, ChannelKind.UNORM, "u1", 4)
    RGBA8_SRGB = (4, ChannelKind.SRGB, "u1", 4)
    R8_SNORM = (1, ChannelKind.SNORM, "i1", 1)
    RG8_SNORM = (2, ChannelKind.SNORM, "i1", 2)
    RGBA8_SNORM = (4, ChannelKind.SNORM, "i1", 4)
    R16 = (1, ChannelKind.UNORM, "u2", 2)
    RG16 = (2, ChannelKind.UNORM, "u2", 4)
    RGBA16 = (4, ChannelKind.UNORM, "u2", 8)
    R16F = (1, ChannelKind.FLOAT, "f2", 2)
    RG16F = (2, ChannelKind.FLOAT, "f2", 4)
    RGBA16F = (4, ChannelKind.FLOAT, "f2", 8)
    R32F = (1, ChannelKind.FLOAT, "f4", 4)
    RG32F = (2, ChannelKind.FLOAT, "f4", 8)
    RGBA32F = (4, ChannelKind.FLOAT, "f4", 16)
    R8UI = (1, ChannelKind.UINT, "u1", 1)
    RG8UI = (2, ChannelKind.UINT, "u1", 2)
    RGBA8UI = (4, ChannelKind.UINT, "u1", 4)
    R16UI = (1, ChannelKind.UINT, "u2", 2)
    RG16UI = (2, ChannelKind.UINT, "u2", 4)
    RGBA16UI = (4, ChannelKind.UINT, "u2", 8)
    R32UI = (1, ChannelKind.UINT, "u4", 4)
    RG32UI = (2, ChannelKind.UINT, "u4", 8)
    RGBA32UI = (4, ChannelKind.UINT, "u4", 16)
    R32I = (1, ChannelKind.INT, "i4", 4)
    RG32I = (2, ChannelKind.INT, "i4", 8)
    RGBA32I = (4, ChannelKind.INT, "i4", 16)
    RGB10A2 = (4, ChannelKind.UNORM, "u4", 4, (10, 10, 10, 2))
    RGB10A2UI = (4, ChannelKind.UINT, "u4", 4, (10, 10, 10, 2))
    R11G11B10F = (3, ChannelKind.FLOAT, "u4", 4, (11, 11, 10))
    D16 = (1, ChannelKind.DEPTH, "f4", 2, (), 16)
    D24 = (1, ChannelKind.DEPTH, "f4", 4, (), 24)
    D32F = (1, ChannelKind.DEPTH, "f4", 4)
    D24S8 = (1, ChannelKind.DEPTH_STENCIL, "f4", 4, (), 24)
    D32FS8 = (1, ChannelKind.DEPTH_STENCIL, "f4", 8)

    channels: int
    kind: ChannelKind
    dtype: np.dtype[np.generic]
    texel_bytes: int
    components: int
    channel_bits: tuple[int, ...]
    channel_bounds: tuple[tuple[float, float], ...]
    depth_steps: int

    def __init__(
        self,
        channels: int,
        kind: ChannelKind,
        dtype: str,
        texel_bytes: int,
        packed: tuple[int, ...] = (),
        depth_bits: int = 0,
    ) -> None:
        # Enum would make two formats of equal parts aliases, so __new__ below numbers them.
        self.channels = channels
        self.kind = kind
        self.dtype = np.dtype(dtype)
        self.texel_bytes = texel_bytes
        self.components = 1 if packed else channels
        self.channel_bits = packed or (8 * self.dtype.itemsize,) * channels
        self.channel_bounds = tuple(_bounds(kind, bits) for bits in self.channel_bits)
        self.depth_steps = (1 << depth_bits) - 1 if depth_bits else 0

    def __new__(cls, *parts: object) -> Format:
        member = object.__new__(cls)
        member._value_ = len(cls.__members__)
        return member

    @property
    def transfer_bytes(self) -> int:
        """The bytes of a texel in arrays and in copies to and from buffers."""
        return self.components * self.dtype.itemsize

    @property
    def is_packed(self) -> bool:
        """True if the channels of a texel share one number."""
        return self.components < self.channels

    @property
    def is_depth(self) -> bool:
        """True if this is a depth format, with or without stencil."""
        return self.kind in (ChannelKind.DEPTH, ChannelKind.DEPTH_STENCIL)

    @property
    def has_stencil(self) -> bool:
        """True if this format has 8 bits of stencil beside the depth."""
        return self.kind is ChannelKind.DEPTH_STENCIL

    @property
    def is_integer(self) -> bool:
        """True if shaders read integers: no filtering, no blending."""
        return self.kind in (ChannelKind.UINT, ChannelKind.INT)


class IndexFormat(Choice):
    """The type of the elements of an index buffer. `size` is in bytes. `restart` is the largest index, which
    ends a primitive."""

    UINT16 = "u2"
    UINT32 = "u4"

    dtype: np.dtype[np.generic]
    size: int
    restart: int

    def __init__(self, code: str) -> None:
        self.dtype = np.dtype(code)
        self.size = self.dtype.itemsize
        self.restart = (1 << 8 * self.size) - 1


COLOR_FORMATS: Final = tuple(f for f in Format if not f.is_depth)
DEPTH_FORMATS: Final = tuple(f for f in Format if f.is_depth)
FLOAT32_FORMATS: Final = frozenset({Format.R32F, Format.RG32F, Format.RGBA32F})
