"""Programs and vertex arrays. Nothing is compiled: only their descriptors are kept."""

from __future__ import annotations

from rhi.contract.descriptors import Id, ProgramDescriptor, VertexArrayDescriptor

__rhi_internal__ = True


class Programs:
    """All programs and vertex arrays of a device, by id."""

    def __init__(self) -> None:
        self.programs: dict[Id, ProgramDescriptor] = {}
        self.vertex_arrays: dict[Id, VertexArrayDescriptor] = {}

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        self.programs[program] = descriptor

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        self.vertex_arrays[vertex_array] = descriptor

    def is_indexed(self, vertex_array: Id) -> bool:
        """Return whether draws of a vertex array use an index buffer."""
        return self.vertex_arrays[vertex_array].index_buffer != 0

    def destroy(self, resource: Id) -> None:
        self.programs.pop(resource, None)
        self.vertex_arrays.pop(resource, None)
