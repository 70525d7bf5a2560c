"""Programs, vertex arrays and samplers: nothing is compiled, so their descriptions are all there is of them."""

from __future__ import annotations

from rhi.contract.descriptors import Id, ProgramDescriptor, VertexArrayDescriptor

__rhi_internal__ = True


class Programs:
    """All programs, vertex arrays and samplers of a device, by id."""

    def __init__(self) -> None:
        self.programs: dict[Id, ProgramDescriptor] = {}
        self.vertex_arrays: dict[Id, VertexArrayDescriptor] = {}

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        self.programs[program] = descriptor

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        self.vertex_arrays[vertex_array] = descriptor

    def is_indexed(self, vertex_array: Id) -> bool:
        """Whether draws take their vertices through an index buffer."""
        return self.vertex_arrays[vertex_array].index_buffer != 0

    def destroy(self, resource: Id) -> None:
        self.programs.pop(resource, None)
        self.vertex_arrays.pop(resource, None)
