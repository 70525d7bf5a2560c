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
from renderer.frame.resources import DRAW_GROUPS, SceneResources, find_states
from renderer.frame.view import View
from renderer.scene import Camera, Depth
from renderer.visibility import DeviceList, SceneArrays
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
"""The depth function of the scene's surfaces. Of those in one place the one that is drawn last is seen: so it is in a
later pass that draws them again where depth is equal, in the same order."""


class BoundProgram(NamedTuple):
    """A program, and what it is bound to."""

    program: Program[...]
    bindings: dict[str, Any]


def choose_program(programs: Sequence[BoundProgram], group: int) -> BoundProgram:
    """Return the one of a pass's programs that draws the objects of a group."""
    return programs[0 if len(programs) == 1 else group // len(DRAW_GROUPS)]


class Drawn:
    """The objects drawn in a frame: rows that the CPU has chosen, and lists that the device has made.

    A list is read back when it is first needed, which waits for the device. It is available until the next frame
    makes another one.
    """

    def __init__(self, resources: SceneResources) -> None:
        self._resources = resources
        self._steps: list[NDArray[np.int64] | tuple[NDArray[np.int64], QuerySet, NDArray[np.int64]]] = []
        self._lists: list[tuple[DeviceList, int]] = []
        self._being_read: list[Callable[[], NDArray[np.int64]]] | None = None
        self._transparent: list[NDArray[np.int64]] = []

    @property
    def is_known(self) -> bool:
        """Whether the CPU knows all rows, without waiting for the device."""
        return not self._lists

    def add_batch(self, rows: NDArray[np.int64]) -> None:
        """Record that the objects `rows` (k,) were drawn, in this order."""
        self._steps.append(rows)

    def add_transparent(self, rows: NDArray[np.int64]) -> None:
        """Record that the transparent objects `rows` (k,) are in view: they are drawn after the others."""
        self._transparent.append(rows)

    def add_conditional(self, rows: NDArray[np.int64], queries: QuerySet, answers: NDArray[np.int64]) -> None:
        """Record that the objects `rows` (k,) were drawn, each on a condition."""
        self._steps.append((rows, queries, answers))

    def add_list(self, draws: DeviceList) -> None:
        """Record that a list was drawn."""
        self._lists.append((draws, draws.generation))

    def note_hidden(self) -> None:
        """Note what the frame has hidden, or ask the device for it. Doesn't wait."""
        hidden = self._resources.hidden
        if not hidden.are_watched:
            return
        if self._lists:
            hidden.ask(self._lists[-1][0].read_marks)
            return
        conditional = [step[0] for step in self._steps if not isinstance(step, np.ndarray)]
        hidden.note(self.rows, np.concatenate([np.zeros(0, np.int64), *conditional]))

    @property
    def transparent(self) -> NDArray[np.int64]:
        """The rows of the transparent objects; their order is that in which they were found."""
        return np.concatenate([np.zeros(0, np.int64), *self._transparent])

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """The rows of all objects drawn, in the order of their batches; transparent ones last."""
        return np.concatenate([self.opaque, self.transparent])

    @cached_property
    def opaque(self) -> NDArray[np.int64]:
        """The rows of all objects drawn but the transparent ones, in the order of their batches."""
        lists = self._read_lists() if self._being_read is None else [wait() for wait in self._being_read]
        rows = [step if isinstance(step, np.ndarray) else step[0] for step in self._steps]
        return np.concatenate([np.zeros(0, np.int64), *rows, *lists])

    def fetch_lists(self) -> None:
        """Begin to read back the lists that the device has made, if any, so that they are available after others have
        replaced them. Doesn't wait."""
        self._being_read = [draws.read_rows_async() for draws, _ in self._lists]

    def _read_lists(self) -> list[NDArray[np.int64]]:
        for draws, generation in self._lists:
            if draws.generation != generation:
                refuse(
                    rules.STALE_LIST,
                    "FrameResult.visible",
                    f"a list that was replaced {draws.generation - generation} times",
                )
        return [draws.read_rows() for draws, _ in self._lists]

    def draw_again(self, scene_pass: TechniquePass) -> None:
        """Draw the same objects in another pass of the same frame, in the same order: of surfaces in one place the same
        one is drawn last. Batches that follow each other are one."""
        if len(self._steps) == 1 and not self._lists and isinstance(self._steps[0], np.ndarray):
            scene_pass.draw_alone(self._steps[0])
            return
        scene_pass.open()
        batches: list[NDArray[np.int64]] = []
        for step in (*self._steps, None):
            if isinstance(step, np.ndarray):
                batches.append(step)
                continue
            if batches:
                scene_pass.draw_as_ordered(np.concatenate(batches))
                batches = []
            if step is not None:
                scene_pass.draw_conditional(*step)
        scene_pass.draw_lists([draws for draws, _ in self._lists])

    @cached_property
    def triangles(self) -> int:
        """The number of triangles of all objects drawn."""
        return self._resources.count_triangles(self.rows)


class TechniquePass:
    """A `ScenePass`: draws the scene to one set of targets, as a visibility algorithm decides, with one program, or one
    for each shader that materials have.

    Transparent objects are only recorded when an algorithm draws them (`drawn.transparent`). So what it draws and asks
    about is never hidden by them, and a later pass draws them in an order of their own (`draw_in_order`).

    The pass may be closed and opened again; its targets are cleared when it is first opened. The rows of a batch are
    drawn in one call, front to back, because near objects hide what is drawn after them. They are sorted by the depth
    of their boxes' farthest corners, so that objects on a wide ground are drawn before the ground. Each group of
    objects that needs another program or other states takes a call.

    Attributes:
        depth: the depth target. drawn: the objects drawn. was_opened: whether the pass has ever been open.
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
    ) -> None:
        """Describe a pass; nothing is issued yet.

        Args:
            programs: one for all objects, or one for each of the scene's shaders of materials, the renderer's first.
            clear: the colour of pixels on which nothing is drawn; None keeps what the color targets hold.
            states: states of the pass, besides the faces to cull, which each group has, and a depth test that passes
                and writes what isn't behind (`NOT_BEHIND`) unless they say otherwise.
            clears: whether the depth is cleared.
        """
        self.depth = depth
        self.drawn = Drawn(resources)
        self._device = device
        self._resources = resources
        self._view = view
        self._programs = programs
        self._color = color
        self._clear = clear
        not_behind = NOT_BEHIND[view.camera.projection.depth]
        defaults: tuple[State, ...] = (CullMode.BACK, DepthTest.ON, DepthWrite.ON, not_behind)
        self._states = tuple({type(state): state for state in (*defaults, *states)}.values())
        self._clears = clears
        self.was_opened = False
        self._has_all_in_view = False
        self._has_transparent = len(resources.transparent_rows) > 0
        self._scopes: ExitStack | None = None
        self._clears_list = False  # whether the first list clears the targets

    @property
    def arrays(self) -> SceneArrays:
        """The scene's buffers, up to date for every object that may be in view and doesn't rest: of what reads them,
        the CPU learns too late which objects it draws."""
        self._simulate_in_view()
        return self._resources.list_arrays(self._view.buffer)

    @property
    def key(self) -> tuple[object, ...]:
        """The values that the pass's commands depend on, besides what is drawn."""
        color = self._color
        return (
            *(value for one in self._programs for value in (one.program, *one.bindings.values())),
            *(color if isinstance(color, list) else (color,)),
            self.depth,
            self._clear,
            self._clears,
            *self._states,
            self._resources.groups,
            self.was_opened,
        )

    def widen(self, camera: Camera) -> Camera:
        """Return a camera that sees all that the frame's eyes see."""
        return self._view.around

    def open(self) -> None:
        """Begin the pass unless it is open."""
        if self._scopes is None:
            self._scopes = self._begin(self._device, clears=not self.was_opened)
            self.was_opened = True

    def _begin(self, encoder: Encoder, *, clears: bool) -> ExitStack:
        """Begin the pass and its states on an encoder; return the scopes to leave."""
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

    def draw(self, rows: NDArray[np.int64]) -> None:
        """Draw the objects `rows` (k,)."""
        resources = self._begin_batch(rows)
        if self._has_transparent:
            rows = rows[self._set_transparent_aside(rows)]
        rows = self._sort(rows)
        if len(resources.groups) > 1:
            rows = rows[np.argsort(resources.group[rows], kind="stable")]
        self._draw_runs(rows)

    def draw_as_ordered(self, rows: NDArray[np.int64]) -> None:
        """Draw the objects `rows` (k,) in this order in the open pass: none is transparent, and all were simulated in
        this frame. Neighbours of one group are drawn in one call."""
        self._draw_runs(rows)

    def _draw_runs(self, rows: NDArray[np.int64]) -> None:
        self.drawn.add_batch(rows)
        resources = self._resources
        for run in _divide(rows, resources.group[rows]):
            group = int(resources.group[run[0]])
            with self._device.states(*find_states(group)):
                resources.draw_rows(self._device, *choose_program(self._programs, group), run)

    def draw_alone(self, rows: NDArray[np.int64]) -> None:
        """Draw the objects `rows` (k,) in a pass of their own. The commands are recorded when they come again, and then
        only submitted; see `FrameBatch`."""
        self.close()
        resources = self._resources
        resources.simulate(rows)
        if self._has_transparent:
            rows = rows[self._set_transparent_aside(rows)]
            if not len(rows):
                return
        self.drawn.add_batch(rows)
        tessellated = resources.tessellated_rows
        others = rows
        if len(tessellated):
            is_tessellated = np.isin(rows, tessellated)
            tessellated, others = rows[is_tessellated], rows[~is_tessellated]

        def arrange() -> list[NDArray[np.int64]]:
            ordered = self._sort(others)
            return [ordered[resources.find_group(ordered, group)] for group in resources.groups]

        def issue(encoder: Encoder, arguments: list[IndirectDraws | None]) -> None:
            with self._begin(encoder, clears=not self.was_opened):
                for group, draws in zip(resources.groups, arguments, strict=True):
                    if draws is not None:
                        program, bindings = choose_program(self._programs, group)
                        with encoder.states(*find_states(group)):
                            encoder.draw_indirect(program, resources.mesh, draws, **bindings)
                for row in tessellated.tolist():
                    group = int(resources.group[row])
                    with encoder.states(*find_states(group)):
                        resources.draw_tessellated(encoder, *choose_program(self._programs, group), row)

        view, batch = self._view, self._view.batch
        parts = batch.order(rows, view.camera.forward, arrange)
        key = (*self.key, *tessellated.tolist(), *resources.mirrored[tessellated].tolist())
        batch.execute(view.commands.next(), key, resources.draws, parts, issue)
        self.was_opened = True

    def draw_conditional(self, rows: NDArray[np.int64], queries: QuerySet, answers: NDArray[np.int64]) -> None:
        """Draw the objects `rows` (k,), each on condition that row `answers[i]` (k,) of a query set counted a sample.
        Objects with the same condition are drawn together, front to back. What rests is drawn as it is."""
        resources = self._begin_batch(rows[~self._resources.hidden.rests[rows]])
        if self._has_transparent:
            opaque = self._set_transparent_aside(rows)
            rows, answers = rows[opaque], answers[opaque]
        self.drawn.add_conditional(rows, queries, answers)
        order = np.lexsort((self._find_farthest(rows), answers))
        rows, answers = rows[order], answers[order]
        for group in resources.groups:
            chosen = resources.find_group(rows, group)
            draws = resources.draws[rows[chosen]]
            if draws.size:
                program, bindings = choose_program(self._programs, group)
                with self._device.states(*find_states(group)):
                    self._device.draw_conditional(program, resources.mesh, draws, queries, answers[chosen], **bindings)

    def draw_in_order(self, rows: NDArray[np.int64]) -> None:
        """Draw the objects `rows` (k,) in this order, transparent ones as well. Neighbours of one group are drawn in
        one call."""
        resources = self._begin_batch(rows)
        for run in _divide(rows, resources.group[rows]):
            group = int(resources.group[run[0]])
            program, bindings = choose_program(self._programs, group)
            with self._device.states(*find_states(group)):
                self._device.draw_many(program, resources.mesh, resources.draws[run], **bindings)

    def _set_transparent_aside(self, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Record the transparent ones of the objects `rows`, and return which are not."""
        transparent = self._resources.is_transparent[rows]
        self.drawn.add_transparent(rows[transparent])
        return ~transparent

    def _begin_batch(self, rows: NDArray[np.int64]) -> SceneResources:
        """Simulate the objects that are drawn next and open the pass; return the scene's resources."""
        self._resources.simulate(rows, leave=self.close)
        self.open()
        return self._resources

    def _sort(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return objects front to back."""
        if len(rows) > 1:
            rows = rows[np.argsort(self._find_farthest(rows), kind="stable")]
        return rows

    def _find_farthest(self, rows: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the depth of the farthest corner of each object's box."""
        objects, forward = self._resources.scene.objects, self._view.camera.forward
        far: NDArray[np.float64] = np.where(forward > 0.0, objects.upper[rows], objects.lower[rows]) @ forward
        return far

    def begin_list(self, draws: DeviceList) -> None:
        """Record that a list is drawn. Simulated objects that are not outside the view are run, since any of them may
        be on it, but for those that rest."""
        self._simulate_in_view()
        if self.drawn.is_known:  # transparent objects are on no list: all that aren't outside the view are drawn
            resources, camera = self._resources, self._view.camera
            self.drawn.add_transparent(resources.find_in_view(camera, resources.transparent_rows))
        self.drawn.add_list(draws)
        self._clears_list = self._clears_list or not self.was_opened
        self.was_opened = True

    def draw_list(self, encoder: Encoder, draws: DeviceList, *, first: bool) -> None:
        """Draw the objects that the device has listed, in a pass of their own."""
        with self._begin(encoder, clears=first and self._clears_list):
            for group in self._resources.groups:
                program, bindings = choose_program(self._programs, group)
                with encoder.states(*find_states(group)):
                    encoder.draw_indirect(program, self._resources.mesh, draws.arguments(group), **bindings)

    def draw_lists(self, lists: list[DeviceList]) -> None:
        """Draw the objects of lists that the device has made earlier in this frame."""
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
            rows = resources.find_in_view(self._view.around, simulated[~resources.hidden.rests[simulated]])
            resources.simulate(rows, leave=self.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        scopes, self._scopes = self._scopes, None
        if scopes is not None:
            scopes.__exit__(kind, error, trace)


def _divide(rows: NDArray[np.int64], groups: NDArray[np.int32]) -> list[NDArray[np.int64]]:
    """Return the runs of neighbours of one group, none of which is empty."""
    return [run for run in np.split(rows, np.flatnonzero(np.diff(groups)) + 1) if len(run)]
