"""Draws of command buffers that are submitted again, as bundles of WebGPU.

- A run is draws of a pass, with the bindings and states between them. Its first submission makes one call for each,
  since many command buffers have no second one. The second records a bundle, and from then on one call executes it.
- Commands of a command buffer follow on the same ones each time. So a bundle is as right as the calls that it was
  recorded from; what its draws need is looked up and checked once.
- A bundle changes no viewport, scissor, blend color or stencil reference: a run ends before such a change, and before a
  query, a label or an indirect draw. The pass that a bundle is executed in has those states.
- Contents of index buffers may change between submissions. Those of lists decide whether these restart, so they are
  looked at each time; where they may, calls are made one by one again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from rhi.backends.webgpu.command_encoder import Stream
from rhi.backends.webgpu.implementation import BundleFunctions, GpuObject
from rhi.backends.webgpu.webgpu_bindings import BoundResources
from rhi.backends.webgpu.webgpu_buffers import Buffers, GpuBuffer
from rhi.backends.webgpu.webgpu_draws import Draws
from rhi.backends.webgpu.webgpu_errors import translate_errors
from rhi.backends.webgpu.webgpu_formats import DUMMY_FORMAT, FORMATS
from rhi.backends.webgpu.webgpu_pipelines import DYNAMIC, States
from rhi.backends.webgpu.webgpu_programs import GpuProgram
from rhi.backends.webgpu.webgpu_textures import GpuTexture
from rhi.contract.descriptors import Id
from rhi.contract.interrupts import DeferredInterrupts
from rhi.contract.topology import LISTS
from rhi.errors import RhiError

Command = tuple[str, tuple[Any, ...]]
"""A method of `rhi.contract.backend.Backend`, and its arguments."""

LEAST_DRAWS: Final = 8
"""Draws of a run, below which a bundle gains nothing."""
_BINDINGS: Final = frozenset({"bind_uniform", "bind_storage", "bind_texture", "bind_image"})


class Run:
    """Draws of a pass, and the commands between them.

    Attributes:
        commands: the commands, until they are a bundle.
        lists: the index buffers of lists, and the bits of the indices that restart them.
        bundle: the bundle, once it is recorded.
        is_repeated: whether the run was submitted before.
        fails: whether no bundle could be recorded.
        used: the buffers and textures that the bundle uses.
        retained: the objects that it was recorded with.
        latest: the calls that leave bindings and states as the run does.
    """

    __slots__ = ("bundle", "commands", "fails", "is_repeated", "latest", "lists", "retained", "used")

    def __init__(self, commands: Sequence[Command], lists: Mapping[GpuBuffer, int]) -> None:
        self.commands = commands
        self.lists = tuple(lists.items())
        self.bundle: GpuObject | None = None
        self.is_repeated = self.fails = False
        self.used: tuple[GpuBuffer | GpuTexture, ...] = ()
        self.retained: list[GpuObject] = []
        self.latest: list[tuple[Callable[..., object], tuple[Any, ...]]] = []

    @property
    def may_restart(self) -> bool:
        """True if indices of a list may restart it, so that it takes other draws than those of the bundle."""
        return any(buffer.copy is not None or buffer.restarts & bit for buffer, bit in self.lists)


class RecordedDraws:
    """Records runs of draws as bundles, and executes them."""

    def __init__(
        self,
        device: GpuObject,
        stream: Stream,
        buffers: Buffers,
        bindings: BoundResources,
        states: States,
        draws: Draws,
    ) -> None:
        self._device = device
        self._stream = stream
        self._buffers = buffers
        self._bindings = bindings
        self._states = states
        self._draws = draws

    def prepare(
        self, commands: Sequence[Command], programs: Mapping[Id, GpuProgram], backend: object
    ) -> list[tuple[int, int, Callable[[], bool]]]:
        """See `rhi.contract.backend.SupportsRecordedDraws`; `backend` has the methods."""
        bundles = self._stream.implementation.bundles
        if bundles is None:
            return []
        return [
            (start, end, self._prepare(Run(commands[start:end], lists), bundles, backend))
            for start, end, lists in self._select_runs(commands, programs)
        ]

    def _select_runs(
        self, commands: Sequence[Command], programs: Mapping[Id, GpuProgram]
    ) -> Iterator[tuple[int, int, dict[GpuBuffer, int]]]:
        """Yield the start and end of each run, and the index buffers of its lists with their bits."""
        program: GpuProgram | None = None
        start, draws = 0, 0
        lists: dict[GpuBuffer, int] = {}
        for index, (name, arguments) in enumerate([*commands, ("", ())]):
            if name == "bind_program":
                program = programs[arguments[0]]
            elif name == "draw" and program is not None and self._draws.can_bundle(program, *arguments[:2]):
                draws += 1
                array = self._draws.arrays[arguments[0]]
                if array.indexed and arguments[1] in LISTS:
                    buffer = self._buffers[array.descriptor.index_buffer]
                    lists[buffer] = lists.get(buffer, 0) | array.restart_bit
            elif name not in _BINDINGS and not (name == "set_states" and _is_baked(arguments)):
                if draws >= LEAST_DRAWS:
                    yield start, index, lists
                start, draws, lists = index + 1, 0, {}

    def _prepare(self, run: Run, bundles: BundleFunctions, backend: object) -> Callable[[], bool]:
        stream, draws = self._stream, self._draws

        def execute() -> bool:
            if not run.is_repeated or run.fails or run.may_restart:
                run.is_repeated = True
                return False
            render = draws.open_segment()
            with DeferredInterrupts():  # an interrupt between would leave other bindings than the run does
                if run.bundle is None:
                    if not self._record(run, bundles, backend):
                        return False
                else:
                    for call, arguments in run.latest:
                        call(*arguments)
                for resource in run.used:
                    resource.serial = stream.serial
                bundles.execute(render, run.bundle)
                draws.lose_bindings()
            return True

        return execute

    def _record(self, run: Run, bundles: BundleFunctions, backend: object) -> bool:
        """Record a run as a bundle, which leaves the run's bindings and states; return whether it succeeded. If it
        didn't, they are as before, and its calls say why."""
        stream, draws, bindings, states = self._stream, self._draws, self._bindings, self._states
        slots, program, values = bindings.copy_slots(), draws.program, dict(states.values)
        render, used = stream.render, set[GpuBuffer | GpuTexture]()
        methods = {name: getattr(backend, name) for name in {name for name, _ in run.commands}}
        try:
            with translate_errors("a bundle"):
                encoder = bundles.begin(self._device, *self._name_formats())
                stream.render, stream.retained = encoder._internal, run.retained
                draws.use_functions(bundles)
                draws.lose_bindings()
                for name, arguments in run.commands:
                    methods[name](*arguments)
                    if name == "draw":
                        used.update(bindings.list_used(draws.program))  # type: ignore[arg-type]
                        used.update(draws.list_buffers(arguments[0]))
                run.bundle = bundles.finish(encoder)
        except RhiError:
            run.fails = True
            draws.program = program
            states.values.update(values)
            states.changed = True
            bindings.restore_slots(slots)
        finally:
            stream.render, stream.retained = render, None
            draws.use_functions(stream.implementation)
            draws.lose_bindings()
        run.used = tuple(used)
        run.latest = [(methods[name], arguments) for name, arguments in _list_latest(run.commands)]
        run.commands = ()
        return not run.fails

    def _name_formats(self) -> tuple[list[str], str | None, int]:
        """Return the names of the open pass's formats, and its number of samples."""
        colors, depth, samples = self._draws.targets
        if not colors and depth is None:
            colors = (DUMMY_FORMAT,)
        return [FORMATS[color] for color in colors], FORMATS[depth] if depth is not None else None, samples


def _is_baked(arguments: tuple[Any, ...]) -> bool:
    """True if a change of states is one of pipelines only."""
    return all(state not in DYNAMIC for state, _ in arguments[0])


def _list_latest(commands: Sequence[Command]) -> list[Command]:
    """Return the commands that leave the program, bindings and states as all of these do."""
    latest: dict[object, Command] = {}
    states: dict[type, Any] = {}
    for command in commands:
        name, arguments = command
        if name == "set_states":
            states.update(arguments[0])
        elif name != "draw":
            key = (name, arguments[0] if name in _BINDINGS else None)
            latest.pop(key, None)
            latest[key] = command
    if states:
        latest["states"] = "set_states", (tuple(states.items()),)
    return list(latest.values())
