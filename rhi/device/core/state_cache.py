"""State vectors and scopes: wanted states, hardware states, and the difference between them (thesis 4.2).

- Every combination of states is one interned `StateVector`, every tuple of states one `StateScope`. On entry, a scope
  looks up the vector it leads to in a memo (`vector.after[scope]`) and pushes the current one onto a fixed-size
  stack. On exit it pops that vector, whatever happened inside.
- A draw compares two pointers, wanted and hardware. Only when they differ are the changed values looked up,
  again in a memo per pair, and sent. So type, duplicate and capability checks run once per combination, not
  once per scope.
- The pool of vectors is bounded, since scissors and viewports may take any value. When it is full, all memos are
  dropped. Vectors on the stack stay valid, because differences compare values, not identities.
- There are two counters, as in the thesis's tables (7.1): software changes are states set by scopes, hardware changes
  are values sent to the backend.
"""

from __future__ import annotations

from dataclasses import replace
from types import TracebackType
from typing import Final

from rhi.contract.states import (
    DEFAULTS,
    MAX_TARGETS,
    PER_TARGET,
    STATE_TYPES,
    BlendFunction,
    PolygonOffset,
    State,
    StateChange,
    StencilReadMask,
    StencilReference,
    StencilWriteMask,
    default_values,
)
from rhi.device.core.containers import FixedStack
from rhi.device.core.refusals import NO_LOG, RefusalLog
from rhi.errors import RhiError
from rhi.errors.rules import STATE_CAPABILITY, STATE_DUPLICATE, STATE_TYPE

__rhi_internal__ = True

STACK_DEPTH: Final = 256
POOL_ENTRIES: Final = 16_384


class StateVector:
    """One combination of all states; equal combinations are the same object (within one pool generation).

    `values` is in the order of `STATE_TYPES`. A port to an API with pipeline objects uses it as the key of its
    pipelines.
    """

    __slots__ = ("after", "changes", "values")

    def __init__(self, values: tuple[object, ...]) -> None:
        self.values = values
        self.after: dict[StateScope, StateVector] = {}
        self.changes: dict[StateVector, tuple[StateChange, ...]] = {}

    def __getitem__(self, state_type: type) -> object:
        """Return the value of a state type; a tuple of 8 for types that exist per render target."""
        return self.values[_INDEX[state_type]]

    def __repr__(self) -> str:
        shown = [repr(v) for v, d in zip(self.values, default_values(), strict=True) if v != d]
        return f"StateVector({', '.join(shown) or 'defaults'})"


_INDEX: Final = {state_type: index for index, state_type in enumerate(STATE_TYPES)}


