"""The contract of a port: what one implementation package per platform provides, and nothing else.

- A backend holds no policy. It checks nothing (`rhi.device.device` has), caches no state
  (`rhi.device.core.state_cache` has), frees nothing by itself. It does what it is told, in order.
- Resources are named by the device's integers; a backend keeps its objects in tables indexed by them.
- Arguments are plain data (integers, enums, frozen descriptors, bytes), so that a call of any of these
  methods is a command that can be written down: `rhi.commands.recorder.Recorder` is a Backend that does that.
- Everything happens in the order of the calls. A backend whose device may reorder (memory written by one
  dispatch and read by the next) inserts what is needed to make it appear in order.
- Conventions (conformance pins each): clip space +Y up, depth 0…1; row 0 of every image is the top row, and
  so is texel row 0, window y = 0 and v = 0; matrices in buffers are row-major.
- What a platform lacks is said in `capabilities`; a method that needs a missing capability is never called.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.contract.descriptors import (
    BufferDescriptor,
    Id,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    QueryKind,
    Region,
    SamplerDescriptor,
    TextureDescriptor,
    VertexArrayDescriptor,
)
from rhi.contract.formats import Format
from rhi.contract.states import StateChange

__rhi_internal__ = True

FOREVER: Final = 3600.0
"""Seconds after which a wait without a limit gives the device up as lost."""


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What a device can do. A false flag means that the device front end refuses the call by name."""

    backend: str
    device: str
    driver: str

    max_texture_size: int = 16384
    max_texture_layers: int = 2048
    max_color_targets: int = 8
    max_samples: int = 4
    max_vertex_attributes: int = 16
    max_uniform_bytes: int = 16384
    max_storage_bytes: int = 1 << 27
    max_uniform_slots: int = 12
    max_storage_slots: int = 8
    max_texture_slots: int = 16
    max_image_slots: int = 8
    max_work_group: tuple[int, int, int] = (1024, 1024, 64)
    max_work_group_invocations: int = 1024
    max_dispatch: tuple[int, int, int] = (65535, 65535, 65535)
    max_shared_bytes: int = 32768
    max_anisotropy: float = 1.0
    uniform_alignment: int = 256
    storage_alignment: int = 256

    compute: bool = True
    draws: bool = True
    """Whether there are draws. Without them passes still clear and resolve; programs are compute programs."""
    shading: bool = True
    """Whether draws and dispatches run shaders. A recorder of commands says False: pixels stay as cleared."""
    indirect_count: bool = True
    """Indirect draws whose number comes from a buffer."""
    occlusion_queries: bool = True
    sample_counter: bool = False
    """A running samples-passed counter that can be taken at any point of the stream (COUNTER queries)."""
    conditional_rendering: bool = True
    timestamps: bool = True
    stencil: bool = True
    alpha_test: bool = False
    alpha_to_coverage: bool = True
    depth_bias_clamp: bool = True
    blend_per_target: bool = True
    unsupported_formats: frozenset[Format] = frozenset()
    """Formats of which no texture can be made."""
    unrenderable_formats: frozenset[Format] = frozenset()
    """Formats that can't be a color target."""
    passed_over: tuple[str, ...] = ()
    """Devices that were tried before this one, each with why it can't be used."""

    @property
    def renders(self) -> bool:
        """Whether draws make pictures."""
        return self.draws and self.shading


class PreparesDraws(Protocol):
    """What a backend may offer besides its contract: calls whose arguments are given in advance.

    A draw and the binding of its object's constants are what happens most; where they come down to one call of
    the platform's own, a Python frame for each is saved. A backend without these methods has nothing to do.
    """

    def prepare_uniform(self, buffer: Id) -> Callable[[int, int, int], object]:
        """A function of (slot, offset, size) that does what `Backend.bind_uniform` would. It is called only
        while a program is bound."""

    def prepare_draw(
        self, program: Id, vertex_array: Id, primitive: Primitive, first: int, count: int, base_vertex: int,
        base_instance: int,
    ) -> Callable[[int], object]:  # fmt: skip
        """A function of the number of instances that does what `Backend.draw` would. It is called only while
        `program` is bound and `AlphaTest` is off."""

    def on_interruption(self, call: Callable[[], None]) -> None:
        """Remember to call this when what is bound isn't any more, through nobody's fault: another context
        of the process became current."""


