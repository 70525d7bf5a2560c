"""Allocation of OpenCL buffers, and planes of texels in them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.cl_context import EMPTY, allocate_pages
from rhi.backends.cl.cl_errors import translate_errors
from rhi.contract.descriptors import Region

GRAIN: Final = 128
"""Allocations are multiples of this many bytes, with at least this many bytes of padding behind the requested
size."""
BLOCK: Final = 4
"""Edge length of a block in texels. Rows and columns of a plane are padded to whole blocks."""

_copy_box: Final[Any] = cl.enqueue_copy  # pyopencl's stubs misname the arguments of a copy between boxes

_MAX_PATTERN: Final = 128


class TexelPlane:
    """Layers of texels that begin at byte `start` of a buffer, top row first.

    Attributes:
        address: that of the buffer's first byte, where kernels read host memory in place.
        texel_bytes: size of a texel.
        width, height, layers: extent in texels, without padding.
        pitch: bytes from one row to the next.
        layer_bytes: bytes from one layer to the next.
    """

    __slots__ = (
        "address",
        "height",
        "layer_bytes",
        "layers",
        "memory",
        "pitch",
        "start",
        "texel_bytes",
        "width",
    )

    def __init__(
        self, memory: cl.Buffer, start: int, texel_bytes: int, width: int, height: int, layers: int
    ) -> None:
        self.memory = memory
        self.address = buffer_address(memory)
        self.start = start
        self.texel_bytes = texel_bytes
        self.width = width
        self.height = height
        self.layers = layers
        self.pitch, self.layer_bytes = pitches_of(texel_bytes, width, height)

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

    def copy_to_buffer(
        self, queue: cl.CommandQueue, region: Region, target: cl.Buffer, offset: int, row_bytes: int
    ) -> None:
        """Copy texels to rows of a buffer that begin `row_bytes` apart."""
        _copy_box(
            queue,
            target,
            self.memory,
            src_origin=self._origin(region.x, region.y, region.layer),
            dst_origin=(offset, 0, 0),
            region=(region.width * self.texel_bytes, region.height, region.layers),
            src_pitches=self._pitches,
            dst_pitches=(row_bytes, row_bytes * region.height),
        )

    def copy_from_buffer(
        self, queue: cl.CommandQueue, source: cl.Buffer, offset: int, row_bytes: int, region: Region
    ) -> None:
        """Copy texels from rows of a buffer that begin `row_bytes` apart."""
        _copy_box(
            queue,
            self.memory,
            source,
            src_origin=(offset, 0, 0),
            dst_origin=self._origin(region.x, region.y, region.layer),
            region=(region.width * self.texel_bytes, region.height, region.layers),
            src_pitches=(row_bytes, row_bytes * region.height),
            dst_pitches=self._pitches,
        )

    def copy(
        self, queue: cl.CommandQueue, region: Region, target: TexelPlane, x: int, y: int, layer: int
    ) -> None:
        # OpenCL can't copy between two pitches of one buffer. It may also take two levels of equal pitches
        # for boxes of one level that overlap.
        if self.memory is target.memory and self.start != target.start:
            box = region.width, region.height, region.layers
            size = pitches_of(self.texel_bytes, *box[:2])[1] * region.layers
            with translate_errors("Texture.copy_to", f"{size} bytes between two levels"):
                memory = cl.Buffer(queue.context, cl.mem_flags.READ_WRITE, size)
            between = TexelPlane(memory, 0, self.texel_bytes, *box)
            self.copy(queue, region, between, 0, 0, 0)
            between.copy(queue, Region(0, 0, *box[:2], 0, box[2]), target, x, y, layer)
            return
        _copy_box(
            queue,
            target.memory,
            self.memory,
            src_origin=self._origin(region.x, region.y, region.layer),
            dst_origin=target._origin(x, y, layer),
            region=(region.width * self.texel_bytes, region.height, region.layers),
            src_pitches=self._pitches,
            dst_pitches=target._pitches,
        )

    def fill(self, queue: cl.CommandQueue, texel: bytes, layer: int, layers: int) -> None:
        """Set all texels of some layers, and their padding."""
        start = self.start + layer * self.layer_bytes
        fill(queue, self.memory, texel, start, layers * self.layer_bytes)

    def _origin(self, x: int, y: int, layer: int) -> tuple[int, int, int]:
        """Return a box's origin as OpenCL takes it. The plane's start is added to its first component, which
        is in bytes, since PoCL 3.1 crashes on boxes in sub-buffers."""
        return self.start + x * self.texel_bytes, y, layer

    def _host_box(self, region: Region) -> dict[str, tuple[int, ...]]:
        """Return the arguments of a copy between a region of this plane and tightly packed host memory."""
        row = region.width * self.texel_bytes
        return {
            "buffer_origin": self._origin(region.x, region.y, region.layer),
            "host_origin": (0, 0, 0),
            "region": (row, region.height, region.layers),
            "buffer_pitches": self._pitches,
            "host_pitches": (row, row * region.height),
        }


def pitches_of(texel_bytes: int, width: int, height: int) -> tuple[int, int]:
    """Return the distances in bytes from row to row and from layer to layer."""
    pitch = _whole_blocks(width) * texel_bytes
    return pitch, _whole_blocks(height) * pitch


def alignment(device: cl.Device) -> int:
    """Return the alignment in bytes that a device requires of a sub-buffer's offset."""
    return max(16, int(device.mem_base_addr_align) // 8)


def allocate(context: cl.Context, size: int, data: NDArray[Any] = EMPTY) -> cl.Buffer:
    """Return a new buffer in host memory that lives as long as the buffer's Python object: `data`, then
    zeros, with padding behind them.

    Raises:
        pyopencl.Error, MemoryError: out of memory.
    """
    host = allocate_pages(round_to_grain(size) + GRAIN, data)
    return cl.Buffer(context, cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR, hostbuf=host)


def buffer_address(memory: cl.Buffer) -> int:
    """Return the address of a buffer that `allocate` made; 0 for others."""
    host: Any = memory.hostbuf
    return 0 if host is None else int(host.ctypes.data)


def fill(queue: cl.CommandQueue, memory: cl.Buffer, pattern: bytes, offset: int, size: int) -> None:
    """Fill a range with repetitions of `pattern`, whose length is a power of two and divides offset and
    size."""
    if not size:
        return
    while len(pattern) < _MAX_PATTERN and (offset | size) % (2 * len(pattern)) == 0:
        pattern += pattern
    cl.enqueue_fill_buffer(queue, memory, np.frombuffer(pattern, np.uint8), offset, size)


def _whole_blocks(size: int) -> int:
    return -(-size // BLOCK) * BLOCK


def round_to_grain(size: int) -> int:
    """Round a size up to a multiple of `GRAIN`."""
    return -(-size // GRAIN) * GRAIN
