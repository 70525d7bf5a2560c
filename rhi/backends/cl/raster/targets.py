"""What a pass draws into, as kernels see it, and what of it is still to be cleared.

- A clear waits for the first batch that draws into its surface: each tile then clears its own texels, which all workers
  do at once, and depth is drawn into without having been to memory before.
- Whatever else comes first, and the end of a pass that drew nothing, fills what is left (`Target.fill_cleared`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
import pyopencl as cl

from rhi.backends.cl.planes import TexelPlane
from rhi.backends.cl.raster.merger import MergerKey
from rhi.backends.cl.textures import Texture
from rhi.contract.descriptors import Attachment, DepthAttachment
from rhi.contract.formats import Format
from rhi.contract.texels import encode

__rhi_internal__ = True

PATTERN_BYTES: Final = 16
"""A texel to clear to is given to kernels repeated to as many bytes."""


class Surface:
    """A layer of a texture's plane, with all its samples.

    Attributes:
        address: that of the memory.
        place: in it: where the first sample begins, bytes from row to row, bytes from sample to sample.
        clear: the texel that it is still to be cleared to, or None.
    """

    __slots__ = ("_layer", "_plane", "_samples", "address", "clear", "place")

    def __init__(self, plane: TexelPlane, layer: int, samples: int, address: int, clear: bytes | None) -> None:
        self._plane = plane
        self._layer = layer
        self._samples = samples
        self.address = address
        self.place = plane.start + layer * plane.layer_bytes, plane.pitch, plane.layer_bytes
        self.clear = clear

    @property
    def pattern(self) -> bytes:
        """The texel to clear to, as kernels are given it."""
        texel = self.clear or b"\0"
        return texel * (PATTERN_BYTES // len(texel))

    def fill_cleared(self, queue: cl.CommandQueue) -> None:
        """Clear it now, if that is still to be done.

        Raises:
            pyopencl.Error: the driver refuses; it stays to be done.
        """
        if self.clear is not None:
            self._plane.fill(queue, self.clear, self._layer, self._samples)
            self.clear = None


class Target:
    """What a pass draws into.

    Attributes:
        size: (width, height).
        colors: by location.
        depth, stencil: None without one.
        texture: the one that depth and stencil belong to.
    """

    __slots__ = ("colors", "depth", "samples", "size", "stencil", "texture")

    def __init__(
        self, size: tuple[int, int], samples: int, colors: Sequence[Surface], depth: Surface | None,
        stencil: Surface | None, texture: Texture | None,
    ) -> None:  # fmt: skip
        self.size = size
        self.samples = samples
        self.colors = colors
        self.depth = depth
        self.stencil = stencil
        self.texture = texture

    def surfaces_of(self, key: MergerKey) -> list[Surface]:
        """Those that a raster kernel takes, in its order."""
        surfaces = [self.colors[color.location] for color in key.colors]
        if key.has_depth:
            assert self.depth is not None
            surfaces.append(self.depth)
        if key.has_stencil:
            assert self.stencil is not None
            surfaces.append(self.stencil)
        return surfaces

    def fill_cleared(self, queue: cl.CommandQueue) -> None:
        """Clear now whatever is still to be cleared."""
        for surface in (*self.colors, self.depth, self.stencil):
            if surface is not None:
                surface.fill_cleared(queue)


def color_clear(attachment: Attachment, format: Format) -> bytes | None:
    """The texel that a color target begins with, if it is cleared."""
    return None if attachment.clear is None else _encode(format, attachment.clear[: format.channels])


def depth_clear(attachment: DepthAttachment, format: Format) -> bytes | None:
    """The same of depth."""
    return None if attachment.clear is None else _encode(format, (attachment.clear,))


def stencil_clear(attachment: DepthAttachment) -> bytes | None:
    """The same of stencil."""
    return None if attachment.clear_stencil is None else bytes([attachment.clear_stencil & 0xFF])


def _encode(format: Format, values: Sequence[float]) -> bytes:
    return _encode_bits(format, np.array(values, np.float64).tobytes())


@lru_cache(256)
def _encode_bits(format: Format, values: bytes) -> bytes:
    """By bits, since -0.0 equals 0.0."""
    return encode(format, np.frombuffer(values, np.float64)).tobytes()