class PreparedQueries(Protocol):
    """Occlusion queries that are asked together and read together. Rows are places among them."""

    def draw(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[np.void], rows: NDArray[np.int64]
    ) -> None:
        """What `Backend.begin_query`, a `Backend.draw` for each of `draws` (`rhi.DRAW` or, without indices,
        `rhi.DRAW_UNINDEXED`) and `Backend.end_query` would, for each run of equal `rows`. No row comes twice; there
        is at least one draw. A COUNTER counts these draws, too."""

    def read(self, rows: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """The samples of those that the latest `draw` asked for, in its order and in an array of the caller's own, or
        None while they aren't all there; never waits."""


class PreparesQueries(Protocol):
    """What a backend may offer besides its contract: many queries in one call, where each has its price."""

    def prepare_queries(self, queries: Sequence[Id]) -> PreparedQueries:
        """For OCCLUSION queries that exist. It isn't used any more once they are destroyed."""


class Backend(Protocol):
    """One platform. All sizes and offsets are in bytes unless said otherwise.

    Creation may fail: a backend then raises `DeviceError` (rules `device-out-of-memory`, `device-driver`) or,
    for programs, `ShaderError` (rule `shader-driver`), and the id stays unused.
    """

    @property
    def capabilities(self) -> Capabilities:
        """What this device can do; the same object all its life."""

    def close(self) -> None:
        """Let go of everything; no call follows."""

    # -- resources ---------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        """Contents start as zeros."""

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        """Contents of all levels start as zeros."""

    def create_sampler(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        """How textures are read; the device asks once per distinct descriptor."""

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        """Compile what `descriptor.emit` gives in this backend's language."""

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        """Where the vertex stage of one program reads its inputs; its buffers exist and outlive it."""

    def create_query(self, query: Id, kind: QueryKind) -> None:
        """Has no answer until it was used."""

    def destroy(self, resource: Id) -> None:
        """Of any kind. The device calls it only once the GPU is done with the resource."""

    # -- memory ------------------------------------------------------------------------------------------

    def write_buffer(self, buffer: Id, offset: int, data: BytesLike) -> None:
        """Ordered after the commands before it; for `BufferUsage.STREAM` it may be unordered."""

    def read_buffer(self, buffer: Id, offset: int, size: int) -> bytes:
        """Waits for the commands before it."""

    def copy_buffer(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        """Source and target ranges don't overlap."""

    def clear_buffer(self, buffer: Id, offset: int, size: int, value: int) -> None:
        """Fill with a 32-bit pattern; offset and size are multiples of 4."""

    def write_texture(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        """Tightly packed rows, top row first, in the format's `dtype`; not for depth formats."""

    def read_texture(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        """(layers, height, width, channels) of the format's `dtype`; depth as float32, or with `stencil` the
        stencil part as uint8. Waits. Not for multi-sampled textures."""

    def copy_texture(
        self, source: Id, source_level: int, source_region: Region, target: Id, target_level: int, x: int, y: int,
        layer: int,
    ) -> None:  # fmt: skip
        """Equal formats; the regions don't overlap."""

    def resolve_texture(self, source: Id, target: Id) -> None:
        """Average the samples of a multi-sampled color texture into a single-sampled one of equal size."""

    def generate_mipmaps(self, texture: Id) -> None:
        """Fill levels 1… from level 0 with a 2×2 box filter (sRGB in linear light)."""

    # -- passes, state, binding --------------------------------------------------------------------------

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        """Clears ignore scissor and write masks. `Viewport.TARGET` and `Scissor.OFF` mean this size."""

    def end_pass(self) -> None:
        """Resolves what the descriptor asks to resolve."""

    def set_states(self, changes: Sequence[StateChange]) -> None:
        """What holds from here on. At creation `rhi.contract.states.DEFAULTS` hold."""

    def bind_program(self, program: Id) -> None:
        """Graphics or compute. What is bound to slots stays bound."""

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        """`offset` is a multiple of `capabilities.uniform_alignment`."""

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        """`offset` is a multiple of `capabilities.storage_alignment`. Read and write."""

    def bind_texture(self, slot: int, texture: Id, sampler: Id) -> None:
        """All levels and layers, read through the sampler."""

    def bind_image(self, slot: int, texture: Id, level: int, layer: int) -> None:
        """`layer` −1 binds all layers. Read and write."""

    # -- work --------------------------------------------------------------------------------------------

    def draw(
        self, vertex_array: Id, primitive: Primitive, first: int, count: int, instances: int, base_vertex: int,
        base_instance: int,
    ) -> None:  # fmt: skip
        """`first` and `count` in indices if the vertex array has them, else in vertices. QUADS draw each
        group of 4 vertices (or indices) as the triangles 0 1 2, 0 2 3. The largest index of the format restarts
        strips."""

    def draw_indirect(
        self, vertex_array: Id, primitive: Primitive, buffer: Id, offset: int, draws: int, stride: int,
        count_buffer: Id, count_offset: int,
    ) -> None:  # fmt: skip
        """Up to `draws` draws, their arguments read from `buffer` when executed: 5 words of 32 bits each,
        {count, instances, first, base vertex (signed), base instance} with indices or
        {count, instances, first, base instance, unused} without. With a `count_buffer` (0: none) the number is
        the smaller of `draws` and the uint32 at `count_offset`. Not for QUADS."""

    def dispatch(self, x: int, y: int, z: int) -> None:
        """Work-groups of the bound program."""

    def dispatch_indirect(self, buffer: Id, offset: int) -> None:
        """Three uint32 read when executed."""

    # -- time --------------------------------------------------------------------------------------------

    def signal(self, value: int) -> None:
        """Set the fence to `value` once everything before is done; starts that work if it lies in a queue."""

    def completed(self) -> int:
        """The fence's value; never waits."""

    def wait(self, value: int, seconds: float) -> bool:
        """Until the fence has reached `value`, at most so long; whether it has."""

    def begin_query(self, query: Id) -> None:
        """Start an OCCLUSION query. One at a time."""

    def end_query(self, query: Id) -> None:
        """Stop counting; the answer comes some time later."""

    def write_query(self, query: Id) -> None:
        """Take a COUNTER or TIMESTAMP at this point of the stream."""

    def read_query(self, query: Id) -> int | None:
        """The latest answer, or None while it isn't there; never waits. Samples, or nanoseconds."""

    def begin_conditional(self, query: Id, inverted: bool) -> None:
        """Draws until `end_conditional` are dropped if the query counted no sample (`inverted`: if it
        counted any); an unfinished query is waited for by the device, not by the CPU."""

    def end_conditional(self) -> None:
        """Draws happen again."""

    def push_label(self, text: str) -> None:
        """Name the commands up to the matching `pop_label`; for tools."""

    def pop_label(self) -> None:
        """The end of the innermost label."""

    def present(self, texture: Id) -> None:
        """The end of a frame; `texture` is its image, 0 for none."""
