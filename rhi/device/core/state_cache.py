"""State vectors and scopes: requested states, hardware states, and the difference between them (thesis 4.2).

- Every combination of states is one interned `StateVector`. On entry, a scope looks up the vector that its
  states lead to in a memo (`vector.after[states]`), keeps the current one, and pushes itself onto the
  fixed-size stack of open scopes. On exit it pops itself and restores the vector that it kept, whatever
  happened inside. `rhi.device.core.scopes` handles a scope that isn't the innermost.
- A draw compares two pointers, requested and hardware. Only when they differ are the changed values looked
  up, again in a memo per pair, and sent. So type, duplicate and capability checks run once per combination,
  not once per scope.
- The pool of vectors is bounded, since scissors and viewports may take any value. When it is full, all memos
  are dropped. Vectors of open scopes stay valid, because differences compare values, not identities.
- There are two counters, as in the thesis's tables (7.1): software changes are states set by scopes, hardware
  changes are values sent to the backend.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, Protocol

from rhi.contract.backend import Capabilities
from rhi.contract.limits import ANY_DEVICE, state_faults
from rhi.contract.states import (
    MAX_TARGETS,
    PER_TARGET,
    STATE_TYPES,
    PlatformState,
    State,
    StateChange,
    default_values,
)
from rhi.device.core.refusals import NO_LOG, RefusalLog
from rhi.device.core.scopes import OpenScopes, Scope, unwrap
from rhi.errors.rules import STATE_DUPLICATE, STATE_TYPE

POOL_ENTRIES: Final = 16_384


class StateVector:
    """A combination of all states; equal combinations are the same object (within one pool generation).

    `values` is in the order of `STATE_TYPES`. A port to an API with pipeline objects uses it as the key of
    its pipelines.
    """

    __slots__ = ("after", "changes", "values")

    def __init__(self, values: tuple[object, ...]) -> None:
        self.values = values
        self.after: dict[tuple[State, ...], tuple[StateVector, int]] = {}  # and the number of these states
        self.changes: dict[StateVector, tuple[StateChange, ...]] = {}

    def __getitem__(self, state_type: type) -> object:
        """Return the value of a state type; a tuple of 8 for types that exist per render target."""
        return self.values[_INDEX[state_type]]

    def __repr__(self) -> str:
        changed = [repr(v) for v, d in zip(self.values, default_values(), strict=True) if v != d]
        return f"StateVector({', '.join(changed) or 'defaults'})"


_INDEX: Final = {state_type: index for index, state_type in enumerate(STATE_TYPES)}
_PLATFORM: Final = _INDEX[PlatformState]


class Validator(Protocol):
    """The checks of a device that validates: the thread, and the platform's context."""

    def check_ready(self) -> None:
        """Check a call."""

    def check_thread(self, call: str) -> None:
        """Check the end of a block, which may follow the end of the device."""


