"""The transient memory of a command buffer: it lives as long as the commands that read it."""

from __future__ import annotations

from typing_extensions import Buffer as BytesLike

from rhi.contract.descriptors import Id


class Arena:
    """Memory that only grows, uploaded to the backend as one buffer at the first execution.

    It has the part of the interface of `Ring` that `TransientMemory` and `UniformRing` use.

    Attributes:
        buffer: id of the backend buffer that the memory will lie in.
        generation: 0, since the memory never moves to another buffer.
        data: everything written so far.
    """

    __slots__ = ("buffer", "data", "generation")

    def __init__(self, buffer: Id) -> None:
        self.buffer = buffer
        self.generation = 0
        self.data = bytearray()

    @property
    def capacity(self) -> int:
        """Number of bytes allocated."""
        return len(self.data)

    def write(self, data: BytesLike, size: int, alignment: int) -> int:
        """Append `size` bytes and return their offset, a multiple of `alignment`."""
        self.data.extend(bytes(-len(self.data) % alignment))
        offset = len(self.data)
        self.data.extend(memoryview(data)[:size])
        return offset
