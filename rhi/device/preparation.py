"""Preparation of draws and dispatches before the first frame that needs them: `device.prepare`.

- A platform may build code for each combination of program, vertex layout, formats and states. `Backend`s
  that can do so ahead of the first draw offer `SupportsPreparedKernels`; elsewhere programs and vertex arrays
  are created and that is all.
- All plans are checked before anything begins.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from typing import cast

from rhi.contract.backend import SupportsPreparedKernels
from rhi.contract.descriptors import Stage
from rhi.contract.formats import Format
from rhi.contract.states import STATE_TYPES, State, StateChange
from rhi.device.core.core import Core
from rhi.device.core.state_cache import StateVector
from rhi.device.resources.meshes import Mesh
from rhi.device.resources.programs import Program
from rhi.device.resources.textures import Texture
from rhi.errors.arguments import ArgumentChecker
from rhi.errors.data_classes import dataclass
from rhi.errors.device_objects import DeviceObject
from rhi.errors.rules import DEVICE_ARGUMENT, TEXTURE_SIZE

_CALL = "device.prepare"


@dataclass(frozen=True, slots=True)
class DrawPlan:
    """A planned draw or dispatch: an element of the list that `device.prepare` takes.

    Attributes:
        program: the program. A compute program needs no other field.
        mesh: a mesh with the vertex layout of the later draws; None: any layout, where that is possible.
        targets: the targets of the later draws, or their formats; none: not known yet.
        states: the states of the later draws, on top of the scopes that are open now.
    """

    program: Program[...]
    mesh: Mesh | None = None
    targets: Sequence[Texture | Format] = ()
    states: Sequence[State] = ()


class Preparation(DeviceObject, Future[None]):
    """The future of a `device.prepare`. `result()` waits; it can't be cancelled.

    A preparation never fails: code that can't be built ahead is built, or refused, by the draw that needs it.
    """

    def __init__(self, parts: Iterable[Future[None]]) -> None:
        super().__init__()
        self.set_running_or_notify_cancel()
        waiting = list(parts)
        self._total, self._finished = len(waiting), 0
        self._counting = threading.Lock()
        for part in waiting:
            part.add_done_callback(self._count)
        if not waiting:
            self.set_result(None)

    @property
    def progress(self) -> tuple[int, int]:
        """(finished parts, all parts)."""
        return self._finished, self._total

    def _count(self, part: Future[None]) -> None:
        with self._counting:
            self._finished += 1
            last = self._finished == self._total
        if last:
            self.set_result(None)


def prepare(core: Core, plans: Sequence[DrawPlan]) -> Preparation:
    """Begin to compile code for these draws and dispatches."""
    core.check_ready()
    checked = [(plan, *_check_plan(core, plan)) for plan in plans]
    parts: dict[Future[None], None] = {}  # several plans may share some
    for plan, colors, depth, samples, vector in checked:
        mesh = plan.mesh if Stage.VERTEX in plan.program.descriptor.stages else None
        vertex_array = 0 if mesh is None else plan.program.get_vertex_array(mesh)
        if hasattr(core.backend, "prepare_kernels"):
            states = [StateChange(*pair) for pair in zip(STATE_TYPES, vector.values, strict=True)]
            backend = cast("SupportsPreparedKernels", core.backend)
            parts |= dict.fromkeys(
                backend.prepare_kernels(plan.program.id, vertex_array, colors, depth, samples, states)
            )
    return Preparation(parts)


def _check_plan(core: Core, plan: DrawPlan) -> tuple[list[Format], Format | None, int, StateVector]:
    """Refuse a plan that no draw can follow; return the formats of its targets, their samples, and the
    states."""
    check = ArgumentChecker(_CALL, core.refuse)
    check.instance("program", plan, DrawPlan, "a program, or a list of rhi.DrawPlan")
    check.instance("program", plan.program, Program, "a Program from device.program(…)")
    check.instance("targets", plan.targets, (list, tuple), "a list of textures and formats")
    check.instance("states", plan.states, (list, tuple), "a list of states")
    core.check_usable(plan.program, _CALL)
    if plan.mesh is not None:
        check.instance("mesh", plan.mesh, Mesh, "a Mesh from device.mesh(…), or None")
        for buffer in plan.mesh.buffers:
            core.check_usable(buffer, _CALL)
    colors: list[Format] = []
    depths: list[Format] = []
    counts: set[int] = set()
    for target in plan.targets:
        if isinstance(target, Texture):
            core.check_usable(target, _CALL)
            counts.add(target.samples)
            format = target.format
        else:
            format = check.instance("targets", target, Format, "textures and formats")
        (depths if format.is_depth else colors).append(format)
    most = core.capabilities.max_color_targets
    if len(colors) > most or len(depths) > 1:
        given = f"{len(colors)} color and {len(depths)} depth targets"
        core.refuse(DEVICE_ARGUMENT, _CALL, given, f"up to {most} color targets and 1 depth target")
    if len(counts) > 1:
        core.refuse(TEXTURE_SIZE, _CALL, f"targets of {sorted(counts)} samples", "the same for all of them")
    vector, _ = core.states.derive(tuple(plan.states))
    return colors, depths[0] if depths else None, counts.pop() if counts else 1, vector
