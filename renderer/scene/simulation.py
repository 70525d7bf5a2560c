"""Simulations: whatever changes a set of objects over time, run only where the objects are drawn.

A simulation has members: objects with a mesh of their own, whose vertices it computes (particles, cloth,
skinning), or nodes, whose transforms it computes (animations, rigid bodies). A member that isn't drawn is
left alone. When it is drawn again it is brought to the frame's time, by the simulation's catch-up policy
(`renderer.scene.catch_up`).

Whether an object is visible depends on its bounds, and those of an object that is left alone can't follow it.
So bounds are declared that hold at all times (`SceneBuilder.add_mesh(bounds=...)`,
`SceneBuilder.animate(bounds=...)`). A simulation without bounds runs in every frame, and the bounds of its
objects follow.

Members that were drawn in one frame are expected to be drawn in the next: they are brought to the frame's
time at its beginning, all at once. Members that show unexpectedly follow right before their draw. So
everything is drawn as of its frame, and a member that is no longer drawn runs in one frame more, at most.

Members that are small on the screen are updated less often (`Simulator.slow_down`), and those no larger than
the lag that is allowed are paused. Their times follow from their sizes, so they don't depend on what was
drawn before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Final, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Indices, list_ranges
from renderer.scene.catch_up import CatchUp, Leap, Recompute
from renderer.scene.meshes import Meshes
from renderer.scene.nodes import Nodes
from renderer.scene.objects import Objects
from rhi import Device, StorageBuffer
from rhi.errors import refuse
from rhi.math import Camera, is_parallel
from rhi.math.indexing import repeat_each

_NONE: Final[Indices] = np.zeros(0, np.int64)
_ROUNDING: Final = 2.0**-20  # of the largest coordinate: vertices are float32
_STATES: Final = count(1)
_ALL_STEPS: Final = 1 << 62  # of a frame: more than any members can miss

MAX_EXPECTED_SPEED: Final = 4.0
"""How many diameters of its bounds something is expected to move in a second, at most."""
_SHORTEST: Final = 1.0 / 32.0  # a shorter period is about a frame
_PHASES: Final = 4  # members of one period are updated in this many groups, one after another


class ObjectSimulation(Protocol):
    """A simulation of k members. A `deepcopy` is independent of the original.

    It has the methods of its policy, `TimedSimulation`, `StepSimulation` or `LeapSimulation`, and one of
    `VertexSimulation` or `NodeSimulation`.

    Attributes:
        catch_up: how members that weren't drawn are brought to the frame's time, and what that may cost.
    """

    @property
    def catch_up(self) -> CatchUp:
        """The policy; it never changes."""
        ...


class VertexSimulation(Protocol):
    """A simulation whose members are objects, and which computes their vertices."""

    def vertices(self, members: Indices) -> NDArray[Any]:
        """Return the present vertices of `members` (j,), one after another, of `VERTEX`; each one's number
        never changes."""
        ...


@runtime_checkable
class DeviceVertexSimulation(VertexSimulation, Protocol):
    """A simulation that can compute the vertices of its members on a device, where they are drawn.

    It may defer the work of `step`, `leap` or `set_time` until then. `vertices` serves devices without
    compute shaders, and readers on the CPU.
    """

    def deform(
        self,
        device: Device,
        members: Indices,
        vertices: StorageBuffer[float],
        first_vertices: Indices,
        stride: int,
        tangent: int = -1,
    ) -> None:
        """Write the present positions and normals of `members` (j,), and tangents if they have any.

        Args:
            vertices: the vertices as floats; one begins with its position and normal.
            first_vertices: (j,), the number of each member's first vertex.
            stride: the number of floats from vertex to vertex.
            tangent: the number of floats before a vertex's tangent; negative if vertices have none.
        """
        ...

    def release(self, device: Device) -> None:
        """Destroy what the simulation holds on a device."""
        ...


@runtime_checkable
class FacingSimulation(VertexSimulation, Protocol):
    """A simulation whose vertices depend on the eye as well: they face it, or are in the order of their distances.

    Attributes:
        faces_eye: whether vertices face the eye.
    """

    @property
    def faces_eye(self) -> bool:
        """True if vertices face the eye; it never changes."""
        ...

    @property
    def is_flat(self) -> bool:
        """True if nothing of a member that is in order is behind another part of it and drawn later."""
        ...

    def look_from(self, members: Indices, eyes: Floats, is_sorted: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Take the eye of a frame for `members` (j,); return which of them (j,) it may change.

        Args:
            eyes: (j, 4), the position in the space of each object and 1, or the direction to the eye and 0.
            is_sorted: (j,), whether triangles must be in order, the farthest first.
        """
        ...


