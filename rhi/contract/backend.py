"""The contract of a port: the methods that each platform implements, and the capabilities that it declares.

- A backend holds no policy. Calls were validated (`rhi.device.device`) and redundant state changes removed
  (`rhi.device.core.state_cache`) before they reach it, and it frees nothing on its own. It executes its
  commands in order.
- The device names resources by integers. A backend keeps its objects in tables indexed by them.
- Arguments are plain data: integers, enums, frozen descriptors, bytes. So each call is a command that can be
  recorded (`rhi.commands.recorder.Recorder` is a `Backend` that does so), saved, compared and replayed.
- Commands take effect in the order of the calls. If a platform may reorder them (one dispatch writes memory
  that the next one reads), its backend inserts the necessary barriers.
- Conventions, each with its conformance tests: clip space has +Y up and depth 0 to 1. Row 0 of every image is
  its top row; it is also texel row 0, window y = 0 and v = 0. Matrices in buffers are row-major.
- `capabilities` declares what the platform lacks. A method that needs a missing capability is never called.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.contract.blocks import CompressedFormat
from rhi.contract.descriptors import (
    BufferDescriptor,
    BufferId,
    Id,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    ProgramId,
    QueryId,
    QueryKind,
    Region,
    SamplerDescriptor,
    SamplerId,
    TextureDescriptor,
    TextureId,
    VertexArrayDescriptor,
    VertexArrayId,
)
from rhi.contract.formats import Format
from rhi.contract.states import PlatformState, StateChange
from rhi.errors.data_classes import dataclass

FOREVER: Final = 3600.0
"""Timeout in seconds of a wait that has no limit; a device that takes longer counts as lost."""


SAMPLE_COUNTS: Final = (1, 2, 4, 8)
"""Numbers of samples that textures of any device can have."""


@dataclass(frozen=True, slots=True)
class Capabilities:
    """The features and limits of a device. The front end refuses calls that need a feature whose flag is
    False."""

    backend: str
    device: str
    driver: str

    max_texture_size: int = 16384
    max_texture_layers: int = 2048
    max_volume_size: int = 2048
    """The largest width, height and depth of a 3D texture."""
    max_color_targets: int = 8
    max_target_bytes: int = 128
    """Largest sum of bytes per sample of a pass's color targets, as counted by
    `rhi.contract.limits.target_bytes`."""
    sample_counts: tuple[int, ...] = (1, 2, 4)
    """Numbers of samples that textures can have, in ascending order: 1 and some of 2, 4 and 8."""
    max_vertex_attributes: int = 16
    max_vertex_stride: int = 2048
    """The largest number of bytes from one vertex, or element of the data per instance, to the next."""
    max_varyings: int = 15
    """The largest number of vectors that a vertex stage gives to a fragment stage, besides the position. A
    matrix counts one for each of its columns."""
    max_uniform_bytes: int = 16384
    max_storage_bytes: int = 1 << 27
    max_uniform_slots: int = 12
    max_storage_slots: int = 8
    max_texture_slots: int = 16
    max_image_slots: int = 8
    max_work_group: tuple[int, int, int] = (1024, 1024, 64)
    max_work_group_invocations: int = 1024
    max_dispatch: tuple[int, int, int] = (65535, 65535, 65535)
    max_dispatch_groups: int = (1 << 32) - 1
    """Largest total number of work-groups of a dispatch. Drivers count in 32 bits; beyond that, some run only
    the remainder."""
    max_shared_bytes: int = 32768
    max_anisotropy: float = 1.0
    max_point_size: float = 1.0
    """The largest side of a point's square in texels, to which sizes are clamped. With 1.0, programs can't
    write point sizes or read point coordinates."""
    max_line_width: float = 1.0
    """The largest `LineWidth`. With 1.0, all lines are one texel wide."""
    uniform_alignment: int = 256
    storage_alignment: int = 256
    copy_alignment: int = 1
    """Offsets and sizes of `Backend.copy_buffer` are multiples of this number of bytes. Writes and reads
    aren't bound by it."""
    copy_offset_alignment: int = 4
    """Alignment in bytes of a buffer's offset in copies between textures and buffers, besides that to whole
    texels."""
    copy_row_alignment: int = 1
    """Alignment in bytes of the distance between rows in such copies, besides that to whole texels."""

    compute: bool = True
    draws: bool = True
    """Whether the device can draw. Without draws, passes still clear and resolve, and all programs are
    compute programs."""
    shading: bool = True
    """Whether draws and dispatches run shaders. False on a device that only records: pixels keep their clear
    value."""
    indirect_count: bool = True
    """Whether the number of indirect draws can be read from a buffer."""
    occlusion_queries: bool = True
    sample_counter: bool = False
    """Whether a running samples-passed counter can be read at any point of the stream (COUNTER queries)."""
    conditional_rendering: bool = True
    timestamps: bool = True
    stencil: bool = True
    stencil_per_face: bool = True
    """Whether front and back faces can have different stencil references and masks. Functions and operations
    always can."""
    alpha_test: bool = False
    alpha_to_coverage: bool = True
    depth_bias_clamp: bool = True
    precise_triangles: bool = True
    """Whether rasterisation is exact for extreme triangles: depth within 2e-5 of float64 and varyings within
    the corners' range for any sliver, and correct coverage however far a triangle reaches beyond the view."""
    precise_clipping: bool = True
    """Whether clipping is exact: points whose centre is out of view aren't drawn, and `PolygonMode.LINE`
    draws no edge where the near or far plane cuts a triangle."""
    blend_per_target: bool = True
    layered_rendering: bool = False
    """Whether a pass can have all layers of its targets, among which vertex stages choose: `TargetLayer`."""
    wireframe: bool = False
    """Whether triangles can be drawn as their edges: `PolygonMode.LINE`."""
    platform_states: frozenset[type[PlatformState]] = frozenset()
    """The types of states that only this platform has."""
    vertex_alignment: int = 1
    """Strides of vertices, and offsets of attributes in them, are multiples of this number of bytes."""
    draw_index: bool = True
    """Whether vertex stages can read the index of the draw: `draw_index()`."""
    early_depth: bool = True
    """Whether shaders can have `early_depth`."""
    aliased_writes: bool = True
    """Whether a draw or dispatch may use memory that it writes a second time: by another binding, as vertices
    or as indices. Two bindings that only write may have different parts of one buffer in any case."""
    resolve_feedback: bool = True
    """Whether a pass may sample the textures that it resolves to."""
    vertex_writes: bool = True
    """Whether vertex stages can write memory."""
    list_restart: bool = True
    """Whether the largest index restarts lists of points, lines and triangles, too, unless a shader wrote the
    indices. Strips, fans and quads always restart."""
    precise_lines: bool = True
    """Whether a line one texel wide covers the texels that OpenGL's diamond rule gives it, within the rule's
    tolerance."""
    border_colors: bool = True
    """Whether samplers can have `Wrap.BORDER`, with any border color."""
    texture_buffer_copies: bool = False
    """Whether textures are copied to and from buffers. Without it, `Texture.read_async` waits for the
    device."""
    shares_textures: bool = False
    """Whether the device stands beside a context of other code, which uses the same textures:
    `adopt_texture`."""
    compressed_formats: frozenset[CompressedFormat] = frozenset()
    """Block-compressed formats that textures can be stored in. The front end decodes the others."""
    compressed_size_step: int = 1
    """Widths and heights of textures stored in them are multiples of this number. The front end decodes
    others."""
    unsupported_formats: frozenset[Format] = frozenset()
    """Formats that textures can't have."""
    unrenderable_formats: frozenset[Format] = frozenset()
    """Formats that color targets can't have."""
    unfilterable_formats: frozenset[Format] = frozenset()
    """Formats that linear filters sample like nearest ones."""
    unblendable_formats: frozenset[Format] = frozenset()
    """Formats of color targets, besides integers, that draws can't blend with."""
    single_sampled_formats: frozenset[Format] = frozenset()
    """Formats that can't be multi-sampled."""
    unresolvable_formats: frozenset[Format] = frozenset()
    """Multi-sampled formats that can't be resolved."""
    unloadable_formats: frozenset[Format] = frozenset()
    """Formats whose images can't be loaded from by a program that also stores to them."""
    unstorable_formats: frozenset[Format] = frozenset()
    """Formats that images can't have."""
    disabled_features: tuple[str, ...] = ()
    """Features of the driver that are disabled because of a driver fault, each with the reason."""
    rejected_devices: tuple[str, ...] = ()
    """Devices that were tried before this one and can't be used, each with the reason."""

    @property
    def renders(self) -> bool:
        """True if draws produce pixels: the device can draw and runs shaders."""
        return self.draws and self.shading