class StateCache:
    """The wanted states and the hardware states of one device.

    Attributes:
        wanted: the vector that the open scopes set.
        hardware: the vector that was last sent to the backend.
        refusals: raises and keeps the errors of refused scopes.
        unsupported: state types that the device lacks, each with the name of the missing capability.
        software_changes, hardware_changes: numbers of states set by scopes and of values sent.
    """

    __slots__ = ("_entries", "_limit", "_pool", "_scopes", "_stack", "hardware", "hardware_changes",
                 "refusals", "software_changes", "unsupported", "wanted")  # fmt: skip

    def __init__(
        self,
        unsupported: dict[type, str] | None = None,
        pool_entries: int = POOL_ENTRIES,
        refusals: RefusalLog = NO_LOG,
    ) -> None:
        self.unsupported = unsupported or {}
        self.refusals = refusals
        self._limit = pool_entries
        self._pool: dict[tuple[object, ...], StateVector] = {}
        self._scopes: dict[tuple[State, ...], StateScope] = {}
        self._entries = 0
        self._stack: FixedStack[StateVector] = FixedStack(STACK_DEPTH)
        self.wanted = self.hardware = self._intern(default_values())
        self.software_changes = 0
        self.hardware_changes = 0

    def fresh(self) -> StateCache:
        """Return an empty cache with the same limits, missing capabilities and log."""
        return StateCache(self.unsupported, self._limit, self.refusals)

    @property
    def depth(self) -> int:
        """Number of open scopes."""
        return len(self._stack)

    @property
    def vector_count(self) -> int:
        """Number of distinct combinations in the pool."""
        return len(self._pool)

    def scope(self, states: tuple[State, ...]) -> StateScope:
        """Return the scope of these states; they are checked when it is first entered from a combination."""
        try:
            scope = self._scopes.get(states)
        except TypeError:  # an unhashable object, which can't be a state; entering the scope refuses it
            return StateScope(self, states)
        if scope is None:
            scope = StateScope(self, states)
            self._reserve()
            self._scopes[states] = scope
        return scope

    def derive(self, states: tuple[State, ...]) -> StateVector:
        """Return the vector that a scope of these states would set, after the same checks."""
        if not states:
            return self.wanted
        scope = self.scope(states)
        return self.wanted.after.get(scope) or self._derive(scope)

    def flush(self) -> tuple[StateChange, ...]:
        """Return the changes from the hardware states to the wanted ones, which then count as sent."""
        return self._change(self.wanted)

    def change_to(self, vector: StateVector) -> tuple[StateChange, ...]:
        """Return the changes from the hardware states to any vector, of this cache or another; see `flush`."""
        return self._change(self._intern(vector.values))

    def adopt(self, values: tuple[object, ...]) -> None:
        """Record values that were sent to the backend without this cache."""
        self._reserve()
        self.hardware = self._intern(values)

    def _change(self, wanted: StateVector) -> tuple[StateChange, ...]:
        hardware = self.hardware
        if wanted is hardware:
            return ()
        changes = hardware.changes.get(wanted)
        if changes is None:
            changes = tuple(
                StateChange(state_type, new)
                for state_type, new, old in zip(STATE_TYPES, wanted.values, hardware.values, strict=True)
                if new is not old and new != old
            )
            self._reserve()
            hardware.changes[wanted] = changes
        self.hardware = wanted
        self.hardware_changes += len(changes)
        return changes

    def reset_counters(self) -> None:
        """Set both counters to zero."""
        self.software_changes = self.hardware_changes = 0

    def _derive(self, scope: StateScope) -> StateVector:
        """Check a scope, and return and memoise the vector that it makes of the wanted one."""
        states = scope.states
        self._validate(states)
        values = list(self.wanted.values)
        for state in states:
            index = _INDEX[type(state)]
            target = getattr(state, "target", None)
            if type(state) not in PER_TARGET:
                values[index] = state
            elif target is None:
                values[index] = (state,) * MAX_TARGETS
            else:
                per_target = list(values[index])  # type: ignore[call-overload]
                per_target[target] = _without_target(state)
                values[index] = tuple(per_target)
        self._reserve()
        vector = self._intern(tuple(values))
        self.wanted.after[scope] = vector
        return vector

    def _validate(self, states: tuple[State, ...]) -> None:
        call = "device.states(" + ", ".join(map(repr, states)) + ")"
        seen: set[tuple[type, int | None]] = set()
        for state in states:
            state_type = type(state)
            if state_type not in _INDEX:
                allowed = ", ".join(t.__name__ for t in STATE_TYPES)
                self.refusals.refuse(
                    STATE_TYPE, call, f"{state!r}, a {state_type.__name__}", f"a value of {allowed}"
                )
            key = (state_type, getattr(state, "target", None))
            if key in seen:
                self.refusals.refuse(STATE_DUPLICATE, call, f"{state_type.__name__} twice", "each state once")
            seen.add(key)
            if state_type in self.unsupported and _needs_capability(state):
                self.refusals.refuse(
                    STATE_CAPABILITY, call, repr(state), f"needs capabilities.{self.unsupported[state_type]}"
                )

    def _intern(self, values: tuple[object, ...]) -> StateVector:
        vector = self._pool.get(values)
        if vector is None:
            vector = self._pool[values] = StateVector(values)
        return vector

    def _reserve(self) -> None:
        """Count one more memo entry, dropping all of them when the limit is reached."""
        self._entries += 1
        if self._entries <= self._limit:
            return
        self._entries = 0
        for vector in (*self._pool.values(), *self._stack, self.wanted, self.hardware):
            vector.after.clear()
            vector.changes.clear()
        self._pool = {self.wanted.values: self.wanted}
        self._scopes.clear()


def _needs_capability(state: State) -> bool:
    """Return whether a state of an optional type needs its capability: not a default, nor what every device has."""
    if isinstance(state, BlendFunction):
        return state.target is not None
    if isinstance(state, PolygonOffset):
        return state.clamp != 0.0
    if isinstance(state, StencilReference | StencilReadMask | StencilWriteMask):
        return state.front != state.back
    return state != DEFAULTS[type(state)]


def _without_target(state: State) -> State:
    return replace(state, target=None)  # type: ignore[type-var]


class StateScope:
    """A `with device.states(...)` block: sets states on entry and always restores the earlier ones on exit.

    A scope holds no data of an entry, so one object may be kept and entered again, also inside itself.
    """

    __slots__ = ("_cache", "states")

    def __init__(self, cache: StateCache, states: tuple[State, ...]) -> None:
        self._cache = cache
        self.states = states

    def __enter__(self) -> None:
        cache = self._cache
        wanted = cache.wanted
        target = wanted.after.get(self) or cache._derive(self)
        try:
            cache._stack.push(wanted)
        except RhiError as error:  # the stack is full
            cache.refusals.note(error)
            raise
        cache.wanted = target
        cache.software_changes += len(self.states)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        cache = self._cache
        try:
            cache.wanted = cache._stack.pop()
        except RhiError as error:  # no scope is open
            cache.refusals.note(error)
            raise