@runtime_checkable
class HeightSimulation(VertexSimulation, Protocol):
    """A simulation that moves the heights of surfaces over the x and z of their objects.

    Seen from so far below that no slope can face the eye, a surface with one side isn't drawn.
    """

    @property
    def max_slopes(self) -> Floats:
        """The greatest slopes of any triangle along x and along z (2,): metres up for each metre."""
        ...


class NodeSimulation(Protocol):
    """A simulation whose members are nodes, and which computes their transforms."""

    def transforms(self, members: Indices) -> Floats:
        """Return the present transforms (j, 4, 4) of `members` (j,), from node to parent."""
        ...


@runtime_checkable
class VersionedSimulation(Protocol):
    """A `TimedSimulation` whose function of the time may change.

    Attributes:
        version: a number that differs once the function has changed; its members are then computed again.
    """

    @property
    def version(self) -> int:
        """The number, 0 before the first change."""
        ...


class FunctionOfTime:
    """A simulation of nodes whose transforms (k, 4, 4) a function computes from seconds, all at once."""

    catch_up: Final = Recompute()

    def __init__(self, motion: Callable[[float], Floats]) -> None:
        self._motion = motion
        self._transforms: Floats = np.zeros((0, 4, 4))

    def set_time(self, members: Indices, seconds: float) -> None:
        """Compute the transforms of all members."""
        self._transforms = np.asarray(self._motion(seconds))

    def transforms(self, members: Indices) -> Floats:
        """Return the transforms of `members` (j,)."""
        matrices = self._transforms
        return matrices if matrices.ndim != 3 or len(matrices) == len(members) else matrices[members]


def check_simulation(call: str, simulation: object, output: str) -> ObjectSimulation:
    """Return `simulation`; refuse an object that isn't a simulation with the method `output`."""
    policy = getattr(simulation, "catch_up", None)
    if not isinstance(policy, CatchUp):
        refuse(rules.BAD_SIMULATION, call, f"catch_up = {policy!r}", "Recompute, Stepwise or Leap")
    needed = (*policy.methods, output)
    if missing := [name for name in needed if not callable(getattr(simulation, name, None))]:
        refuse(rules.BAD_SIMULATION, call, f"no {', '.join(missing)}", f"methods {', '.join(needed)}")
    interval = getattr(simulation, "interval", 1.0)
    if "step" in needed and not (hasattr(simulation, "interval") and 0.0 < interval < np.inf):
        step_length = getattr(simulation, "interval", None)
        refuse(rules.BAD_SIMULATION, call, f"interval = {step_length!r}", "seconds, above 0, finite")
    return cast("ObjectSimulation", simulation)


@dataclass(frozen=True, eq=False, slots=True)
class SceneSimulation:
    """A simulation in its initial state, and what it changes.

    Attributes:
        simulation: the simulation; it must not be changed.
        objects: the indices of its members (k,) if they are objects, which it deforms.
        nodes: the indices of its members (k,) if they are nodes, which it moves.
        is_bounded: whether its members have bounds that hold at all times.
    """

    simulation: ObjectSimulation
    objects: Indices = field(default_factory=lambda: _NONE)
    nodes: Indices = field(default_factory=lambda: _NONE)
    is_bounded: bool = True

    def __len__(self) -> int:
        return len(self.objects) + len(self.nodes)


