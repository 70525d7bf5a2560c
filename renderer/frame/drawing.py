"""The pass in which a technique draws the scene as the visibility algorithm decides, and a record of what was
drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import cached_property
from types import TracebackType
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.frame.far_objects import FarObjects
from renderer.frame.resources import DRAW_GROUPS, SceneResources, draw_group_states
from renderer.frame.view import View
from renderer.scene import Camera, Depth
from renderer.visibility import DeviceDrawList, SceneArrays
from rhi import (
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Encoder,
    IndirectDraws,
    Program,
    QuerySet,
    State,
    Texture,
    refuse,
)

FARTHEST: Final = {Depth.REVERSED: 0.0, Depth.STANDARD: 1.0}
"""The depth to clear to."""
NEARER: Final = {Depth.REVERSED: DepthFunction.GREATER, Depth.STANDARD: DepthFunction.LESS}
"""The depth function that nearer fragments pass."""
NOT_BEHIND: Final = {Depth.REVERSED: DepthFunction.GREATER_EQUAL, Depth.STANDARD: DepthFunction.LESS_EQUAL}
"""The depth function of the scene's surfaces. Of those in one place the one that is drawn last is seen: so it
is in a later pass that draws them again where depth is equal, in the same order."""


class BoundProgram(NamedTuple):
    """A program and its bindings."""

    program: Program[...]
    bindings: dict[str, Any]


def choose_program(programs: Sequence[BoundProgram], group: int) -> BoundProgram:
    """The program of a pass that draws the objects of a group."""
    return programs[0 if len(programs) == 1 else group // len(DRAW_GROUPS)]


class DrawResult:
    """The objects drawn in a frame: indices that the CPU selected, and draw lists that the device wrote.

    A list is read back when it is first needed, which waits for the device. It is available until the next
    frame makes another one.

    Attributes:
        once: indices of those that two eyes share, because they are far, and that are drawn for the left one alone.
        again: those of them that are drawn at the edge of the right one's image, too.
    """

    def __init__(self, resources: SceneResources) -> None:
        self._resources = resources
        self._steps: list[NDArray[np.int64] | tuple[NDArray[np.int64], QuerySet, NDArray[np.int64]]] = []
        self._lists: list[tuple[DeviceDrawList, int]] = []
        self._being_read: list[Callable[[], NDArray[np.int64]]] | None = None
        self._transparent: list[NDArray[np.int64]] = []
        self.once = self.again = np.zeros(0, np.int64)
        self._limit = resources.detail_limit

    @property
    def is_on_cpu(self) -> bool:
        """True if the CPU knows all indices without waiting for the device."""
        return not self._lists

    def add_batch(self, object_indices: NDArray[np.int64]) -> None:
        """Record that the objects `object_indices` (k,) were drawn, in this order."""
        self._steps.append(object_indices)

    def add_transparent(self, object_indices: NDArray[np.int64]) -> None:
        """Record that the transparent objects `object_indices` (k,) are in view; they are drawn after the
        others."""
        self._transparent.append(object_indices)

    def add_conditional(
        self, object_indices: NDArray[np.int64], queries: QuerySet, query_indices: NDArray[np.int64]
    ) -> None:
        """Record that the objects `object_indices` (k,) were drawn, each on a condition."""
        self._steps.append((object_indices, queries, query_indices))

    def add_list(self, draws: DeviceDrawList) -> None:
        """Record that a list was drawn."""
        self._lists.append((draws, draws.generation))

    def record_hidden(self) -> None:
        """Record which objects the frame has hidden, or request that from the device without waiting."""
        hidden = self._resources.hidden
        if not hidden.is_tracking:
            return
        if self._lists:
            hidden.request_marks(self._lists[-1][0].read_marks)
            return
        conditional = [step[0] for step in self._steps if not isinstance(step, np.ndarray)]
        hidden.record_frame(self.object_indices, np.concatenate([np.zeros(0, np.int64), *conditional]))

    @property
    def transparent(self) -> NDArray[np.int64]:
        """Indices of the transparent objects, in the order in which they were recorded."""
        return np.concatenate([np.zeros(0, np.int64), *self._transparent])

    @cached_property
    def object_indices(self) -> NDArray[np.int64]:
        """Indices of all objects drawn, in the order of their batches; transparent ones last."""
        return np.concatenate([self.opaque, self.transparent])

    @cached_property
    def opaque(self) -> NDArray[np.int64]:
        """Indices of the opaque objects drawn, in the order of their batches."""
        lists = self._read_lists() if self._being_read is None else [wait() for wait in self._being_read]
        if lists and self._resources.uses_meshlets:  # of one object, both lists may have some
            listed, first = np.unique(np.concatenate(lists), return_index=True)
            lists = [listed[np.argsort(first)]]
        object_indices = [step if isinstance(step, np.ndarray) else step[0] for step in self._steps]
        return np.concatenate([np.zeros(0, np.int64), *object_indices, *lists])

    def fetch_lists(self) -> None:
        """Start reading back the device's draw lists, so that they stay available after they are replaced.
        Doesn't wait."""
        self._being_read = [draws.read_object_indices_async() for draws, _ in self._lists]

    def _read_lists(self) -> list[NDArray[np.int64]]:
        for draws, generation in self._lists:
            if draws.generation != generation:
                refuse(
                    rules.STALE_LIST,
                    "FrameResult.visible",
                    f"a list that was replaced {draws.generation - generation} times",
                )
        return [draws.read_object_indices() for draws, _ in self._lists]

    def draw_again(self, scene_drawer: TechniqueDrawer) -> None:
        """Draw the same objects in another pass of the frame, in the same order, so that the same one of
        coplanar surfaces is drawn last. Consecutive batches become one."""
        if len(self._steps) == 1 and not self._lists and isinstance(self._steps[0], np.ndarray):
            scene_drawer.draw_alone(self._steps[0])
            return
        scene_drawer.open()
        batches: list[NDArray[np.int64]] = []
        for step in (*self._steps, None):
            if isinstance(step, np.ndarray):
                batches.append(step)
                continue
            if batches:
                scene_drawer.draw_ordered(np.concatenate(batches))
                batches = []
            if step is not None:
                scene_drawer.draw_conditional(*step)
        scene_drawer.draw_lists([draws for draws, _ in self._lists])

    @cached_property
    def triangles(self) -> int:
        """The number of triangles of all objects drawn, by the levels that the CPU chooses."""
        return self._resources.count_triangles(self.object_indices, self._limit)

    def count_for_right(self) -> tuple[int, int]:
        """The number of objects, and that of their triangles, that the right eye draws of these."""
        count, limit = self._resources.count_triangles, self._limit
        triangles = self.triangles - count(self.once, limit) + count(self.again, limit)
        return len(self.object_indices) - len(self.once) + len(self.again), triangles


