"""Planes of texels in plain OpenCL buffers, and memory for them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.context import ClContext
from rhi.backends.cl.errors import translate_errors
from rhi.contract.descriptors import Region

__rhi_internal__ = True

GRAIN: Final = 128
"""Memory comes in multiples of this many bytes, and at least as many are behind what was asked for."""
BLOCK: Final = 4
"""Texels along the edge of a block: rows are as long, and as many, as whole blocks need."""

_copy_box: Final[Any] = cl.enqueue_copy  # whose stubs name a box's arguments otherwise than it does

_MAX_PATTERN: Final = 128


class Plane:
    """Layers of texels from byte `start` of a buffer on, top row first.

    Attributes:
        texel: bytes of a texel.
        width, height, layers: in texels, without padding.
        pitch: bytes from one row to the next.
        layer_bytes: bytes from one layer to the next.
    """

    __slots__ = ("height", "layer_bytes", "layers", "memory", "pitch", "start", "texel", "width")

    def __init__(
        self, memory: cl.Buffer, start: int, texel: int, width: int, height: int, layers: int
    ) -> None:
        self.memory = memory
        self.start = start
        self.texel = texel
        self.width = width
        self.height = height
        self.layers = layers
        self.pitch, self.layer_bytes = pitches_of(texel, width, height)

    @property
    def _pitches(self) -> tuple[int, int]:
        return self.pitch, self.layer_bytes

    def write(
        self, queue: cl.CommandQueue, region: Region, texels: NDArray[np.uint8], block: bool
    ) -> cl.Event:
        event: cl.Event = _copy_box(queue, self.memory, texels, **self._host_box(region), is_blocking=block)
        return event

    def read(self, queue: cl.CommandQueue, region: Region, texels: NDArray[np.generic]) -> None:
        _copy_box(queue, texels, self.memory, **self._host_box(region))

    def copy(self, queue: cl.CommandQueue, region: Region, target: Plane, x: int, y: int, layer: int) -> None:
        if self.memory is target.memory and self._pitches != target._pitches:  # which OpenCL can't do at once
            box = region.width, region.height, region.layers
            size = pitches_of(self.texel, *box[:2])[1] * region.layers
            with translate_errors("Texture.copy_to", f"{size} bytes between two levels"):
                memory = cl.Buffer(queue.context, cl.mem_flags.READ_WRITE, size)
            between = Plane(memory, 0, self.texel, *box)
            self.copy(queue, region, between, 0, 0, 0)
            between.copy(queue, Region(0, 0, *box[:2], 0, box[2]), target, x, y, layer)
            return
        _copy_box(
            queue, target.memory, self.memory, src_origin=self._origin(region.x, region.y, region.layer),
            dst_origin=target._origin(x, y, layer),
            region=(region.width * self.texel, region.height, region.layers),
            src_pitches=self._pitches, dst_pitches=target._pitches,
        )  # fmt: skip

    def fill(self, queue: cl.CommandQueue, texel: bytes, layer: int, layers: int) -> None:
        """Padding, too."""
        start = self.start + layer * self.layer_bytes
        fill(queue, self.memory, texel, start, layers * self.layer_bytes)

    def _origin(self, x: int, y: int, layer: int) -> tuple[int, int, int]:
        """A box's corner. The level's start is added to the first number, a distance in bytes like any other:
        PoCL 3.1 crashes on boxes in sub-buffers."""
        return self.start + x * self.texel, y, layer

    def _host_box(self, region: Region) -> dict[str, tuple[int, ...]]:
        """A region of this memory, and tightly packed host memory."""
        row = region.width * self.texel
        return {
            "buffer_origin": self._origin(region.x, region.y, region.layer),
            "host_origin": (0, 0, 0),
            "region": (row, region.height, region.layers),
            "buffer_pitches": self._pitches,
            "host_pitches": (row, row * region.height),
        }


def pitches_of(texel: int, width: int, height: int) -> tuple[int, int]:
    """Bytes from row to row and from layer to layer."""
    pitch = _whole_blocks(width) * texel
    return pitch, _whole_blocks(height) * pitch


def alignment(device: cl.Device) -> int:
    """Bytes at whose multiples a part of a buffer may begin."""
    return max(16, int(device.mem_base_addr_align) // 8)


def allocate(context: ClContext, size: int) -> cl.Buffer:
    """Zeroed memory of the device.

    Raises:
        pyopencl.Error: there isn't as much.
    """
    size = round_up(size) + GRAIN
    made = cl.Buffer(context.context, cl.mem_flags.READ_WRITE, size)
    try:
        fill(context.queue, made, b"\0", 0, size)
    except cl.Error:
        made.release()
        raise
    return made


def fill(queue: cl.CommandQueue, memory: cl.Buffer, pattern: bytes, offset: int, size: int) -> None:
    """Repeat `pattern` (its length a power of two) over a range, a multiple of it at a multiple of it."""
    if not size:
        return
    while len(pattern) < _MAX_PATTERN and (offset | size) % (2 * len(pattern)) == 0:
        pattern += pattern
    cl.enqueue_fill_buffer(queue, memory, np.frombuffer(pattern, np.uint8), offset, size)


def _whole_blocks(size: int) -> int:
    return -(-size // BLOCK) * BLOCK


def round_up(size: int) -> int:
    """A size in whole grains."""
    return -(-size // GRAIN) * GRAIN
