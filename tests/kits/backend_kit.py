"""A backend that numbers its resources, and bytes in all the forms that a buffer takes."""

from __future__ import annotations

import array
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Id, ProgramDescriptor, QueryKind

VALUES: Final = np.arange(8, dtype=np.float32)
SOURCES: Final[dict[str, Any]] = {
    "bytes": VALUES.tobytes(),
    "bytearray": bytearray(VALUES.tobytes()),
    "bytes as a view": VALUES.view(np.uint8).data,
    "floats": VALUES,
    "rows": VALUES.reshape(4, 2),
    "bytes in rows": VALUES.view(np.uint8).reshape(4, 8),
    "records": VALUES.view([("a", "f4"), ("b", "f4", 3)]),
    "an array of the standard library": array.array("f", VALUES),
    "read only": memoryview(VALUES).toreadonly(),
}
"""The bytes of `VALUES`."""


class BackendKit:
    """A backend that also assigns ids, with the steps that the tests of all backends share."""

    backend: Any

    def __init__(self, backend: Any) -> None:
        self.backend = backend
        self._last: Id = 0

    def new_id(self) -> Id:
        self._last += 1
        return self._last

    def buffer(self, data: ArrayLike | bytes, usage: BufferUsage = BufferUsage.STATIC) -> Id:
        content = data if isinstance(data, bytes) else np.asarray(data).tobytes()
        buffer = self.new_id()
        self.backend.create_buffer(buffer, BufferDescriptor(len(content), usage))
        self.backend.write_buffer(buffer, 0, content)
        return buffer

    def program(self, descriptor: ProgramDescriptor) -> Id:
        program = self.new_id()
        self.backend.create_program(program, descriptor)
        return program

    def query(self, kind: QueryKind) -> Id:
        query = self.new_id()
        self.backend.create_query(query, kind)
        return query