@dataclass(frozen=True, eq=False, slots=True)
class DeformedObjects:
    """The states of the objects `object_indices` (j,), the `members` (j,) of `simulation`.

    `states` (j,) identify them: equal numbers are equal vertices. That of an exact simulation is its step or
    its time.
    """

    simulation: VertexSimulation
    object_indices: Indices
    members: Indices
    states: Floats


@dataclass(frozen=True, eq=False, slots=True)
class AdvanceResult:
    """The objects that `Simulator.advance` has brought to the frame's time: objects whose transforms may have
    changed, and those whose vertices may have."""

    moved: Indices = field(default_factory=lambda: _NONE)
    deformed: tuple[DeformedObjects, ...] = ()


class Simulator:
    """Runs the simulations of a scene for what is drawn; a renderer has one.

    The transforms that it computes are written to the scene's nodes, which other simulators write to as well:
    they are those of what it advances, until another one begins a frame.

    Attributes:
        simulations: copies of the scene's simulations, in the order of `Scene.simulated`.
        objects: indices of the objects that are simulated only where they are drawn, ascending.
        deformed: the part of `objects` whose vertices are simulated, but no node that carries them.
        diverging: the part of `objects` whose state would differ after an absence from that of objects always
            drawn.
        seconds: the time of the frame.
        steps: number of steps that members took since `begin_frame`.
        late: number of members that were brought towards the frame's time, and haven't reached it.
        takes_all_steps: whether members take all steps that they have missed, one by one, whatever their
            policies allow. Their states then follow from the frame's time alone.
        validation: whether `advance` also checks the bounds of one of its objects, another one in each call.
    """

    def __init__(
        self,
        simulated: Sequence[SceneSimulation],
        nodes: Nodes,
        objects: Objects,
        meshes: Meshes,
        followed: Indices = _NONE,
    ) -> None:
        """Begin with the initial state.

        Args:
            followed: the rows of nodes that lights or views follow: these and the nodes above them are animated
                in every frame, whatever is drawn.
        """
        self._begin = tuple(simulated)
        self._nodes = nodes
        self._objects = objects
        self._meshes = meshes
        self._first: list[int] = np.cumsum([0, *map(len, self._begin)]).tolist()
        sizes = list(map(len, self._begin))
        self._which: Indices = repeat_each(np.arange(len(sizes)), sizes)
        self._slot_of = np.full(len(objects), -1, np.int64)  # the slots of members that are objects
        by_node = np.full(len(nodes), -1, np.int64)
        for member, first in zip(self._begin, self._first, strict=False):
            self._slot_of[member.objects] = first + np.arange(len(member.objects))
            by_node[member.nodes] = first + np.arange(len(member.nodes))
        self._starts, self._slots = _list_slots(nodes, objects, by_node, self._slot_of)
        self._has_nodes = np.zeros(len(objects), bool)
        owner = repeat_each(np.arange(len(objects)), np.diff(self._starts))
        self._has_nodes[owner[self._slots != self._slot_of[owner]]] = True
        self.objects: Indices = objects.simulated_indices
        self.deformed: Indices = self.objects[
            (self._slot_of >= 0)[self.objects] & ~self._has_nodes[self.objects]
        ]
        diverges = np.array(
            [not member.simulation.catch_up.returns_exactly(len(member)) for member in self._begin], bool
        )
        self.diverging: Indices = np.intersect1d(owner[diverges[self._which[self._slots]]], self.objects)
        always = np.zeros(len(self._which), bool)
        for simulation_index, member in enumerate(self._begin):
            always[self._first[simulation_index] : self._first[simulation_index + 1]] = not member.is_bounded
        follows = objects.boxes.node == objects.node  # the bounds follow the node, which must be where it is
        always[self._slots[follows[owner] & (self._slots != self._slot_of[owner])]] = True
        while len(followed):  # one level upwards
            slots = by_node[followed]
            always[slots[slots >= 0]] = True
            followed = nodes.parents[followed].astype(np.int64)
            followed = followed[followed >= 0]
        self._always: Indices = np.flatnonzero(always)
        self._owner = owner
        turns = [
            np.arange(size) * _PHASES // size for size in sizes
        ]  # neighbours move together, as they are uploaded
        self._shares = np.concatenate([np.zeros(0), *turns]) / _PHASES  # of a period
        self._times: Floats = np.zeros(len(self._which))  # by slot: what it is brought to in this frame
        self._waiting = np.zeros(len(objects), bool)
        self._drawn = np.zeros(len(objects), bool)
        self.takes_all_steps = False
        self.validation = False
        self._check_count = 0
        self.seconds = 0.0
        self._restart()
        self._reset_counts()

    def __len__(self) -> int:
        return len(self.objects)

    @property
    def drawn_count(self) -> int:
        """The number of `objects` drawn since `begin_frame`."""
        return int(self._drawn[self.objects].sum())

    @property
    def drawn_objects(self) -> Indices:
        """The part of `objects` drawn since `begin_frame`; before `begin_frame`, the part drawn in the last
        frame."""
        return self.objects[self._drawn[self.objects]]

    def list_drawn_members(self) -> list[tuple[ObjectSimulation, Indices, Indices]]:
        """Return each vertex simulation with its objects (j,) drawn since `begin_frame`, and their members
        (j,)."""
        rows = self.drawn_objects
        slots = self._slot_of[rows]
        rows, slots = rows[slots >= 0], slots[slots >= 0]
        parts = [(number, self._which[slots] == number) for number in np.unique(self._which[slots]).tolist()]
        return [
            (self.simulations[number], rows[part], slots[part] - self._first[number])
            for number, part in parts
        ]

    def begin_frame(self, seconds: float) -> None:
        """Begin a frame at the time `seconds`, and run simulations without bounds. If `seconds` is before the
        last frame's time, all simulations start again."""
        if seconds < self.seconds:
            self._restart()
        self.seconds = seconds
        self._times[:] = seconds
        self._reset_counts()
        if self._nodes.last_writer is not self:
            self._posed[:] = self._brought[:] = np.nan
        for number, simulation in self._versioned.items():
            if simulation.version != self._versions[number]:
                self._versions[number] = simulation.version
                members = slice(self._first[number], self._first[number + 1])
                self._reached[members] = self._brought[members] = np.nan
        if len(self._always):
            self._run(self._always)

    def slow_down(self, camera: Camera, height: int, lag: float) -> None:
        """Update members that are small in a view of `height` pixels less often. Call it after `begin_frame`,
        when the scene is up to date.

        Args:
            lag: pixels by which an object may be late that moves by `MAX_EXPECTED_SPEED` of its diameters in
                a second. Objects no larger than that are paused. Sizes are measured in the middle of the
                image.
        """
        if not len(self.objects) or lag <= 0.0:
            return
        lower, upper = self._objects.lower[self.objects], self._objects.upper[self.objects]
        scale = 0.5 * height * float(camera.projection.matrix[1, 1]) * np.linalg.norm(upper - lower, axis=1)
        if not is_parallel(camera.projection):
            away = np.maximum(np.maximum(lower - camera.position, camera.position - upper), 0.0)
            scale /= np.maximum(np.linalg.norm(away, axis=1), 1e-30)
        if not (scale < lag / (MAX_EXPECTED_SPEED * _SHORTEST)).any():
            return
        longest = np.exp2(np.floor(np.log2(lag / (MAX_EXPECTED_SPEED * np.maximum(scale, lag)))))
        period_of_object = np.zeros(len(self._objects))
        period_of_object[self.objects] = np.where(
            scale <= lag, np.inf, np.where(longest < _SHORTEST, 0.0, longest)
        )
        periods = np.full(len(self._which), np.inf)
        # A node is updated as often as the largest object that it carries.
        np.minimum.at(periods, self._slots, period_of_object[self._owner])
        slow = (periods > 0.0) & (periods < np.inf)
        paused = periods == np.inf
        turns = np.floor(self.seconds / periods[slow] + self._shares[slow]) - self._shares[slow]
        self._times[slow] = np.maximum(turns * periods[slow], 0.0)
        self._times[paused] = 0.0

    def is_due(self, rows: Indices) -> bool:
        """True if any of the objects `rows` isn't at the frame's time yet."""
        return bool(self._waiting[rows].any())

    def advance(self, rows: Indices, *, is_drawn: bool = True) -> AdvanceResult:
        """Bring the simulated objects among `rows` to the frame's time; return the objects that may have
        changed.

        The scene must be up to date. `is_drawn` is False for objects that are only expected to be drawn.
        """
        if not len(self.objects):
            return AdvanceResult()
        if is_drawn:
            self._drawn[rows] = True
        rows = rows[self._waiting[rows]]
        if not len(rows):
            return AdvanceResult()
        self._waiting[rows] = False
        if self._run(self._list_slots(rows)):
            self._nodes.update()
        if self.validation:
            self._check_count += 1
            self.check_bounds(rows[self._check_count % len(rows)])
        moved = rows[self._has_nodes[rows]]
        slots = self._slot_of[rows]
        rows, slots = rows[slots >= 0], slots[slots >= 0]
        simulation_index = self._which[slots]
        deformed = []
        for number in np.unique(simulation_index).tolist():
            is_mine = simulation_index == number
            mine = slots[is_mine]
            simulation: Any = self.simulations[number]
            deformed.append(
                DeformedObjects(simulation, rows[is_mine], mine - self._first[number], self._states[mine])
            )
        return AdvanceResult(moved, tuple(deformed))

    def pose_all(self) -> None:
        """Bring all nodes that are members to the frame's time, drawn or not; `Nodes.update` applies it."""
        self._run(
            np.flatnonzero(
                np.array([len(simulated.nodes) > 0 for simulated in self._begin], bool)[self._which]
            )
        )

    def check_bounds(self, row: int) -> None:
        """Refuse the simulation of an object that has left its bounds. It must be as of the frame's time."""
        objects, meshes = self._objects, self._meshes
        part = meshes.ranges[objects.mesh[row]]
        vertices = self.read_vertices(row)
        if vertices is None:
            used = meshes.indices[part["first_index"] :][: part["index_count"]] + part["base_vertex"]
            vertices = meshes.vertices[used]
        points = vertices["position"]
        world = self._nodes.world[objects.node[row]]
        points = points @ world[:3, :3].T + world[:3, 3]
        lower, upper = objects.lower[row], objects.upper[row]
        slack = _ROUNDING * max(np.abs(lower).max(), np.abs(upper).max())
        if not ((points >= lower - slack) & (points <= upper + slack)).all():
            reached = f"from {_format_point(points.min(0))} to {_format_point(points.max(0))}"
            problem = f"object {row} {reached} at {self.seconds:g} s"
            refuse(
                rules.LEFT_BOUNDS,
                "Simulator.check_bounds",
                problem,
                f"{_format_point(lower)} to {_format_point(upper)}",
            )

    def read_vertices(self, row: int) -> NDArray[Any] | None:
        """Return the vertices of an object as of its last step, or None if they aren't simulated."""
        slot = int(self._slot_of[row])
        if slot < 0:
            return None
        simulation_index = int(self._which[slot])
        simulation: Any = self.simulations[simulation_index]
        vertices: NDArray[Any] = simulation.vertices(np.array([slot - self._first[simulation_index]]))
        return vertices

    def _reset_counts(self) -> None:
        self.steps = 0
        self.late = 0
        self._left = [
            _ALL_STEPS if self.takes_all_steps else simulated.simulation.catch_up.steps_per_frame
            for simulated in self._begin
        ]
        self._drawn[self.objects] = False
        self._waiting[self.objects] = True
        self._is_done: NDArray[np.bool_] = np.zeros(len(self._which), bool)

    def _restart(self) -> None:
        self.simulations: list[ObjectSimulation] = [
            deepcopy(simulated.simulation) for simulated in self._begin
        ]
        begins = [simulated.simulation.catch_up.begin() for simulated in self._begin]
        self._reached: Floats = np.array(begins, np.float64)[self._which]  # by slot: its step or its time
        self._states: Floats = self._reached.copy()
        self._posed: Floats = np.full(len(self._which), np.nan)  # the states that the nodes have
        self._brought: Floats = np.full(len(self._which), np.nan)  # the times that slots have been brought to
        self._versioned = {
            number: simulated
            for number, simulated in enumerate(self.simulations)
            if isinstance(simulated, VersionedSimulation)
        }
        self._versions = dict.fromkeys(self._versioned, 0)

    def _list_slots(self, rows: Indices) -> Indices:
        """Return all slots of the objects `rows`; one may be listed several times."""
        first = self._starts[rows]
        listed: Indices = self._slots[list_ranges(first, self._starts[rows + 1] - first)]
        return listed

    def _run(self, slots: Indices) -> bool:
        """Bring the members in `slots` to the frame's time, but for those already there. Return whether
        nodes were moved."""
        is_due = np.zeros(len(self._which), bool)
        is_due[slots] = True
        is_due &= ~self._is_done
        self._is_done |= is_due
        slots = np.flatnonzero(is_due & (self._brought != self._times))
        moved = False
        simulation_index = self._which[slots]
        for number in np.unique(simulation_index).tolist():
            mine = slots[simulation_index == number]
            times = self._times[mine]
            for seconds in np.unique(times).tolist():
                members = mine[times == seconds]
                self._advance_members(number, members, seconds)
                moved |= self._write_transforms(number, members)
        return moved

    def _write_transforms(self, number: int, slots: Indices) -> bool:
        """Write changed transforms of members to their nodes; return whether any have changed."""
        nodes = self._begin[number].nodes
        stale = slots[self._states[slots] != self._posed[slots]] if len(nodes) else _NONE
        if not len(stale):
            return False
        members = stale - self._first[number]
        simulation: Any = self.simulations[number]
        self._nodes.set_local(nodes[members], simulation.transforms(members))
        self._nodes.last_writer = self
        self._posed[stale] = self._states[stale]
        return True

    def _advance_members(self, number: int, slots: Indices, seconds: float) -> None:
        """Bring the members in `slots` of one simulation to a time, as far as its policy allows."""
        simulation: Any = self.simulations[number]
        policy = simulation.catch_up
        target = policy.target(simulation, seconds)
        before = self._reached[slots]
        is_behind = before != target if isinstance(policy, Recompute) else before < target
        self._brought[slots] = seconds
        behind, before = slots[is_behind], before[is_behind]
        if not len(behind):
            return
        members = behind - self._first[number]
        reached, steps = policy.advance(simulation, members, before, target, self._left[number])
        self._left[number] = max(self._left[number] - steps, 0)
        self.steps += steps
        is_late = reached != target
        self._brought[behind[is_late]] = np.nan
        self.late += int(is_late.sum())
        changed = reached != before
        self._reached[behind] = reached
        # A leap's result depends on where it began, so the step's number doesn't identify it; nor does the
        # time what another function gave.
        is_known = not (isinstance(policy, Leap) or self._versions.get(number))
        self._states[behind[changed]] = reached[changed] if is_known else -next(_STATES)


def _list_slots(
    nodes: Nodes, objects: Objects, by_node: Indices, by_object: Indices
) -> tuple[Indices, Indices]:
    """List for each object the slots that change it: its own, and those of its node and of the nodes above.

    Return `starts` (n + 1,) and `slots`; the list of object i is `slots[starts[i]:starts[i + 1]]`.
    """
    rows = np.flatnonzero(by_object >= 0)
    owners, slots = [rows], [by_object[rows]]
    rows, at = np.arange(len(objects)), objects.node.astype(np.int64)
    while len(rows):
        hit = by_node[at] >= 0
        owners.append(rows[hit])
        slots.append(by_node[at[hit]])
        at = nodes.parents[at].astype(np.int64)
        rows, at = rows[at >= 0], at[at >= 0]
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    starts = np.searchsorted(owner[order], np.arange(len(objects) + 1))
    return starts, np.concatenate(slots)[order]


def _format_point(point: Floats) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in point.tolist()) + ")"