class StateCache:
    """The requested states and the hardware states of one device.

    Attributes:
        scopes: the open scopes of all kinds.
        requested: the vector that the open scopes set.
        hardware: the vector that was last sent to the backend.
        refusals: raises and keeps the errors of refused scopes.
        limits: what the device can do.
        validator: the checks of both ends of a `ValidatedScope`.
        software_changes, hardware_changes: numbers of states set by scopes and of values sent.
    """

    __slots__ = (
        "_entries",
        "_limit",
        "_pool",
        "hardware",
        "hardware_changes",
        "limits",
        "refusals",
        "requested",
        "scopes",
        "software_changes",
        "validator",
    )

    def __init__(
        self,
        limits: Capabilities = ANY_DEVICE,
        pool_entries: int = POOL_ENTRIES,
        refusals: RefusalLog = NO_LOG,
    ) -> None:
        self.limits = limits
        self.refusals = refusals
        self._limit = pool_entries
        self._pool: dict[tuple[object, ...], StateVector] = {}
        self._entries = 0
        self.scopes = OpenScopes(refusals)
        self.validator: Validator | None = None
        self.requested = self.hardware = self._intern(default_values())
        self.software_changes = 0
        self.hardware_changes = 0

    def fresh(self) -> StateCache:
        """Return an empty cache with the same limits, missing capabilities and log."""
        return StateCache(self.limits, self._limit, self.refusals)

    @property
    def depth(self) -> int:
        """Number of open scopes of states."""
        return sum(isinstance(unwrap(scope), StateScope) for scope in self.scopes)

    @property
    def vector_count(self) -> int:
        """Number of distinct combinations in the pool."""
        return len(self._pool)

    def scope(self, states: tuple[State, ...]) -> StateScope:
        """Create a scope of these states; they are checked when it is first entered from a combination."""
        scope = StateScope()
        scope.cache = self
        scope.states = states
        scope.before = None
        return scope

    def derive(self, states: tuple[State, ...]) -> tuple[StateVector, int]:
        """Return the vector that a scope of these states would set, after the same checks, and their
        number."""
        try:
            derived = self.requested.after.get(states)
        except (TypeError, ValueError):  # an unhashable object, which can't be a state
            self._validate(states)
            raise
        return derived or self._derive(states)

    def flush(self) -> tuple[StateChange, ...]:
        """Return the changes from the hardware states to the requested ones, which then count as sent."""
        return self._change(self.requested)

    def change_to(self, vector: StateVector) -> tuple[StateChange, ...]:
        """Return the changes from the hardware states to any vector, of this cache or another; see
        `flush`."""
        if vector.values == self.hardware.values:  # compares pointers, where `_intern` hashes each value
            return ()
        return self._change(self._intern(vector.values))

    def lose_hardware(self) -> None:
        """Note that the hardware's states are unknown, so that the next change sends all of them."""
        self.hardware = StateVector(tuple(object() for _ in STATE_TYPES))

    def adopt(self, values: tuple[object, ...]) -> None:
        """Record values that were sent to the backend without this cache."""
        if values == self.hardware.values:
            return
        self._reserve()
        self.hardware = self._intern(values)

    def _change(self, requested: StateVector) -> tuple[StateChange, ...]:
        hardware = self.hardware
        if requested is hardware:
            return ()
        changes = hardware.changes.get(requested)
        if changes is None:
            changes = tuple(
                StateChange(state_type, new)
                for state_type, new, old in zip(STATE_TYPES, requested.values, hardware.values, strict=True)
                if new is not old and new != old
            )
            self._reserve()
            hardware.changes[requested] = changes
        self.hardware = requested
        self.hardware_changes += len(changes)
        return changes

    def reset_counters(self) -> None:
        """Set both counters to zero."""
        self.software_changes = self.hardware_changes = 0

    def _derive(self, states: tuple[State, ...]) -> tuple[StateVector, int]:
        """Check states, and return and memoise the vector that they make of the requested one."""
        self._validate(states)
        values = list(self.requested.values)
        for state in states:
            index = _INDEX.get(type(state), _PLATFORM)
            target = getattr(state, "target", None)
            if index == _PLATFORM:
                values[index] = _change_platform(values[index], state)
            elif type(state) not in PER_TARGET:
                values[index] = state
            elif target is None:
                values[index] = (state,) * MAX_TARGETS
            else:
                per_target = list(values[index])  # type: ignore[call-overload]
                per_target[target] = replace(state, target=None)  # type: ignore[type-var]
                values[index] = tuple(per_target)
        self._reserve()
        vector = self._intern(tuple(values))
        step = self.requested.after[states] = vector, len(states)
        return step

    def _validate(self, states: tuple[State, ...]) -> None:
        call = "device.states(" + ", ".join(map(repr, states)) + ")"
        seen: set[tuple[type, int | None]] = set()
        for state in states:
            state_type = type(state)
            if not isinstance(state, PlatformState) and state_type not in _INDEX:
                allowed = ", ".join(t.__name__ for t in STATE_TYPES)
                self.refusals.refuse(
                    STATE_TYPE, call, f"{state!r}, a {state_type.__name__}", f"a value of {allowed}"
                )
            key = (state_type, getattr(state, "target", None))
            if key in seen:
                self.refusals.refuse(STATE_DUPLICATE, call, f"{state_type.__name__} twice", "each state once")
            seen.add(key)
            for fault in state_faults(state, self.limits):
                self.refusals.refuse(fault.rule, call, *fault[1:])

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
        saved = [
            scope.before
            for scope in map(unwrap, self.scopes)
            if isinstance(scope, StateScope) and scope.before
        ]
        for vector in (*self._pool.values(), *saved, self.requested, self.hardware):
            vector.after.clear()
            vector.changes.clear()
        self._pool = {self.requested.values: self.requested}


