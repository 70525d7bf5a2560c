"""The bound resources as draws take them: addresses in one flat list, two words for each slot.

- A draw's row is picked out of `columns`. The columns before those of the slots are set by `draws` and
  `queries`.
- Compute programs read `slots` instead, which holds the same bindings in the contract's terms.
"""

from __future__ import annotations

from collections.abc import Callable

from rhi.backends.cl.cl_programs import Slots
from rhi.backends.cl.memory.cl_buffers import Buffers
from rhi.backends.cl.memory.cl_samplers import Samplers
from rhi.backends.cl.memory.cl_textures import Textures
from rhi.backends.cl.raster.draw_columns import COLUMN_COUNT, SLOT_COLUMNS, SLOT_COUNTS
from rhi.contract.descriptors import BindingKind, Id


class Bindings:
    """The bindings of one device.

    Attributes:
        columns: the list that draws' rows are picked from.
        slots: the bound resources, for compute programs.
    """

    def __init__(self, buffers: Buffers, textures: Textures, samplers: Samplers) -> None:
        self.columns = [0] * COLUMN_COUNT
        self.slots: Slots = {}
        self._buffers = buffers
        self._textures = textures
        self._samplers = samplers

    def bind(self, kind: BindingKind, slot: int, arguments: tuple[int, ...]) -> None:
        """Bind a resource; `arguments`: the arguments of the binding command that follow the slot."""
        column = SLOT_COLUMNS[kind, slot]
        if kind in (BindingKind.UNIFORM, BindingKind.STORAGE):
            buffer, offset, size = arguments
            self.columns[column : column + 2] = self.buffer_address(buffer) + offset, size
        else:
            self.columns[column : column + 2] = self._texture_addresses(kind, arguments)
        self.slots[kind, slot] = arguments

    def prepare_uniform(self, buffer: Id) -> Callable[[int, int, int], object]:
        """Return a function of slot, offset and size that binds a range of this buffer, faster than
        `bind`."""
        columns = self.columns
        start = self.buffer_address(buffer)
        slots = self.slots
        keys = [(BindingKind.UNIFORM, slot) for slot in range(SLOT_COUNTS[BindingKind.UNIFORM])]
        slot_columns = [SLOT_COLUMNS[key] for key in keys]

        def bind(slot: int, offset: int, size: int) -> None:
            columns[slot_columns[slot]] = start + offset
            slots[keys[slot]] = buffer, offset, size

        return bind

    def buffer_address(self, buffer: Id) -> int:
        """Return a buffer's address."""
        return self._buffers[buffer].address

    def _texture_addresses(self, kind: BindingKind, what: tuple[int, ...]) -> tuple[int, int]:
        """Return the addresses of a texture's memory, and of its description for this kind of binding."""
        texture = self._textures[what[0]]
        describe = self._samplers.describe if kind is BindingKind.TEXTURE else self._samplers.describe_image
        return texture.levels[0].address, describe(texture, *what[1:]).address