class SupportsPreparedDraws(Protocol):
    """Optional part of the contract: draws and uniform bindings whose arguments are known in advance.

    They are the most frequent commands. If each comes down to one call of the platform's API, preparing it
    saves a Python frame per draw. A backend that doesn't gain by this leaves these methods out.
    """

    def prepare_uniform(self, buffer: Id) -> Callable[[int, int, int], object]:
        """Return a function of (slot, offset, size) that is equivalent to `Backend.bind_uniform` for this
        buffer. It is called only while a program is bound."""

    def prepare_draw(
        self,
        program: Id,
        vertex_array: Id,
        primitive: Primitive,
        first: int,
        count: int,
        base_vertex: int,
        base_instance: int,
    ) -> Callable[[int], object]:
        """Return a function of the number of instances that is equivalent to `Backend.draw`. It is called
        only while `program` is bound and `AlphaTest` is off."""

    def on_interruption(self, call: Callable[[], None]) -> None:
        """Register `call`, to be called whenever bindings are lost for a reason outside this device, such as
        another context of the process becoming current."""


class SupportsOrderedWrites(Protocol):
    """Optional part of the contract, for platforms on which a write to a STREAM buffer never reaches the commands
    that were signalled before it, and doesn't wait for them either. So each frame's memory begins at the same
    offset."""

    def prepare_uniform_write(self, buffer: Id) -> Callable[[int, int, bytes], object]:
        """Return a function of (slot, offset, data) that is equivalent to `Backend.write_buffer` of this STREAM
        buffer and `Backend.bind_uniform` of what was written. It is called only while a program is bound."""