def _change_platform(values: object, state: object) -> tuple[PlatformState, ...]:
    """Return the states of the platform that differ from their defaults, after one of them has changed."""
    assert isinstance(values, tuple)
    assert isinstance(state, PlatformState)
    remaining = [value for value in values if type(value) is not type(state)]
    if state is not state.default():
        remaining.append(state)
    return tuple(sorted(remaining, key=lambda value: value.full_name))


class StateScope(Scope):
    """A `with device.states(...)` block: sets states on entry and always restores the earlier ones on exit.

    One object may be kept and entered again, also inside itself. It has no `__init__`, whose call would cost
    a tenth of the block: `StateCache.scope` and `Encoder.states` set its attributes.

    Attributes:
        cache: the cache of its device or command buffer.
        states: its states.
        before: the vector that it restores while it is open, None otherwise.
    """

    __slots__ = ("before", "cache", "states")
    cache: StateCache
    states: tuple[State, ...]
    before: StateVector | None

    def __repr__(self) -> str:
        return f"StateScope({', '.join(map(str, self.states))}{', open' * (self.before is not None)})"

    def __enter__(self) -> None:
        if self.before is not None:
            self._enter_again()
            return
        cache, states = self.cache, self.states
        before = cache.requested
        try:
            step = before.after[states]
        except (KeyError, TypeError, ValueError):
            step = None
        target, count = step or cache.derive(states)
        scopes = cache.scopes
        index = scopes._index  # from here on nothing may be interrupted, so it calls nothing
        try:
            scopes._data[index] = self
        except IndexError:
            scopes.refuse_full()
        scopes._index = index + 1
        self.before = before
        cache.requested = target
        cache.software_changes += count

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        cache = self.cache
        scopes = cache.scopes
        index, data = scopes._index - 1, scopes._data
        if data[index] is not self:
            scopes.leave(self, error)
            return
        data[index] = None
        scopes._index = index
        cache.requested = self.before  # type: ignore[assignment]  # it is open
        self.before = None

    def _enter_again(self) -> None:
        """Enter an open scope inside itself: a second one takes its place in the stack."""
        again = _ReenteredScope()
        again.cache = self.cache
        again.states = self.states
        again.before = None
        again.block = self
        again.__enter__()

    def describe(self) -> str:
        """Return the scope's text in messages."""
        return f"device.states({', '.join(map(repr, self.states))})"

    def finish(self, failed: bool) -> None:
        """Pop the scope, the innermost one, and restore the states before it."""
        self.__exit__(None, None, None)


class ValidatedScope(StateScope):
    """A scope of a device with validation, which is entered and left on the device's thread and keeps its
    line."""

    __slots__ = ()

    def __enter__(self) -> None:
        if self.cache.validator is not None:
            self.cache.validator.check_ready()
        super().__enter__()
        self.cache.scopes.record_line()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if self.cache.validator is not None:
            self.cache.validator.check_thread("the end of device.states(…)")
        super().__exit__(kind, error, trace)


class _ReenteredScope(StateScope):
    """A scope in the stack that was entered through one that was already open."""

    __slots__ = ("block",)
    block: StateScope

    def get_block(self) -> Scope:
        return self.block
