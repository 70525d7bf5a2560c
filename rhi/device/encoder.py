"""The commands that devices and command buffers share: passes, states, draws, dispatches, labels, conditions.

A `Device` executes them, a `CommandBuffer` records them for later. Both are encoders, so rendering code
accepts either. All checks are made here, before a call reaches a backend.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import ParamSpec

from rhi.contract import limits
from rhi.contract.descriptors import DRAW, Id, Primitive
from rhi.contract.states import State
from rhi.device.core.core import Core
from rhi.device.core.state_cache import StateScope, ValidatedScope
from rhi.device.immediate import Immediate
from rhi.device.passes import Clear, RenderPass, RenderTarget
from rhi.device.queries.occlusion import Conditional, OcclusionQuery
from rhi.device.queries.sets import QuerySet, run_starts
from rhi.device.queries.timers import EventScope, Timers
from rhi.device.resources.buffers import Buffer, StorageBuffer, check_buffer
from rhi.device.resources.meshes import Drawable, Mesh, check_clips, check_draws
from rhi.device.resources.programs import Program
from rhi.device.resources.textures import Texture
from rhi.device.transient import TransientMemory
from rhi.errors import rules
from rhi.errors.arguments import ArgumentChecker, FieldChecker, to_integer
from rhi.errors.data_classes import dataclass
from rhi.errors.device_objects import DeviceObject

P = ParamSpec("P")
_ONES: Final = (1, 1, 1)


@dataclass(frozen=True, slots=True)
class IndirectDraws:
    """Draws whose arguments the GPU reads from a buffer when it executes them.

    Each record is 20 bytes in the order of `rhi.DRAW` (or `DRAW_UNINDEXED`); the first lies at `offset`, the
    next ones `stride` bytes apart. With `count`, the number of draws is the uint32 at `count_offset` of that
    buffer, at most `draws`.
    """

    buffer: Buffer | StorageBuffer[Any]
    draws: int
    offset: int = 0
    stride: int = DRAW.itemsize
    count: Buffer | StorageBuffer[Any] | None = None
    count_offset: int = 0

    def __post_init__(self) -> None:
        fields = FieldChecker(self)
        check_buffer(fields, "buffer", self.buffer)
        if self.count is not None:
            check_buffer(fields, "count", self.count)
        fields.integers("draws", "offset", "stride", "count_offset")


class Encoder(DeviceObject):
    """Common base of `Device` and `CommandBuffer`: the commands that both accept."""

    NAME = "device"
    """The encoder's name in error messages."""

    def __init__(self, core: Core, timers: Timers, transient: TransientMemory) -> None:
        self._core = core
        self._states = core.states
        self._scope_type = ValidatedScope if core.validates else StateScope
        self._timers = timers
        self._transient = transient

    # -- passes and states -------------------------------------------------------------------------------

    def render_pass(
        self,
        color: RenderTarget | Sequence[RenderTarget] | None = None,
        depth: RenderTarget | None = None,
        *,
        clear: Clear = None,
        clear_depth: float | None = None,
        clear_stencil: int | None = None,
        resolve: Texture | Sequence[Texture | None] | None = None,
        label: str = "",
    ) -> RenderPass:
        """Create a render pass: `with device.render_pass(color, depth, clear=(0, 0, 0, 1), clear_depth=0):`

        Args:
            color: textures, or `texture.at(level, layer)`, all of the same size and number of samples.
            depth: a depth texture, likewise.
            clear: (red, green, blue, alpha) for all color targets, or one per target (None keeps the
                contents).
            clear_depth: 0 is far and 1 near under reversed depth; None keeps the contents.
            resolve: single-sampled textures that receive the averaged samples at the end.

        Examples:
            >>> depth = device.texture((64, 48), rhi.Format.D32F)
            >>> with device.render_pass(image, depth, clear=(0, 0, 0, 1), clear_depth=0.0):
            ...     device.draw(program, mesh, tint=(1, 0, 0, 1))
        """
        return RenderPass(self._core, color, depth, clear, clear_depth, clear_stencil, resolve, label)

    def states(self, *states: State) -> StateScope:
        """Create a scope of states: `with device.states(CullMode.NONE, DepthWrite.OFF):`; restored at its
        end.

        Examples:
            >>> with device.render_pass(image):
            ...     with device.states(rhi.CullMode.NONE, rhi.BlendFunction.ALPHA):
            ...         device.draw(program, mesh, tint=(1, 0, 0, 0.5))
            ...     device.draw(program, mesh, tint=(1, 0, 0, 1))  # with the earlier states
        """
        scope = self._scope_type()  # as `StateCache.scope`, without its call
        scope.cache = self._states
        scope.states = states
        scope.before = None
        return scope

    def event(self, label: str) -> EventScope:
        """Create an event: `with device.event("shadows"):` labels and, with timing on, times the commands
        inside.

        Examples:
            >>> with device.event("shadows"), device.render_pass(image):
            ...     device.draw(program, mesh, tint=(0, 0, 0, 1))
            >>> device.stream.draws()[-1].labels
            ('shadows',)
        """
        return EventScope(self._core, self._timers, label)

    def conditional(self, query: OcclusionQuery, *, inverted: bool = False) -> Conditional:
        """Create a condition: in `with device.conditional(query):` the GPU skips draws if the query counted
        nothing.

        Only one condition can be open at a time. `inverted` skips draws if the query counted something.

        Examples:
            >>> query = device.occlusion_query()
            >>> with device.render_pass(image), query:
            ...     device.draw(program, mesh, tint=(1, 1, 1, 1))
            >>> with device.render_pass(image), device.conditional(query):
            ...     device.draw(program, mesh, tint=(1, 0, 0, 1))
        """
        return Conditional(self._core, query, inverted)

    # -- work --------------------------------------------------------------------------------------------

    def draw(
        self, program: Program[P], mesh: Drawable, instances: int = 1, /, *args: P.args, **bindings: P.kwargs
    ) -> None:
        """Draw `mesh` with `program`, with a value for each of the program's bindings by name.

        Raises:
            ValidationError: `draw-outside-pass`, `binding-*`, `mesh-attribute`, `resource-destroyed`,
                `lock-open`, `pass-feedback`; nothing is drawn or bound then.

        Examples:
            >>> with device.render_pass(image):
            ...     device.draw(program, mesh, tint=(1, 0, 0, 1))
            ...     device.draw(program, mesh, 3, tint=(0, 1, 0, 1))  # three instances
        """
        raise NotImplementedError

    def draw_many(
        self, program: Program[P], mesh: Drawable, draws: NDArray[Any], /, *args: P.args, **bindings: P.kwargs
    ) -> None:
        """Draw parts of `mesh`, given as an array of `rhi.DRAW` (see `mesh.draws`), in one call.

        The array is copied into transient memory. Shaders tell the draws apart by `instance_index()` (which
        counts from `base_instance`) or `draw_index()`.

        Examples:
            >>> draws = mesh.draws([0, 0], 3, instances=[5, 7])
            >>> with device.render_pass(image):
            ...     device.draw_many(program, mesh, draws, tint=(1, 0, 0, 1))
        """
        call = f"{self.NAME}.draw_many"
        resolved, array = self._check_draws(program, mesh, draws, call)
        self._refuse_quads(mesh, call)
        vertex_array = self._bind_draws(resolved, mesh, bindings)
        if not len(array):
            return
        buffer, offset = self._upload_draws(array)
        self._core.backend.draw_indirect(
            vertex_array, mesh.primitive, buffer, offset, len(array), array.dtype.itemsize, 0, 0
        )
        self._core.draws += 1

    def draw_clipped(
        self,
        program: Program[P],
        mesh: Drawable,
        draws: NDArray[Any],
        clips: ArrayLike,
        /,
        *args: P.args,
        **bindings: P.kwargs,
    ) -> None:
        """Draw parts of `mesh`, each clipped to a rectangle, in one call: the draw lists of a user interface.

        Each rectangle takes the place of the `Scissor` that is set around the call.

        Args:
            draws: (n,) as for `draw_many`, of any primitive. Shaders tell them apart by `instance_index()`;
                their `draw_index()` is 0.
            clips: (n, 4) integers: x, y, width and height in texels, from the target's top left corner. Draws
                in an empty rectangle are left out.

        Raises:
            ValidationError: the errors of `draw` and `draw_many`; nothing is drawn or bound then.

        Examples:
            >>> rectangles = [(0, 0, 32, 48), (32, 0, 32, 48)]
            >>> with device.render_pass(image):
            ...     device.draw_clipped(program, mesh, mesh.draws([0, 0], 3), rectangles, tint=(1, 0, 0, 1))
        """
        call = f"{self.NAME}.draw_clipped"
        resolved, array = self._check_draws(program, mesh, draws, call)
        rectangles = check_clips(self._core, clips, len(array), call)
        vertex_array = self._bind_draws(resolved, mesh, bindings)
        visible = (rectangles[:, 2:] > 0).all(1) & (array["count"] > 0) & (array["instances"] > 0)
        array, rectangles = array[visible], rectangles[visible]
        if len(array):
            self._core.draw_clipped(vertex_array, mesh.primitive, array, rectangles)
            self._core.draws += len(array)

    def draw_counted(
        self,
        program: Program[P],
        mesh: Drawable,
        draws: NDArray[Any],
        queries: QuerySet,
        query_indices: NDArray[Any] | Sequence[int] | None = None,
        /,
        *args: P.args,
        **bindings: P.kwargs,
    ) -> None:
        """Draw parts of `mesh`, each in an occlusion query, in one call.

        Args:
            draws: (n,) as for `draw_many`, of any primitive. Shaders tell them apart by `instance_index()`;
                their `draw_index()` is 0.
            queries: the query set that counts the draws; all of its earlier results are discarded.
            query_indices: (n,) integers, the query of the set that counts each draw; by default query i
                counts draw i. A query may count several consecutive draws.

        Raises:
            ValidationError: `query-indices`, `query-nested` inside another query, and the errors of `draw`
                and `draw_many`; nothing is drawn, bound or discarded then.
        """
        call = f"{self.NAME}.draw_counted"
        resolved, array = self._check_draws(program, mesh, draws, call)
        check = ArgumentChecker(call, self._core.refuse)
        check.instance("queries", queries, QuerySet, "a QuerySet from device.query_set(…)")
        self._check_query_set(queries, call)
        set_indices = queries.check_query_indices(query_indices, len(array), call)
        vertex_array = self._bind_draws(resolved, mesh, bindings)
        core = self._core
        counted = queries.draw(core, vertex_array, mesh.primitive, array, set_indices)
        core.draws += len(array)
        self._mark_queries_drawn(queries, counted)

    def draw_conditional(
        self,
        program: Program[P],
        mesh: Drawable,
        draws: NDArray[Any],
        queries: QuerySet,
        query_indices: NDArray[Any] | Sequence[int] | None = None,
        /,
        *args: P.args,
        **bindings: P.kwargs,
    ) -> None:
        """Draw parts of `mesh`, each on condition that a query of a set counted a sample, in one call.

        The GPU decides, without a round trip to the CPU, as in `conditional`.

        Args:
            draws: (n,) as for `draw_many`. Shaders tell them apart by `instance_index()`; their
                `draw_index()` counts from 0 within consecutive draws of one query.
            queries: a query set that `draw_counted` has used.
            query_indices: (n,) integers, the query that decides about each draw; by default query i decides
                about draw i. On most devices each run of draws with the same query is one conditional draw.

        Raises:
            ValidationError: `query-indices`, also for a query that the latest `draw_counted` didn't use;
                `query-state` if there was none; `device-capability` for an emulated set; `condition-nested`
                inside another condition; and the errors of `draw_many`; nothing is drawn or bound then.

        Examples:
            >>> queries = device.query_set(2)
            >>> draws = mesh.draws([0, 0], 3)
            >>> with device.render_pass(image):
            ...     device.draw_counted(program, mesh, draws, queries, tint=(1, 1, 1, 1))
            ...     device.draw_conditional(program, mesh, draws, queries, tint=(1, 0, 0, 1))
        """
        call = f"{self.NAME}.draw_conditional"
        resolved, array = self._check_draws(program, mesh, draws, call)
        core = self._core
        check = ArgumentChecker(call, core.refuse)
        check.instance("queries", queries, QuerySet, "a QuerySet from device.query_set(…)")
        core.check_usable(queries, call)
        core.require(call, limits.condition_faults(core.capabilities))
        if queries.emulated:
            core.refuse(
                rules.DEVICE_CAPABILITY, call, "an emulated query set", "a native one: device.query_set(…)"
            )
        if core.condition_open:
            core.refuse(rules.CONDITION_NESTED, call, "a condition inside another")
        self._refuse_quads(mesh, call)
        set_indices = queries.check_conditions(
            query_indices, len(array), self._get_counted_queries(queries, call), call
        )
        vertex_array = self._bind_draws(resolved, mesh, bindings)
        if not len(array):
            return
        queries.draw_conditional(core, vertex_array, mesh.primitive, *self._upload_draws(array), set_indices)
        runs = len(run_starts(set_indices))
        core.condition_count += runs
        core.draws += runs

    def _check_draws(
        self, program: Program[...], mesh: Drawable, draws: NDArray[Any], call: str
    ) -> tuple[Program[...], NDArray[Any]]:
        """Return the program as this encoder uses it, and the array of draws as backends need it."""
        resolved = self._resolve_program(program, call)
        check_mesh(self._core, mesh, call, Drawable)
        return resolved, check_draws(self._core, mesh, draws, resolved.descriptor.attributes, call)

    def _refuse_quads(self, mesh: Drawable, call: str) -> None:
        """Refuse quads: their indices can't be expanded for draws whose arguments the GPU reads."""
        if mesh.primitive is Primitive.QUADS:
            self._core.refuse(rules.DEVICE_CAPABILITY, call, "Primitive.QUADS", "any other primitive")

    def _upload_draws(self, draws: NDArray[Any]) -> tuple[Id, int]:
        """Copy an array of draws to transient memory, and return its buffer and offset."""
        self._core.upload_bytes += draws.nbytes
        arguments = self._transient.arguments
        offset = arguments.write(draws.view(np.uint8).data, draws.nbytes, 4)
        return arguments.buffer, offset

    def _get_counted_queries(self, queries: QuerySet, call: str) -> NDArray[np.int64]:
        """Return the queries whose results a condition can use; `query-state` if the set wasn't used."""
        queries.check_ended(self._core, call)
        return queries.counted

    def _check_query_set(self, queries: QuerySet, call: str) -> None:
        self._core.check_usable(queries, call)
        if self._core.open_query is not None:
            self._core.refuse(rules.QUERY_NESTED, call, "draws that are counted inside an open query")

    def _mark_queries_drawn(self, queries: QuerySet, query_indices: NDArray[np.int64]) -> None:
        queries.mark_drawn(query_indices)

    def draw_indirect(
        self,
        program: Program[P],
        mesh: Mesh,
        arguments: IndirectDraws,
        /,
        *args: P.args,
        **bindings: P.kwargs,
    ) -> None:
        """Draw with arguments that the GPU reads from a buffer when it executes the command.

        Examples:
            >>> arguments = device.buffer(mesh.draws([0], 3, instances=[2]))
            >>> with device.render_pass(image):
            ...     device.draw_indirect(program, mesh, rhi.IndirectDraws(arguments, 1), tint=(1, 0, 0, 1))
        """
        call = f"{self.NAME}.draw_indirect"
        resolved = self._resolve_program(program, call)
        check_mesh(self._core, mesh, call)
        core = self._core
        check = ArgumentChecker(call, core.refuse)
        check.instance("arguments", arguments, IndirectDraws, "an rhi.IndirectDraws")
        buffer = check_buffer(check, "buffer", arguments.buffer)
        count = None if arguments.count is None else check_buffer(check, "count", arguments.count)
        core.check_usable(buffer, call)
        numbers = (arguments.draws, arguments.offset, arguments.stride, arguments.count_offset)
        core.require(call, limits.indirect_faults(*numbers, buffer.size))
        self._refuse_quads(mesh, call)
        if count is not None:
            core.check_usable(count, call)
            core.require(call, limits.count_faults(arguments.count_offset, count.size, core.capabilities))
        vertex_array = self._bind_draws(resolved, mesh, bindings)
        core.backend.draw_indirect(
            vertex_array,
            mesh.primitive,
            buffer.id,
            arguments.offset,
            arguments.draws,
            arguments.stride,
            count.id if count is not None else 0,
            arguments.count_offset,
        )
        core.draws += 1

    def dispatch(
        self, program: Program[P], groups: int | Sequence[int], /, *args: P.args, **bindings: P.kwargs
    ) -> None:
        """Dispatch `groups` = x, (x, y) or (x, y, z) work-groups of a compute program, outside render passes.

        Its writes are visible to all later commands; no barrier is needed.

        Examples:
            >>> numbers = device.storage(float, np.ones(100, np.float32))
            >>> device.dispatch(device.program(Double), 2, numbers=numbers)  # two groups of 64
        """
        call = f"{self.NAME}.dispatch"
        resolved = self._resolve_program(program, call)
        self._core.check_ready()
        several = isinstance(groups, (tuple, list)) or (isinstance(groups, np.ndarray) and groups.ndim)
        counts: Any = groups if several else (groups,)
        sizes: list[int | None] = [*map(to_integer, counts), *_ONES[len(counts) :]]
        faults = limits.dispatch_faults(sizes if len(counts) else (), repr(groups), self._core.capabilities)
        self._core.require(call, faults)
        resolved.bind(resolved.check_can_dispatch, None, bindings)
        x, y, z = (size or 0 for size in sizes)
        if x and y and z:
            self._core.backend.dispatch(x, y, z)
            self._core.dispatches += 1

    def dispatch_indirect(
        self,
        program: Program[P],
        buffer: Buffer | StorageBuffer[Any],
        offset: int = 0,
        /,
        *args: P.args,
        **bindings: P.kwargs,
    ) -> None:
        """Dispatch work-groups whose three counts (uint32) the GPU reads at byte `offset` of `buffer` during
        execution."""
        call = f"{self.NAME}.dispatch_indirect"
        resolved = self._resolve_program(program, call)
        check = ArgumentChecker(call, self._core.refuse)
        source = check_buffer(check, "buffer", buffer)
        offset = check.integer("offset", offset)
        self._core.check_ready()
        self._core.check_usable(source, call)
        self._core.require(call, limits.indirect_dispatch_faults(offset, source.size))
        resolved.bind(resolved.check_can_dispatch, None, bindings)
        self._core.backend.dispatch_indirect(source.id, offset)
        self._core.dispatches += 1

    def immediate(
        self, program: Program[P], primitive: Primitive, /, *args: P.args, **bindings: P.kwargs
    ) -> Immediate[Any]:
        """Create an immediate-mode block: `with device.immediate(program, Primitive.QUADS, …) as quads:`

        The vertices that are added inside are drawn at its end.

        Examples:
            >>> with device.render_pass(image):
            ...     with device.immediate(program, rhi.Primitive.TRIANGLES, tint=(1, 0, 0, 1)) as triangles:
            ...         for position in ((-1, -1), (1, -1), (0, 1)):
            ...             triangles.vertex(position=position)
        """
        call = f"{self.NAME}.immediate"
        resolved = self._resolve_program(program, call)
        ArgumentChecker(call, self._core.refuse).choice("primitive", primitive, Primitive)
        return Immediate(self._transient, resolved, primitive, bindings)

    @property
    def transient(self) -> TransientMemory:
        """Memory for constants and vertices that live for this frame, or as long as this command buffer.

        Examples:
            >>> corners = {"position": np.array([(-1, -1), (1, -1), (0, 1)], np.float32)}
            >>> with device.render_pass(image):
            ...     device.draw(program, device.transient.mesh(program, corners), tint=(1, 0, 0, 1))
        """
        return self._transient

    # -- inside ------------------------------------------------------------------------------------------

    def _resolve_program(self, program: object, call: str) -> Program[...]:
        """Return the program as this encoder uses it.

        Raises:
            ValidationError: `device-argument` if it is not a program, `resource-foreign` if it is of another
                device.
        """
        if not isinstance(program, Program):
            self._core.refuse(rules.DEVICE_ARGUMENT, call, repr(program), "a Program from device.program(…)")
        if program.core is not self._core:
            self._core.refuse(rules.RESOURCE_FOREIGN, call, repr(program))
        return program

    def _bind_draws(self, program: Program[...], mesh: Drawable, bindings: dict[str, Any]) -> int:
        """Check and bind everything that a draw needs; return the vertex array."""
        program.check_can_draw(mesh)
        vertex_array = program.get_vertex_array(mesh)
        program.bind(_already_checked, mesh, bindings)
        self._core.flush_states()
        return vertex_array


def _already_checked(mesh: object) -> None:
    """Do nothing: the check for a `Program.bind` whose draw was checked before."""


def check_mesh(core: Core, mesh: object, call: str, kind: type[Drawable] = Mesh) -> None:
    """Refuse anything but a `Mesh`, or with `kind` `Drawable` anything but a `Mesh` or `TransientMesh`.
    Indirect draws take a `Mesh` only, since their arguments can't know the offset of a transient mesh."""
    if not isinstance(mesh, kind):
        core.refuse(rules.DEVICE_ARGUMENT, call, f"{mesh!r} as mesh", "a Mesh from device.mesh(…)")
