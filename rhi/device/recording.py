"""The core and the programs of a command buffer, which take the place of the device's during recording.

- A `RecordingCore` has its own states, bindings and open pass, and uses the device's resources. It notes
  which of them are used, and on which line.
- A `RecordedProgram` is a program of the device with draw functions of its own (`draw_code`).
- Nothing here calls the device's backend, so recording may run on any thread: the one that enters its block.
"""

from __future__ import annotations

from collections.abc import Callable
from types import CodeType

import numpy as np
from numpy.typing import NDArray

from rhi.commands.recorder import CommandWriter
from rhi.contract.descriptors import Id, VertexArrayDescriptor
from rhi.device.core.core import Core, Owner, describe_object
from rhi.device.core.uniform_ring import TransientOwner, UniformRing
from rhi.device.queries.occlusion import OcclusionQuery
from rhi.device.resources.draw_code import compile_draw_code
from rhi.device.resources.meshes import Drawable, Mesh, MeshData
from rhi.device.resources.programs import Program
from rhi.errors.call_sites import find_user_frame
from rhi.errors.named_tuples import NamedTuple
from rhi.errors.rules import DEVICE_CLOSED, RECORD_STATE, RECORD_TRANSIENT


class ResourceUse(NamedTuple):
    """A resource that a command buffer uses, with its name and the line of its first use."""

    owner: Owner
    name: str
    code: CodeType | None
    offset: int


class RecordingCore(Core):
    """The core of a command buffer, used in place of the device's core.

    Attributes:
        device: the core of the device.
        recording: whether commands can be recorded now.
        uses: the resources in use, by id.
        stream: the recorded commands.
        vertex_arrays: vertex arrays that meshes lack for a program, to be created before the first
            submission.
        meshes: the meshes that the buffer draws; their vertex arrays live as long as they do.
        own_arrays: vertex arrays whose vertices lie in the arena.
        conditions: queries that must have ended before the buffer is submitted.
        queries: for each query and query set that the buffer uses, by id, the function that receives the
            fence of a submission.
        counted_queries: for each query set that the buffer uses, by id, the queries that it counts in.
    """

    __slots__ = (
        "conditions",
        "counted_queries",
        "device",
        "meshes",
        "own_arrays",
        "queries",
        "recording",
        "stream",
        "uses",
        "vertex_arrays",
    )
    records = True

    def __init__(self, device: Core, writer: CommandWriter) -> None:
        super().__init__(writer, device.states.fresh(), device.refusals)
        self.device = device
        self.timeline = device.timeline
        self.locked, self.lock_blocks = device.locked, device.lock_blocks
        self.sampler_descriptors = device.sampler_descriptors
        self.recording = False
        self.stream = writer.stream
        self.uses: dict[Id, ResourceUse] = {}
        self.vertex_arrays: dict[tuple[Program[...], MeshData], tuple[Id, VertexArrayDescriptor]] = {}
        self.meshes: set[MeshData] = set()
        self.own_arrays = writer.vertex_arrays
        self.conditions: list[OcclusionQuery] = []
        self.queries: dict[Id, Callable[[int], None]] = {}
        self.counted_queries: dict[Id, NDArray[np.int64]] = {}

    def new_id(self) -> Id:
        return self.device.new_id()

    def check_open(self) -> None:
        if self.device.closed:
            self.refuse(DEVICE_CLOSED, "device", "a closed device")
        if not self.recording:
            self.refuse(
                RECORD_STATE, "commands", "a command buffer outside its `with` block", "commands inside it"
            )

    check_command = check_open

    def check_ready(self) -> None:
        """Refuse calls outside recording, and calls on another thread than the recording one."""
        self.check_open()
        self.check_thread("commands")

    def check_usable(self, owner: Owner, call: str) -> None:
        """Refuse a resource that is destroyed, locked, or of another device; otherwise note its use."""
        if isinstance(owner, TransientOwner):
            if owner.core is not self:
                self.refuse(RECORD_TRANSIENT, call, describe_object(owner))
            return
        used = owner.origin if isinstance(owner, RecordedProgram) else owner
        self.device.check_usable(used, call)
        self.note_use(used.id, used)  # type: ignore[attr-defined]

    def note_use(self, resource: Id, owner: Owner, name: str = "") -> None:
        """Note the use of a resource, with the user's line; `name` is its text in messages."""
        if resource not in self.uses:
            frame = find_user_frame()
            site = (None, -1) if frame is None else (frame.f_code, frame.f_lasti)
            self.uses[resource] = ResourceUse(owner, name or describe_object(owner), *site)
            descriptor = getattr(owner, "descriptor", None)
            if descriptor is not None and not name:
                self.stream.assume(resource, descriptor)


class RecordedProgram(Program[...]):
    """A program of the device as one command buffer uses it: its draws and bindings are recorded.

    Attributes:
        origin: the device's program.
        prepared_draws: by mesh, the prepared draw as a function of the number of instances.
    """

    __slots__ = ("origin", "prepared_draws")

    def __init__(self, core: RecordingCore, uniforms: UniformRing, origin: Program[...]) -> None:
        self.core = core
        self.uniforms = uniforms
        self.origin = origin
        self.id = origin.id
        self.descriptor = origin.descriptor
        self.name = origin.name
        self.destroyed = False
        self._left_out = origin._left_out
        self.prepared_draws: dict[Drawable, Callable[[int], object]] = {}
        if origin.recorded_code is None:
            origin.recorded_code = compile_draw_code(
                origin.name,
                origin.descriptor.bindings,
                recorded=True,
                takes_more=bool(origin._left_out),
                checks_aliases=origin.must_check_aliases,
            )
        self._install_code(origin.recorded_code)

    def _cache_draw(self, mesh: Drawable, draw: Callable[[int], object]) -> None:
        self.prepared_draws[mesh] = draw

    def get_vertex_array(self, mesh: Drawable) -> Id:
        core = self.core
        assert isinstance(core, RecordingCore)
        vertex_array = mesh.vertex_arrays.get(self.origin) or mesh.vertex_arrays.get(self)
        if not isinstance(mesh, Mesh):
            return vertex_array or mesh.create_vertex_array(
                self.origin, self.id, self.name, self.descriptor.attributes
            )
        data = mesh.data
        if vertex_array is None:
            key = (self.origin, data)
            if key not in core.vertex_arrays:
                descriptor = data.describe_vertex_array(self.id, self.name, self.descriptor.attributes)
                core.vertex_arrays[key] = core.new_id(), descriptor
            vertex_array = core.vertex_arrays[key][0]
        # The vertex array is destroyed with the mesh, even if the mesh's buffers stay.
        core.meshes.add(data)
        core.note_use(vertex_array, data.buffers[0] if data.buffers else self.origin, f"Mesh({data.label!r})")
        return vertex_array
