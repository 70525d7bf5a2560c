"""Uniform blocks in transient memory, for the values that draws bind and for `transient.uniform`.

A device has one `UniformRing`, over a `Ring`. Each command buffer has one of its own, over an `Arena`.
"""

from __future__ import annotations

from typing import Any, Final

from rhi.contract.descriptors import Id
from rhi.device.core.arena import Arena
from rhi.device.core.core import Core
from rhi.device.core.ring import Ring
from rhi.shading.language.bindings import UniformRange


class TransientOwner:
    """The owner of a range or mesh in transient memory; it stands in for a resource in the checks.

    An owner with a `buffer` can bind uniform ranges of that buffer.
    """

    __slots__ = ("bind_uniform", "core", "destroyed", "label", "write_uniform")

    def __init__(self, core: Core, label: str, buffer: Id = 0) -> None:
        self.core = core
        if buffer:
            self.bind_uniform = core.prepare_uniform(buffer)
            if core.orders_writes:
                self.write_uniform = core.prepare_uniform_write(buffer)
        self.destroyed = False
        self.label = label


class UniformRing:
    """Writes uniform blocks to transient memory.

    Attributes:
        memory: the ring or arena that the blocks lie in.
    """

    __slots__ = ("_alignment", "_core", "_owner", "_owner_generation", "_writes_when_bound", "memory")

    def __init__(self, core: Core, memory: Ring | Arena) -> None:
        self.memory: Final = memory
        self._core = core
        self._alignment = core.capabilities.uniform_alignment
        self._owner: TransientOwner | None = None
        self._owner_generation = 0
        self._writes_when_bound = core.orders_writes and isinstance(memory, Ring)

    def push(self, data: bytes, type: Any) -> UniformRange[Any]:
        """Write the bytes of a uniform block of this type; return its range, valid until the frame is
        presented."""
        core, memory = self._core, self.memory
        size = len(data)
        core.upload_bytes += size
        offset = memory.write(data, size, self._alignment)
        owner = self._owner
        if owner is None or memory.generation != self._owner_generation:
            owner = self._renew_owner()
        return UniformRange(memory.buffer, offset, size, type, owner)

    def bind(self, slot: int, data: bytes) -> None:
        """Write the bytes of a uniform block and bind them, as with the range that `push` returns."""
        memory = self.memory
        size = len(data)
        self._core.upload_bytes += size
        if self._writes_when_bound:
            offset = memory.allocate(size, self._alignment)  # type: ignore[union-attr]
        else:
            offset = memory.write(data, size, self._alignment)
        owner = self._owner
        if owner is None or memory.generation != self._owner_generation:
            owner = self._renew_owner()
        if self._writes_when_bound:
            owner.write_uniform(slot, offset, data)
        else:
            owner.bind_uniform(slot, offset, size)

    def _renew_owner(self) -> TransientOwner:
        """Return a new owner: the ring has moved to a larger buffer.

        Ranges of the old buffer stay valid for this frame. The new owner makes draws bind the new buffer.
        """
        memory = self.memory
        owner = self._owner = TransientOwner(self._core, "transient constants", memory.buffer)
        self._owner_generation = memory.generation
        return owner