class TechniqueDrawer:
    """The `SceneDrawer` of techniques: draws the scene to one set of targets, as a visibility algorithm
    decides, with one program per shader of materials.

    Transparent objects are only recorded when an algorithm draws them (`draw_result.transparent`). So what it
    draws and asks about is never hidden by them, and a later pass draws them in an order of their own
    (`draw_in_order`).

    The pass may be closed and opened again; its targets are cleared when it is first opened. The rows of a
    batch are drawn in one call, front to back, because near objects hide what is drawn after them. They are
    sorted by the depth of their boxes' farthest corners, so that objects on a wide ground are drawn before
    the ground. Each group of objects that needs another program or other states takes a call.

    Attributes:
        depth: the depth target. drawn: the objects drawn.
        was_opened: whether the pass has ever been open.
    """

    def __init__(
        self,
        device: Device,
        resources: SceneResources,
        view: View,
        programs: Sequence[BoundProgram],
        *,
        color: Texture | list[Texture] | None,
        depth: Texture,
        clear: tuple[float, float, float, float] | None = None,
        states: tuple[State, ...] = (),
        clears: bool = True,
        has_meshlets: bool = True,
    ) -> None:
        """Describe a pass without issuing any command.

        Args:
            programs: one for all objects, or one for each of the scene's shaders of materials, the renderer's
                first.
            clear: the colour of pixels on which nothing is drawn; None keeps what the color targets hold.
            states: states of the pass, besides the faces to cull, which each group has, and a depth test that
                passes and writes what isn't behind (`NOT_BEHIND`) unless they say otherwise.
            clears: whether the depth is cleared.
            has_meshlets: whether meshes that are cut may be culled in parts. A later pass that samples other points
                of the pixels would miss parts that are seen only there.
        """
        self.depth = depth
        self.draw_result = DrawResult(resources)
        self._device = device
        self._resources = resources
        self._view = view
        self._programs = programs
        self._color = color
        self._clear = clear
        not_behind = NOT_BEHIND[view.camera.projection.depth]
        merged: tuple[State, ...] = (CullMode.BACK, DepthTest.ON, DepthWrite.ON, not_behind, *states)
        self._states = tuple(dict(zip(map(type, merged), merged, strict=True)).values())
        self._clears = clears
        self._has_meshlets = has_meshlets
        self.was_opened = False
        self._has_all_in_view = False
        self._has_transparent = len(resources.transparent_indices) > 0
        self._scopes: ExitStack | None = None
        self._clears_list = False  # whether the first list clears the targets
        bound = [part for program, bindings in programs for part in (program, *bindings.values())]
        colors = color if isinstance(color, list) else (color,)
        self._fixed_key = (*bound, *colors, depth, clear, clears, *self._states)

    def begin_frame(self) -> None:
        """Draw another frame with the same programs, bindings and targets. The scene, but for the camera, must be
        as it was."""
        self.draw_result = DrawResult(self._resources)
        self.was_opened = self._has_all_in_view = self._clears_list = False
        self._scopes = None

    @property
    def arrays(self) -> SceneArrays:
        """The scene's buffers, updated for every object that may be in view and isn't paused: the CPU
        learns too late which objects a device draws."""
        if self._resources.may_simulate:
            self._simulate_in_view()
        return self._resources.scene_arrays(self._view.buffer)

    @property
    def meshlet_arrays(self) -> SceneArrays | None:
        """The same with meshlets in place of the meshes that are cut; None if none of them is shown, or the pass draws
        them whole."""
        resources = self._resources
        if not (resources.uses_meshlets and self._has_meshlets):
            return None
        if resources.may_simulate:
            self._simulate_in_view()
        return resources.scene_arrays(self._view.buffer, has_meshlets=True)

    @property
    def size(self) -> tuple[int, int]:
        """The width and the height of the targets in pixels."""
        return self.depth.size

    @property
    def key(self) -> tuple[object, ...]:
        """The values that the pass's commands depend on, besides the objects."""
        return (*self._fixed_key, self._resources.groups, self.was_opened)

    def widen(self, camera: Camera) -> Camera:
        """A camera that sees all that the frame's eyes see."""
        return self._view.around

    def open(self) -> None:
        """Begin the pass unless it is open."""
        if self._scopes is None:
            self._scopes = self._begin(self._device, clears=not self.was_opened)
            self.was_opened = True

    def _begin(self, encoder: Encoder, *, clears: bool) -> ExitStack:
        """Begin the pass and its states on an encoder; return the scopes to close."""
        far = FARTHEST[self._view.camera.projection.depth]
        with ExitStack() as scopes:
            scopes.enter_context(
                encoder.render_pass(
                    self._color,
                    self.depth,
                    clear=self._clear if clears and self._color is not None else None,
                    clear_depth=far if clears and self._clears else None,
                )
            )
            scopes.enter_context(encoder.states(*self._states))
            return scopes.pop_all()

    def close(self) -> None:
        """End the pass if it is open. What was drawn is kept."""
        self.__exit__(None, None, None)

    def draw(self, object_indices: NDArray[np.int64]) -> None:
        """Draw the objects `object_indices` (k,)."""
        object_indices = self._select_facing(object_indices)
        resources = self._begin_batch(object_indices)
        if self._has_transparent:
            object_indices = object_indices[self._record_transparent(object_indices)]
        object_indices = self._sort(object_indices)
        if len(resources.groups) > 1:
            object_indices = object_indices[np.argsort(resources.group[object_indices], kind="stable")]
        self._draw_runs(object_indices)

    def draw_ordered(self, object_indices: NDArray[np.int64]) -> None:
        """Draw the objects `object_indices` (k,) in this order in the open pass. They are opaque, and
        already simulated in this frame. Neighbours of one group are drawn in one call."""
        self._draw_runs(object_indices)

    def _draw_runs(self, object_indices: NDArray[np.int64]) -> None:
        self.draw_result.add_batch(object_indices)
        resources = self._resources
        for run in _split_runs(object_indices, resources.group[object_indices]):
            group = int(resources.group[run[0]])
            with self._device.states(*draw_group_states(group)):
                resources.draw_objects(
                    self._device, *choose_program(self._programs, group), run, resources.detail_limit
                )

    def draw_alone(self, object_indices: NDArray[np.int64]) -> None:
        """Draw the objects `object_indices` (k,) in a pass of their own. Commands are recorded when they
        repeat, and only submitted from then on; see `FrameBatch`."""
        if self._scopes is not None:
            self.close()
        resources = self._resources
        if resources.may_simulate:
            object_indices = self._select_facing(object_indices)
            if not len(object_indices):
                return
            resources.simulate(object_indices)
        if self._has_transparent:
            object_indices = object_indices[self._record_transparent(object_indices)]
            if not len(object_indices):
                return
        self.draw_result._steps.append(object_indices)
        tessellated = resources.tessellated_indices
        others = object_indices
        if len(tessellated):
            is_tessellated = np.isin(object_indices, tessellated)
            tessellated, others = object_indices[is_tessellated], object_indices[~is_tessellated]

        view, batch = self._view, self._view.batch
        far = view.far if self._clears and not self.was_opened else None
        parts = batch.order(
            object_indices,
            view.camera.rotation[2],
            lambda: self._arrange(others) if far is None else self._arrange_for_eyes(others, far),
        )
        far = None if far is None or not far.are_copied else far
        is_right = far is not None and far.is_right(self.depth)

        def issue(encoder: Encoder, arguments: list[IndirectDraws | None]) -> None:
            count = len(resources.groups)
            near, distant, edge = arguments[:count], arguments[count : 2 * count], arguments[2 * count :]
            if far is not None and not is_right:
                self._draw_far(encoder, distant, far)
            with self._begin(encoder, clears=not self.was_opened and far is None):
                if far is not None and is_right and far.shift:
                    with encoder.states(far.edge):
                        self._draw_groups(encoder, edge)
                self._draw_groups(encoder, near)
                for row in tessellated.tolist():
                    group = int(resources.group[row])
                    with encoder.states(*draw_group_states(group)):
                        resources.draw_tessellated(encoder, *choose_program(self._programs, group), row)

        key = (*self.key, *tessellated.tolist(), *resources.mirrored[tessellated].tolist())
        if far is not None:
            copies = () if is_right else far.list_right(self._list_targets())
            key = (*key, "far", is_right, far.shift, *copies)
        batch.execute(view.commands.next(), key, resources.draws, parts, issue)
        self.was_opened = True

    def _draw_groups(self, encoder: Encoder, arguments: Sequence[IndirectDraws | None]) -> None:
        """Draw the objects of each group."""
        for group, draws in zip(self._resources.groups, arguments, strict=True):
            if draws is not None:
                program, bindings = choose_program(self._programs, group)
                with encoder.states(*draw_group_states(group)):
                    encoder.draw_indirect(program, self._resources.mesh, draws, **bindings)

    def _draw_far(self, encoder: Encoder, arguments: Sequence[IndirectDraws | None], far: FarObjects) -> None:
        """Draw what is far, and copy it to the targets of the right eye."""
        with self._begin(encoder, clears=True):
            self._draw_groups(encoder, arguments)
        *colors, depth = far.list_right(self._list_targets())
        farthest = FARTHEST[self._view.camera.projection.depth]
        with encoder.render_pass(
            colors or None, depth, clear=self._clear if colors else None, clear_depth=farthest
        ):
            pass
        far.copy(encoder, self._list_targets())

    def _list_targets(self) -> list[Texture]:
        """The colour targets, and the depth."""
        color = self._color
        colors = color if isinstance(color, list) else [] if color is None else [color]
        return [*colors, self.depth]

    def _arrange_for_eyes(
        self, object_indices: NDArray[np.int64], far: FarObjects
    ) -> list[NDArray[np.int64]]:
        """As `_arrange`: the draws of near objects, then those of far ones, and of the far ones at the edge."""
        scene = self._resources.scene
        is_far = far.select_far(scene, object_indices)
        if not far.is_right(self.depth):
            far.are_copied = bool(is_far.any())
        if not is_far.any():
            return self._arrange(object_indices)
        result = self.draw_result
        result.once = object_indices[is_far]
        result.again = result.once[far.select_edge(scene, result.once)]
        return [
            *self._arrange(object_indices[~is_far]),
            *self._arrange(result.once),
            *self._arrange(result.again),
        ]

    def _arrange(self, object_indices: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """Return the draws of objects front to back, as a part for each group."""
        resources, ordered = self._resources, self._sort(object_indices)
        draws = resources.select_draws(ordered, resources.detail_limit)
        if len(resources.groups) == 1:
            return [draws]
        return [draws[resources.select_group(ordered, group)] for group in resources.groups]

    @property
    def is_repeatable(self) -> bool:
        """True if `repeat_alone` may draw all that a frame shows: opaque objects, which nothing simulates."""
        resources = self._resources
        return not (resources.uses_levels or resources.may_simulate or self._has_transparent)

    def repeat_alone(self, object_indices: NDArray[np.int64]) -> None:
        """`draw_alone` as the only pass of a frame, if that `is_repeatable`: in fewer steps, if the recorded commands
        can be repeated."""
        view = self._view
        key = (*self._fixed_key, self._resources.groups, False)
        if view.batch.repeat(view.commands.next(), key, self._arrange(object_indices)):
            self.draw_result.add_batch(object_indices)
            self.was_opened = True
        else:
            view.commands.pass_index = 0
            self.draw_alone(object_indices)

    def draw_conditional(
        self, object_indices: NDArray[np.int64], queries: QuerySet, query_indices: NDArray[np.int64]
    ) -> None:
        """Draw the objects `object_indices` (k,), each if query `query_indices[i]` of a query set counted
        a sample. Objects with the same query are drawn together, front to back. Paused simulations are
        drawn as they are."""
        resources = self._begin_batch(object_indices[~self._resources.hidden.paused[object_indices]])
        if self._has_transparent:
            opaque = self._record_transparent(object_indices)
            object_indices, query_indices = object_indices[opaque], query_indices[opaque]
        self.draw_result.add_conditional(object_indices, queries, query_indices)
        order = np.lexsort((self._farthest_depths(object_indices), query_indices))
        object_indices, query_indices = object_indices[order], query_indices[order]
        for group in resources.groups:
            selected = resources.select_group(object_indices, group)
            draws = resources.get_draws(object_indices[selected], resources.detail_limit)
            if draws.size:
                program, bindings = choose_program(self._programs, group)
                with self._device.states(*draw_group_states(group)):
                    self._device.draw_conditional(
                        program, resources.mesh, draws, queries, query_indices[selected], **bindings
                    )

    def draw_in_order(self, object_indices: NDArray[np.int64], *, far_sides_first: bool = False) -> None:
        """Draw the objects `object_indices` (k,) in this order, transparent ones included. Neighbours of
        one group are drawn in one call.

        Args:
            far_sides_first: whether objects with two sides, unless they are flat, are drawn in two calls:
                the sides that face away from the eye, and then the others, which cover them.
        """
        resources = self._begin_batch(object_indices)
        for run in _split_runs(object_indices, resources.group[object_indices]):
            group = int(resources.group[run[0]])
            program, bindings = choose_program(self._programs, group)
            states = draw_group_states(group)
            parts: list[tuple[NDArray[np.int64], tuple[State, ...]]] = [(run, states)]
            if far_sides_first and CullMode.NONE in states:
                parts = self._split_sides(run, states)
            for part, part_states in parts:
                draws = resources.get_draws(part, resources.detail_limit)
                with self._device.states(*part_states):
                    self._device.draw_many(program, resources.mesh, draws, **bindings)

    def _split_sides(
        self, run: NDArray[np.int64], states: tuple[State, ...]
    ) -> list[tuple[NDArray[np.int64], tuple[State, ...]]]:
        """Return the draws of objects with two sides in their order, each with its states: the far sides and
        the near sides of one object after the other, and runs of flat objects."""
        scene = self._resources.scene
        flat = np.array([scene.meshes.is_flat(mesh) for mesh in scene.objects.mesh[run].tolist()])
        flat &= ~scene.objects.simulated[run] & ~np.isin(run, self._resources.tessellated_indices)
        flat |= self._resources.drawn_in_order[run]
        begins = np.flatnonzero(np.append(True, ~(flat[1:] & flat[:-1])))
        shared = tuple(state for state in states if state is not CullMode.NONE)
        parts: list[tuple[NDArray[np.int64], tuple[State, ...]]] = []
        for part, is_flat in zip(np.split(run, begins[1:]), flat[begins].tolist(), strict=True):
            cull_modes = (CullMode.NONE,) if is_flat else (CullMode.FRONT, CullMode.BACK)
            parts += [(part, (*shared, cull_mode)) for cull_mode in cull_modes]
        return parts

    def _record_transparent(self, object_indices: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Record the transparent objects among `object_indices`, and return the others."""
        transparent = self._resources.is_transparent[object_indices]
        self.draw_result.add_transparent(object_indices[transparent])
        return ~transparent

    def _select_facing(self, object_indices: NDArray[np.int64]) -> NDArray[np.int64]:
        """The objects without those that show the eye only their backs. Two eyes share simulations, so nothing
        is left out for both."""
        view = self._view
        if view.around is not view.camera:
            return object_indices
        return self._resources.turned.select_facing(view.camera, object_indices)

    def _begin_batch(self, object_indices: NDArray[np.int64]) -> SceneResources:
        """Simulate the objects that are drawn next and open the pass; return the scene's resources."""
        self._resources.simulate(object_indices, leave=self.close)
        self.open()
        return self._resources

    def _sort(self, object_indices: NDArray[np.int64]) -> NDArray[np.int64]:
        """The objects, sorted front to back."""
        if len(object_indices) > 1:
            object_indices = object_indices[self._farthest_depths(object_indices).argsort(kind="stable")]
        return object_indices

    def _farthest_depths(self, object_indices: NDArray[np.int64]) -> NDArray[np.float64]:
        """Depth of the farthest corner of each object's box."""
        objects = self._resources.scene.objects
        x, y, z = (-self._view.camera.rotation[2]).tolist()  # forward
        far: NDArray[np.float64] = (objects.upper if x > 0.0 else objects.lower)[:, 0][object_indices] * x
        far += (objects.upper if y > 0.0 else objects.lower)[:, 1][object_indices] * y
        far += (objects.upper if z > 0.0 else objects.lower)[:, 2][object_indices] * z
        return far

    def begin_list(self, draws: DeviceDrawList) -> None:
        """Record that a draw list is drawn. Any simulated object in view may be on it, so all are
        simulated but the paused ones."""
        if self._resources.may_simulate:
            self._simulate_in_view()
        if self._has_transparent and self.draw_result.is_on_cpu:
            # Transparent objects are on no list: all that aren't outside the view are drawn.
            resources, camera = self._resources, self._view.camera
            self.draw_result.add_transparent(resources.select_in_view(camera, resources.transparent_indices))
        self.draw_result.add_list(draws)
        self._clears_list = self._clears_list or not self.was_opened
        self.was_opened = True

    def draw_list(self, encoder: Encoder, draws: DeviceDrawList, *, first: bool) -> None:
        """Draw the device's draw list in a pass of its own."""
        with self._begin(encoder, clears=first and self._clears_list):
            for group in self._resources.groups:
                program, bindings = choose_program(self._programs, group)
                bindings = bindings | {"objects": draws.objects, "object_positions": draws.object_positions}
                with encoder.states(*draw_group_states(group)):
                    encoder.draw_indirect(program, self._resources.mesh, draws.arguments(group), **bindings)

    def draw_lists(self, lists: list[DeviceDrawList]) -> None:
        """Draw the draw lists that the device wrote earlier in this frame."""
        if lists:
            self.close()
            for draws in lists:
                self.begin_list(draws)
            for number, draws in enumerate(lists):
                self.draw_list(self._device, draws, first=number == 0)

    def _simulate_in_view(self) -> None:
        if not self._has_all_in_view:
            self._has_all_in_view = True
            resources, simulated = self._resources, self._resources.simulator.objects
            object_indices = resources.select_in_view(
                self._view.around, simulated[~resources.hidden.paused[simulated]]
            )
            object_indices = self._select_facing(object_indices)
            resources.simulate(object_indices, leave=self.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        scopes, self._scopes = self._scopes, None
        if scopes is not None:
            scopes.__exit__(kind, error, trace)


def _split_runs(object_indices: NDArray[np.int64], groups: NDArray[np.int32]) -> list[NDArray[np.int64]]:
    """Return the runs of neighbours of one group, none of which is empty."""
    return [run for run in np.split(object_indices, np.flatnonzero(np.diff(groups)) + 1) if len(run)]
