"""What is bound, as draws have it: addresses in one flat list, two words for each slot.

- A row of a draw is picked out of `columns`; what stands before the slots there is the rasteriser's.
- Compute programs look at `slots` instead, which says the same in the contract's words.
- An address is looked up once per resource and part, and forgotten with the resource.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import pyopencl as cl

from rhi.backends.cl.buffers import Buffers
from rhi.backends.cl.planes import TexelPlane
from rhi.backends.cl.pools import Addresses
from rhi.backends.cl.raster.batches import FIXED_COLUMNS
from rhi.backends.cl.samplers import Samplers
from rhi.backends.cl.slots import Slots
from rhi.backends.cl.textures import Textures
from rhi.contract.descriptors import BindingKind, Id

__rhi_internal__ = True

_COUNTS: Final = {
    BindingKind.UNIFORM: 12,
    BindingKind.STORAGE: 8,
    BindingKind.TEXTURE: 16,
    BindingKind.IMAGE: 8,
}


def _columns() -> dict[tuple[BindingKind, int], int]:
    slots = [(kind, slot) for kind, count in _COUNTS.items() for slot in range(count)]
    return {slot: FIXED_COLUMNS + 2 * place for place, slot in enumerate(slots)}


COLUMNS: Final = _columns()
"""Where each slot's two words lie: an address, and the size in bytes or the address of the words about a texture."""


class Bindings:
    """Of one device.

    Attributes:
        columns: what draws' rows are picked from.
    """

    def __init__(
        self, slots: Slots, addresses: Addresses, buffers: Buffers, textures: Textures, samplers: Samplers
    ) -> None:
        self.columns = [0] * (FIXED_COLUMNS + 2 * len(COLUMNS))
        self._slots = slots
        self._addresses = addresses
        self._buffers = buffers
        self._textures = textures
        self._samplers = samplers
        self._found: dict[Id, dict[object, int]] = {}  # by resource and part

    def bind(self, kind: BindingKind, slot: int, what: tuple[int, ...]) -> None:
        """What the binding commands are given, behind the slot."""
        column = COLUMNS[kind, slot]
        if kind in (BindingKind.UNIFORM, BindingKind.STORAGE):
            buffer, offset, size = what
            self.columns[column : column + 2] = self.find_buffer(buffer) + offset, size
        else:
            self.columns[column : column + 2] = self._find_texture(kind, what)
        self._slots[kind, slot] = what

    def prepare_uniform(self, buffer: Id) -> Callable[[int, int, int], object]:
        """A faster `bind` of a buffer's parts."""
        columns, start, slots = self.columns, self.find_buffer(buffer), self._slots
        keys = [(BindingKind.UNIFORM, slot) for slot in range(_COUNTS[BindingKind.UNIFORM])]
        places = [COLUMNS[key] for key in keys]

        def bind(slot: int, offset: int, size: int) -> None:
            columns[places[slot]] = start + offset
            slots[keys[slot]] = buffer, offset, size

        return bind

    def find_buffer(self, buffer: Id) -> int:
        """A buffer's address."""
        return self._find(buffer, None, lambda: self._buffers[buffer].cl)

    def find_plane(self, texture: Id, plane: TexelPlane, stencil: bool) -> int:
        """The address of the memory that a plane of a texture lies in."""
        return self._find(texture, stencil, lambda: plane.memory)

    def forget(self, resource: Id) -> None:
        """A resource is destroyed."""
        self._found.pop(resource, None)

    def _find_texture(self, kind: BindingKind, what: tuple[int, ...]) -> tuple[int, int]:
        """The addresses of a texture's memory, and of the words about how it is bound."""
        texture = self._textures[what[0]]
        describe = self._samplers.describe if kind is BindingKind.TEXTURE else self._samplers.describe_image
        words = self._find(what[0], (kind, *what[1:]), lambda: describe(texture, *what[1:]))
        return self.find_plane(what[0], texture.levels[0], False), words

    def _find(self, resource: Id, part: object, get: Callable[[], cl.Buffer]) -> int:
        found = self._found.setdefault(resource, {})
        address = found.get(part)
        if address is None:
            address = found[part] = self._addresses.find(get())
        return address
