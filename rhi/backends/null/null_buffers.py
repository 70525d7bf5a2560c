"""Buffers in host memory, and the commands that change them.

- A buffer is an array of bytes.
- The methods named like commands are called when the queue reaches the command (`backend`), never earlier.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import BufferDescriptor, Id
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_MEMORY


class Buffers:
    """The buffers of a device.

    Attributes:
        memory: the bytes of each buffer, by id.
    """

    def __init__(self) -> None:
        self.memory: dict[Id, NDArray[np.uint8]] = {}

    def clear(self) -> None:
        """Release all memory."""
        self.memory.clear()

    # -- immediate -----------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        try:
            self.memory[buffer] = np.zeros(descriptor.size, np.uint8)
        except (MemoryError, ValueError) as error:
            raise DeviceError(DEVICE_MEMORY, "create_buffer", f"{descriptor.size} bytes") from error

    def read_buffer(self, buffer: Id, offset: int, size: int) -> bytes:
        return self.memory[buffer][offset : offset + size].tobytes()

    # -- commands ------------------------------------------------------------------------------------------

    def destroy(self, resource: Id) -> None:
        self.memory.pop(resource, None)

    def write_buffer(self, buffer: Id, offset: int, data: bytes) -> None:
        self.memory[buffer][offset : offset + len(data)] = np.frombuffer(data, np.uint8)

    def copy_buffer(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        copied = self.memory[source][source_offset : source_offset + size]
        self.memory[target][target_offset : target_offset + size] = copied

    def clear_buffer(self, buffer: Id, offset: int, size: int, value: int) -> None:
        self.memory[buffer][offset : offset + size].view("<u4")[:] = value & 0xFFFFFFFF

    # -- memory that commands read -------------------------------------------------------------------------

    def words(self, buffer: Id, offset: int, count: int) -> NDArray[np.uint32]:
        """Return `count` 32-bit words of a buffer as a view."""
        return self.memory[buffer][offset : offset + 4 * count].view("<u4")

    def rows(self, buffer: Id, offset: int, row_bytes: int, count: int, size: int) -> NDArray[np.uint8]:
        """Return `count` rows of `size` bytes that begin `row_bytes` apart, as a view (count, size)."""
        memory = self.memory[buffer][offset : offset + (count - 1) * row_bytes + size]
        return np.lib.stride_tricks.as_strided(memory, (count, size), (row_bytes, 1))
