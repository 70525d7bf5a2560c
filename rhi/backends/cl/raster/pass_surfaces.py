"""Render targets as kernels see them, and their pending clears.

- A clear is deferred to the first batch that draws into its surface. Each tile then clears its own texels, on
  all workers in parallel, and depth is cleared where it is staged, without a round trip through memory.
- If another command comes first, or the pass ends without draws, the pending clears are executed as fills
  (`PassSurfaces.fill_cleared`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
import pyopencl as cl

from rhi.backends.cl.memory.cl_textures import ClTexture
from rhi.backends.cl.memory.planes import TexelPlane
from rhi.backends.cl.raster.merger import MergerKey
from rhi.contract.descriptors import ALL_LAYERS, Attachment, DepthAttachment
from rhi.contract.formats import Format
from rhi.contract.texels import encode

PATTERN_BYTES: Final = 16
"""Size of the pattern that kernels clear with: the clear value's texel, repeated."""


class RenderSurface:
    """A layer of a texture's plane, with all its samples; or all layers, where `layout` is that of the first.

    Attributes:
        address: the address of the plane's memory.
        layout: in bytes, the offset of the first sample in that memory, and the distances from row to row and
            from sample to sample.
        clear: the texel of a pending clear, or None.
    """

    __slots__ = ("_count", "_layer", "_plane", "address", "clear", "layout")

    def __init__(
        self, plane: TexelPlane, layer: int, samples: int, address: int, clear: bytes | None
    ) -> None:
        """`layer`: −1 for all."""
        self._plane = plane
        self._count = plane.layers if layer == ALL_LAYERS else samples
        layer = max(layer, 0)
        self._layer = layer
        self.address = address
        self.layout = plane.start + layer * plane.layer_bytes, plane.pitch, plane.layer_bytes
        self.clear = clear

    @property
    def pattern(self) -> bytes:
        """The texel of the pending clear as kernels take it; zeros without one."""
        texel = self.clear or b"\0"
        return texel * (PATTERN_BYTES // len(texel))

    def fill_cleared(self, queue: cl.CommandQueue) -> None:
        """Execute the pending clear, if there is one.

        Raises:
            pyopencl.Error: the driver refused; the clear stays pending.
        """
        if self.clear is not None:
            self._plane.fill(queue, self.clear, self._layer, self._count)
            self.clear = None

    def layout_of(self, layer: int) -> tuple[int, int, int]:
        """Return `layout` of a layer, counted from the surface's first."""
        start, pitch, layer_bytes = self.layout
        return start + layer * layer_bytes, pitch, layer_bytes


class PassSurfaces:
    """The surfaces that a pass draws into.

    Attributes:
        size: (width, height).
        colors: color surfaces by location.
        depth, stencil: None if the pass has none.
        texture: the texture that depth and stencil belong to.
        layers: the number of layers of a pass on all layers; 0 for other passes.
    """

    __slots__ = ("colors", "depth", "layers", "samples", "size", "stencil", "texture")

    def __init__(
        self,
        size: tuple[int, int],
        samples: int,
        colors: Sequence[RenderSurface],
        depth: RenderSurface | None,
        stencil: RenderSurface | None,
        texture: ClTexture | None,
        layers: int,
    ) -> None:
        self.size = size
        self.samples = samples
        self.colors = colors
        self.depth = depth
        self.stencil = stencil
        self.texture = texture
        self.layers = layers

    def surfaces_of(self, key: MergerKey) -> list[RenderSurface]:
        """Return the surfaces that a raster kernel takes, in its order."""
        surfaces = [self.colors[color.location] for color in key.colors]
        if key.has_depth:
            assert self.depth is not None
            surfaces.append(self.depth)
        if key.has_stencil:
            assert self.stencil is not None
            surfaces.append(self.stencil)
        return surfaces

    def fill_cleared(self, queue: cl.CommandQueue) -> None:
        """Execute all pending clears."""
        for surface in (*self.colors, self.depth, self.stencil):
            if surface is not None:
                surface.fill_cleared(queue)


def color_clear(attachment: Attachment, format: Format) -> bytes | None:
    """Return the texel that a color attachment is cleared to, or None."""
    return None if attachment.clear is None else _encode(format, attachment.clear[: format.channels])


def depth_clear(attachment: DepthAttachment, format: Format) -> bytes | None:
    """Return the texel that depth is cleared to, or None."""
    return None if attachment.clear is None else _encode(format, (attachment.clear,))


def stencil_clear(attachment: DepthAttachment) -> bytes | None:
    """Return the texel that stencil is cleared to, or None."""
    return None if attachment.clear_stencil is None else bytes([attachment.clear_stencil & 0xFF])


def _encode(format: Format, values: Sequence[float]) -> bytes:
    return _encode_bits(format, np.array(values, np.float64).tobytes())


@lru_cache(256)
def _encode_bits(format: Format, values: bytes) -> bytes:
    """Encode a texel; cached by the values' bits, since -0.0 equals 0.0."""
    return encode(format, np.frombuffer(values, np.float64)).tobytes()