class SupportsRecordedDraws(Protocol):
    """Optional part of the contract, for platforms that execute draws together which were recorded once."""

    def prepare_recorded_draws(
        self, commands: Sequence[tuple[str, tuple[Any, ...]]]
    ) -> Sequence[tuple[int, int, Callable[[], bool]]]:
        """Return the parts of recorded commands that can be executed together: start, end, and a function.

        The function either executes the commands from start to end and returns True, or it does nothing and
        returns False; then the caller executes them one by one. It is called in the place of the first of them,
        after all commands before it. When it is called again, these have left the same states and bindings.

        Args:
            commands: methods of `Backend` and their arguments. They are executed in this order several times,
                as long as what they use exists. Those with an empty name aren't known yet.
        """


class SupportsCurrentContext(Protocol):
    """Optional part of the contract, for platforms whose calls go to a context that is current on the calling
    thread, and that any other code of the process may replace (OpenGL). These calls aren't commands; no
    recorder keeps them.
    """

    def resume(self) -> bool:
        """Detect whether other code has made another context current (or none) since this backend was last
        used. If so, call `make_current` and return True. The device calls this wherever the cost doesn't
        matter, never for a draw.

        Raises:
            DeviceError: `device-context` if the platform refuses to make the context current.
        """

    def make_current(self) -> None:
        """Make the context current on the calling thread, and set all of its state anew, whatever other code
        did to it. Bindings may be lost, since the device binds everything again. Raises what `resume`
        raises."""

    def release_current(self) -> None:
        """Make the context current on no thread, so that another thread can call `make_current`. The context
        of other code that it shares textures with is current instead."""

    def hand_back(self) -> None:
        """End a frame: make the context of other code that it shares textures with current, and show the
        image of the latest `Backend.present` there. Do nothing if there is none."""


class SupportsTextureSharing(Protocol):
    """Optional part of the contract, for platforms on which other code may use the same textures."""

    def name_texture(self, texture: Id) -> int:
        """Return the platform's name of a texture."""

    def describe_texture(self, name: int) -> TextureDescriptor | str:
        """Describe a texture that other code has created, or return the reason why it can't be used."""

    def adopting_texture(self, name: int) -> AbstractContextManager[None]:
        """Return a `with` block in which `create_texture` adopts the texture of this name. Destroying its id
        leaves it alive."""


class SupportsIssueTimes(Protocol):
    """Optional part of the contract: when the CPU wrote timestamps, on the device's clock, so that the times
    of CPU and GPU can be compared. This call isn't a command; no recorder keeps it."""

    def read_issue_time(self, query: Id) -> int | None:
        """Return when the latest `Backend.write_query` of a TIMESTAMP query was called, in nanoseconds on the
        clock of its result. Return None until it has a result; never wait."""


class SupportsPreparedKernels(Protocol):
    """Optional part of the contract: code for draws and dispatches that is built before the first of them.

    Platforms that build it with the program, or can't without a draw, leave it out.
    """

    @property
    def is_building(self) -> bool:
        """True if code is being built in the background, without which draws and dispatches take longer."""

    def prepare_kernels(
        self,
        program: Id,
        vertex_array: Id,
        colors: Sequence[Format],
        depth: Format | None,
        samples: int,
        states: Sequence[StateChange],
    ) -> Sequence[Future[None]]:
        """Begin to build what draws of `program`, or its dispatches, need; return the ends of the builds,
        which never fail. A compute program has no more arguments: no vertex array, no targets.

        Args:
            vertex_array: a vertex array of the program; 0 for none.
            colors: the formats of the color targets; without any target, they aren't known yet.
            depth: the format of the depth target.
            samples: the number of samples of all targets.
            states: the value of every state type.
        """


class PreparedQueries(Protocol):
    """A group of occlusion queries that are drawn and read together."""

    def draw(
        self,
        vertex_array: Id,
        primitive: Primitive,
        draws: NDArray[np.void],
        query_indices: NDArray[np.int64],
    ) -> None:
        """Draw and count: for each run of equal `query_indices`, the equivalent of `Backend.begin_query`, one
        `Backend.draw` per element of `draws` (`rhi.DRAW` or, without indices, `rhi.DRAW_UNINDEXED`) and
        `Backend.end_query`. Each query occurs in one run only; there is at least one draw. COUNTER queries
        count these draws, too."""

    def draw_conditional(
        self,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        query_indices: NDArray[np.int64],
    ) -> None:
        """Draw on condition: for each run of equal `query_indices`, the equivalent of
        `Backend.begin_conditional` of its query, one `Backend.draw_indirect` of its draws and
        `Backend.end_conditional`. The draws lie one after the other at `offset` of `buffer`, one for each of
        `query_indices`, which the latest `draw` has used; there is at least one."""

    def read(self, query_indices: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """Return the samples that passed, for queries of the latest `draw` and in their order, as a new
        array. Return None while any result is missing; never wait."""


class SupportsClippedDraws(Protocol):
    """Optional part of the contract: many draws in rectangles of their own, for platforms that can save the
    cost of a change of states for each."""

    def draw_clipped(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[np.void], clips: NDArray[np.int64]
    ) -> None:
        """Draw each of `draws` (n,) in a rectangle of `clips` (n, 4): x, y, width, height. It is the
        equivalent of `Backend.set_states` of a `Scissor` and `Backend.draw` for each of them; the `Scissor`
        then is the one before. There is at least one draw. Not for QUADS."""


class SupportsPreparedQueries(Protocol):
    """Optional part of the contract: many queries in one call, for platforms on which each query has a fixed
    cost."""

    def prepare_queries(self, queries: Sequence[Id]) -> PreparedQueries:
        """Return the group of these OCCLUSION queries. They exist already; the group isn't used after one is
        destroyed."""


class SupportsFilledBuffers(Protocol):
    """Optional part of the contract: buffers that begin with their contents instead of zeros that a write
    replaces."""

    def create_filled_buffer(self, buffer: BufferId, descriptor: BufferDescriptor, data: BytesLike) -> None:
        """Create a STATIC buffer with these contents, which are as long as it is."""


class SupportsHostMemory(Protocol):
    """Optional part of the contract: buffers that lie in memory of the CPU, which it reads without a copy."""

    def host_memory(self, buffer: BufferId) -> NDArray[np.uint8] | None:
        """Wait for all earlier commands, then return the memory of a buffer, at least as long as it is; None if
        it lies elsewhere. The array keeps the memory alive. It is only read."""


class SupportsBufferNames(Protocol):
    """Optional part of the contract: buffers that other interfaces of the same driver share by a name."""

    def name_buffer(self, buffer: BufferId) -> int:
        """Make the platform's context current, and return its name of a buffer, whose memory stays where it is
        from now on. Return 0 if the CPU has that memory mapped."""


class Backend(Protocol):
    """The methods that a platform implements. Sizes and offsets are in bytes unless stated otherwise.

    A creation that fails raises `DeviceError` (rules `device-out-of-memory`, `device-driver`) or, for
    programs, `ShaderError` (rule `shader-driver`). The id then stays unused.
    """

    @property
    def capabilities(self) -> Capabilities:
        """The features and limits of this device. Always the same object."""

    def close(self) -> None:
        """Release everything. No other method is called afterwards."""

    # -- resources ---------------------------------------------------------------------------------------

    def create_buffer(self, buffer: BufferId, descriptor: BufferDescriptor) -> None:
        """Create a buffer filled with zeros."""

    def create_texture(self, texture: TextureId, descriptor: TextureDescriptor) -> None:
        """Create a texture; all levels, layers and samples are filled with zeros."""

    def create_sampler(self, sampler: SamplerId, descriptor: SamplerDescriptor) -> None:
        """Create a sampler. The device creates one per distinct descriptor."""

    def create_program(self, program: ProgramId, descriptor: ProgramDescriptor) -> None:
        """Compile a program from the source that `descriptor.emit` returns for this backend's language."""

    def create_vertex_array(self, vertex_array: VertexArrayId, descriptor: VertexArrayDescriptor) -> None:
        """Create a vertex array: where one program's vertex stage reads its inputs. Its buffers exist and
        outlive it."""

    def create_query(self, query: QueryId, kind: QueryKind) -> None:
        """Create a query. It has no result before its first use."""

    def destroy(self, resource: Id) -> None:
        """Destroy a resource of any kind. Called only when the GPU has finished using it."""

    # -- memory ------------------------------------------------------------------------------------------

    def write_buffer(self, buffer: BufferId, offset: int, data: BytesLike) -> None:
        """Write bytes, in order with other commands. Writes to a `BufferUsage.STREAM` buffer may be
        unordered."""

    def read_buffer(self, buffer: BufferId, offset: int, size: int) -> bytes:
        """Wait for all earlier commands, then return the bytes. A `BufferUsage.READBACK` buffer is read only
        when the fence has passed all commands that write it, so it needs no wait."""

    def copy_buffer(
        self, source: BufferId, source_offset: int, target: BufferId, target_offset: int, size: int
    ) -> None:
        """Copy bytes between buffers, or within one. The two ranges don't overlap."""

    def clear_buffer(self, buffer: BufferId, offset: int, size: int, value: int) -> None:
        """Fill a range with a 32-bit pattern. Offset and size are multiples of 4."""

    def write_texture(self, texture: TextureId, level: int, region: Region, data: BytesLike) -> None:
        """Write texels: tightly packed rows, top row first, of the format's `dtype`. Not for depth formats.
        To a compressed texture, write tightly packed blocks; the region begins at a block and ends with one,
        or at the edge of the level."""

    def read_texture(
        self, texture: TextureId, level: int, region: Region, stencil: bool
    ) -> NDArray[np.generic]:
        """Wait for all earlier commands, then return (layers, height, width, channels) of the format's
        `dtype`. Depth is float32; with `stencil`, the stencil part as uint8. Not for multi-sampled
        textures."""

    def copy_texture(
        self,
        source: TextureId,
        source_level: int,
        source_region: Region,
        target: TextureId,
        target_level: int,
        x: int,
        y: int,
        layer: int,
    ) -> None:
        """Copy texels between textures of equal format, or within one. The regions don't overlap."""

    def copy_texture_to_buffer(
        self, source: TextureId, level: int, region: Region, target: BufferId, offset: int, row_bytes: int
    ) -> None:
        """Copy texels to a buffer, as `read_texture` returns them, without stencil. Rows begin `row_bytes`
        apart, layers follow each other with `region.height` rows each. Bytes between the rows are left as
        they are. Not for multi-sampled textures."""

    def copy_buffer_to_texture(
        self, source: BufferId, offset: int, row_bytes: int, target: TextureId, level: int, region: Region
    ) -> None:
        """Copy texels from a buffer, laid out as by `copy_texture_to_buffer`. Not for depth formats and
        multi-sampled textures."""

    def resolve_texture(self, source: TextureId, target: TextureId) -> None:
        """Resolve a multi-sampled color texture: average its samples into a single-sampled one of equal
        size."""

    def generate_mipmaps(self, texture: TextureId) -> None:
        """Fill all levels from 1 on, each from the one above. A texel is the mean of all that it covers, in
        linear light: of 2 texels along an even axis, of 3 along an odd one."""

    # -- passes, state, binding --------------------------------------------------------------------------

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        """Begin a render pass and clear its targets. Clears ignore scissor and write masks. `Viewport.TARGET`
        and `Scissor.OFF` stand for the size of this pass. Clear values are numbers that the formats hold.
        Draws leave a color target without an output as it is, and outputs without a target are dropped."""

    def end_pass(self) -> None:
        """End the render pass and resolve the attachments that have a resolve target."""

    def set_states(self, changes: Sequence[StateChange]) -> None:
        """Change render states from here on. A new device has `rhi.contract.states.DEFAULTS`."""

    def bind_program(self, program: ProgramId) -> None:
        """Bind a graphics or compute program. Slots keep their bindings."""

    def bind_uniform(self, slot: int, buffer: BufferId, offset: int, size: int) -> None:
        """Bind a range of a buffer as constants. `offset` is a multiple of
        `capabilities.uniform_alignment`."""

    def bind_storage(self, slot: int, buffer: BufferId, offset: int, size: int) -> None:
        """Bind a range of a buffer for reads and writes. `offset` is a multiple of
        `capabilities.storage_alignment`."""

    def bind_texture(self, slot: int, texture: TextureId, sampler: SamplerId) -> None:
        """Bind all levels and layers of a texture, to be read through the sampler."""

    def bind_image(self, slot: int, texture: TextureId, level: int, layer: int) -> None:
        """Bind one level of a texture for reads and writes. `layer` −1 binds all layers."""

    # -- work --------------------------------------------------------------------------------------------

    def draw(
        self,
        vertex_array: VertexArrayId,
        primitive: Primitive,
        first: int,
        count: int,
        instances: int,
        base_vertex: int,
        base_instance: int,
    ) -> None:
        """Draw. `first` and `count` are in indices if the vertex array has an index buffer, else in vertices.
        QUADS draw each group of 4 vertices (or indices) as the triangles 0 1 2 and 0 2 3. Incomplete
        primitives are dropped. The largest value of the index format restarts strips, fans and quads; with
        `capabilities.list_restart` lists, too."""

    def draw_indirect(
        self,
        vertex_array: VertexArrayId,
        primitive: Primitive,
        buffer: BufferId,
        offset: int,
        draws: int,
        stride: int,
        count_buffer: BufferId,
        count_offset: int,
    ) -> None:
        """Draw up to `draws` times with arguments that are read from `buffer` during execution. Each draw is
        a record of 5 32-bit words: `DRAW` with an index buffer, `DRAW_UNINDEXED` without. With a
        `count_buffer` (0: none) the number of draws is the smaller of `draws` and the uint32 at
        `count_offset`. Not for QUADS."""

    def dispatch(self, x: int, y: int, z: int) -> None:
        """Run this many work-groups of the bound compute program."""

    def dispatch_indirect(self, buffer: BufferId, offset: int) -> None:
        """Dispatch with three uint32 counts that are read from `buffer` during execution."""

    # -- time --------------------------------------------------------------------------------------------

    def signal(self, value: int) -> None:
        """Set the fence to `value` when all earlier commands have finished, and submit commands that are
        still queued."""

    def completed(self) -> int:
        """Return the current value of the fence; never wait."""

    def wait(self, value: int, seconds: float) -> bool:
        """Wait until the fence has reached `value`, for at most `seconds`. Return whether it has."""

    def begin_query(self, query: QueryId) -> None:
        """Begin counting samples for an OCCLUSION query. One query is open at a time."""

    def end_query(self, query: QueryId) -> None:
        """End counting. The result becomes available some time later."""

    def write_query(self, query: QueryId) -> None:
        """Write the running counter (COUNTER) or the time (TIMESTAMP) at this point of the stream."""

    def read_query(self, query: QueryId) -> int | None:
        """Return the latest result in samples or nanoseconds, or None while it isn't available; never
        wait."""

    def begin_conditional(self, query: QueryId, inverted: bool) -> None:
        """Skip draws until `end_conditional` if the query counted no sample (`inverted`: if it counted any).
        The device, not the CPU, waits for a query that isn't finished."""

    def end_conditional(self) -> None:
        """End conditional rendering."""

    def push_label(self, text: str) -> None:
        """Label the commands up to the matching `pop_label`, for debugging tools."""

    def pop_label(self) -> None:
        """End the innermost label."""

    def present(self, texture: TextureId) -> None:
        """End the frame. `texture` is its image, 0 for none."""
