"""Occlusion queries and conditional rendering (thesis 4.4, Listing 4.11).

- A query is native where the backend supports it. Elsewhere, or on request, it is emulated as in the
  thesis (4.4.2): the GPU writes its running samples-passed counter at two fence values. The difference is the
  result, which is final once the second fence value has completed.
- `is_finished` never blocks. `visible_samples` returns the result of a finished query and refuses an
  unfinished one; `wait` blocks.
"""

from __future__ import annotations

import time
from threading import get_ident
from typing import Final, Generic, Self, TypeVar

from rhi.contract.descriptors import Id, QueryKind
from rhi.contract.interrupts import DeferredInterrupts
from rhi.contract.limits import condition_faults
from rhi.device.core.core import Core, describe_object
from rhi.device.core.scopes import Scope
from rhi.device.resources.lifetime import drop
from rhi.errors import DeviceError, rules
from rhi.errors.arguments import ArgumentChecker
from rhi.errors.device_objects import DeviceObject

T = TypeVar("T")

RESULT_SECONDS: Final = 10.0
"""The seconds that a driver may take to publish a result after the query's fence value has completed."""
_IDLE = "not begun"
_OPEN = "open"
_ENDED = "ended"


class PendingQuery(DeviceObject, Generic[T]):
    """Base class of queries and query sets: their result becomes available some time after the end."""

    __slots__ = ("_answer", "_core", "_fence", "_ids", "_state", "destroyed", "emulated")

    def __init__(self, core: Core, count: int, emulated: bool, call: str) -> None:
        """Create `count` OCCLUSION queries or, if emulated, `count` + 1 COUNTER queries."""
        capabilities = core.capabilities
        self.emulated = emulated or not capabilities.occlusion_queries
        if self.emulated and not capabilities.sample_counter:
            core.refuse(
                rules.DEVICE_CAPABILITY, call, "an emulated query", "needs capabilities.sample_counter"
            )
        self._core = core
        self._ids: list[Id] = []
        kind = QueryKind.COUNTER if self.emulated else QueryKind.OCCLUSION
        for _ in range(count + self.emulated):
            query = core.create_id()
            core.create(core.backend.create_query, query, kind)
            self._ids.append(query)
        self._state = _IDLE
        self._answer: T | None = None
        self._fence = 0
        self.destroyed = False

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self._ids) - self.emulated}, {self._state})"

    def __del__(self) -> None:
        if not getattr(self, "destroyed", True):  # it isn't there if creation failed
            drop(self, *self._ids)

    @property
    def ids(self) -> tuple[Id, ...]:
        """The ids of all its queries in the command stream."""
        return tuple(self._ids)

    @property
    def core(self) -> Core:
        """The core of its device."""
        return self._core

    @property
    def label(self) -> str:
        """The empty string: queries have no labels."""
        return ""

    @property
    def is_finished(self) -> bool:
        """True if the result is available; never blocks. False if the query was never ended."""
        if self._answer is None and self._state is _ENDED and not self.destroyed:
            self._core.check_ready()
            if not self.emulated or self._core.timeline.completed >= self._fence:
                self._answer = self._read()
        return self._answer is not None

    @property
    def visible_samples(self) -> T:
        """The result of a finished query.

        Raises:
            ValidationError: `query-unfinished` while it is not available, `query-state` if the query was
                never ended or is destroyed.
        """
        if not self.is_finished:
            call = f"{type(self).__name__}.visible_samples"
            self.check_ended(self._core, call)
            self._core.refuse(rules.QUERY_UNFINISHED, call, "an unfinished query")
        assert self._answer is not None
        return self._answer

    def wait(self) -> T:
        """Block until the result is available, and return it.

        Raises:
            DeviceError: `device-no-answer` if it is not available 10 s after the GPU has passed the query's
                end.

        Examples:
            >>> query = device.occlusion_query()
            >>> with device.render_pass(image), query:
            ...     device.draw(program, mesh, tint=(1, 1, 1, 1))
            >>> query.wait()
            100
            >>> query.is_finished
            True
        """
        if not self.is_finished:
            call = f"{type(self).__name__}.wait"
            self.check_ended(self._core, call)
            self._core.timeline.wait(self._fence if self.emulated else self._core.signal())
            deadline = time.monotonic() + RESULT_SECONDS
            while not self.is_finished:  # a driver may publish the result a moment after the fence
                if time.monotonic() > deadline:
                    given = (
                        f"query {self._ids[-1]}: no result {RESULT_SECONDS:g} s after the GPU passed its end"
                    )
                    self._core.refusals.fail(DeviceError(rules.DEVICE_ANSWER, call, given))
                time.sleep(0)
        assert self._answer is not None
        return self._answer

    def destroy(self) -> None:
        """Destroy the query; an open query can't be destroyed."""
        if self._state is _OPEN:
            self._core.refuse(
                rules.QUERY_STATE, f"{type(self).__name__}.destroy", "an open query", "a query that was ended"
            )
        if not self.destroyed:
            self._core.check_thread("destroy")
            with DeferredInterrupts():
                self.destroyed = True
                for query in self._ids:
                    self._core.timeline.retire(query)

    def discard_result(self) -> None:
        """Discard the earlier result, as the query is used again."""
        self._answer = None
        self._state = _IDLE

    def mark_submitted(self, fence: int) -> None:
        """Note that the query was submitted and ends before `fence`."""
        self._answer = None
        self._state = _ENDED
        self._fence = fence

    def _read(self) -> T | None:
        """Read the result from the backend; None while it is not available."""
        raise NotImplementedError

    def check_ended(self, core: Core, call: str) -> None:
        """Refuse a query that was not ended or is destroyed, in a call of `core`."""
        if self._state is not _ENDED or self.destroyed:
            state = "destroyed" if self.destroyed else self._state
            core.refuse(rules.QUERY_STATE, call, f"a query that is {state}", "a query that was ended")


class QueryScope(Scope):
    """A query between its begin and its end. Meanwhile it is its core's open query."""

    __slots__ = ()
    _core: Core

    def describe(self) -> str:
        """Return the scope's text in messages."""
        return "an occlusion query"

    def finish(self, failed: bool) -> None:
        """Pop the scope, the innermost one, and end the query."""
        core = self._core
        scopes = core.scopes
        index = (
            scopes._index - 1
        )  # from here on nothing may be interrupted before the `try`, so it calls nothing
        scopes._data[index] = None
        scopes._index = index
        core.open_query = None
        try:
            self.complete()
        except BaseException:  # whether it has ended or not
            self.abandon()
            raise

    def cut_off(self) -> None:
        """Pop the scope, the innermost one, and end the query without a result."""
        core = self._core
        scopes = core.scopes
        index = scopes._index - 1  # as above
        scopes._data[index] = None
        scopes._index = index
        core.open_query = None
        self.abandon()

    def complete(self) -> None:
        """End the query, as its scope ends."""
        raise NotImplementedError

    def abandon(self) -> None:
        """End the query without a result, as its pass ends."""
        raise NotImplementedError


class OcclusionQuery(PendingQuery[int], QueryScope):
    """A counter of the samples of draws between its begin and end that pass all tests.

    A query may be used any number of times; `begin` discards the earlier result. `with query:` begins and
    ends it.
    """

    __slots__ = "_checks"

    def __init__(self, core: Core, emulated: bool) -> None:
        super().__init__(core, 1, emulated, "device.occlusion_query")
        # Whether each call checks everything: an emulated query signals the fence, which must not reach
        # another context.
        self._checks = self.emulated or core.validates

    @property
    def id(self) -> Id:
        """The id of the query in the command stream; for an emulated query, the id of its second counter."""
        return self._ids[-1]

    def begin(self) -> None:
        """Begin counting; inside a render pass, one query at a time."""
        core, checks = self._core, self._checks
        if checks or core.closed:
            core.check_ready()
        if self.destroyed:
            core.refuse(rules.RESOURCE_DESTROYED, "OcclusionQuery.begin", "a destroyed query")
        if core.open_query is not None:
            core.refuse(rules.QUERY_NESTED, "OcclusionQuery.begin", "a second open query")
        if core.render_pass is None:
            core.refuse(rules.DRAW_OUTSIDE_PASS, "OcclusionQuery.begin", "no open pass")
        scopes = core.scopes
        index = scopes._index  # from here on nothing may be interrupted before the `try`, so it calls nothing
        try:
            scopes._data[index] = self
        except IndexError:
            scopes._data.append(self)
        scopes._index = index + 1
        core.open_query = self
        self._answer = None
        self._state = _OPEN
        try:
            if checks and scopes.records_lines:
                scopes.record_line()
            self.write_begin(core)
            if checks and self.emulated:
                core.signal()
        except BaseException:  # whether it has begun or not
            self.cut_off()
            raise
        core.counters.queries += 1

    def end(self) -> None:
        """End counting and flush submitted work to the GPU, so that the result becomes available."""
        core = self._core
        scopes = core.scopes
        if scopes._data[scopes._index - 1] is self:  # so it and its device are open
            if self._checks:
                core.check_ready()
            self.finish(False)
            return
        if self._state is not _OPEN:
            core.refuse(
                rules.QUERY_STATE, "OcclusionQuery.end", f"a query that is {self._state}", "an open query"
            )
        self._leave(None, again=True)

    def _leave(self, error: BaseException | None, *, again: bool) -> None:
        """End the query, which isn't the innermost scope."""
        core = self._core
        if core.closed:
            self._state = _ENDED
            return
        if self._checks:
            core.check_ready()
        core.scopes.leave(self, error, again=again)

    def complete(self) -> None:
        """End counting, as the query's scope ends."""
        core = self._core
        if self.emulated:
            self.write_end(core)
            self._fence = core.signal()
        else:
            core.backend.end_query(self._ids[0])  # as `write_end`, without its call
        self._state = _ENDED

    def abandon(self) -> None:
        """End the query without a result, as its pass ends."""
        self._state = _IDLE
        self.write_end(self._core)
        if self.emulated:
            self._fence = self._core.signal()

    def __enter__(self) -> Self:
        self.begin()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        core = self._core
        scopes = core.scopes
        if scopes._data[scopes._index - 1] is self:
            if self._checks:
                core.check_ready()
            self.finish(error is not None)
        elif self._state is _OPEN:
            self._leave(error, again=False)

    def _read(self) -> int | None:
        backend = self._core.backend
        if not self.emulated:
            return backend.read_query(self._ids[0])
        first, second = (backend.read_query(query) for query in self._ids)
        return None if first is None or second is None else second - first

    # -- in command buffers --------------------------------------------------------------------------------

    def check_usable(self, core: Core, call: str) -> None:
        """Refuse a destroyed query, and one of another device."""
        if self._core is not core:
            core.refuse(rules.RESOURCE_FOREIGN, call, describe_object(self))
        if self.destroyed:
            core.refuse(rules.RESOURCE_DESTROYED, call, "a destroyed query")

    def write_begin(self, core: Core) -> None:
        """Send the begin of the query to `core`: the device's, or a command buffer's."""
        if self.emulated:
            core.backend.write_query(self._ids[0])
        else:
            core.backend.begin_query(self._ids[0])

    def write_end(self, core: Core) -> None:
        """Send the end of the query to `core`."""
        if self.emulated:
            core.backend.write_query(self._ids[1])
        else:
            core.backend.end_query(self._ids[0])


class Conditional(Scope):
    """A `with device.conditional(query):` block, whose draws are executed only if the query counted
    samples."""

    __slots__ = ("_core", "_inverted", "_query")

    def __init__(self, core: Core, query: OcclusionQuery, inverted: bool) -> None:
        call = "device.conditional"
        if not core.capabilities.conditional_rendering:  # conditions are frequent, and this check is faster
            core.require(call, condition_faults(core.capabilities))
        if query.__class__ is not OcclusionQuery or inverted.__class__ is not bool:
            check = ArgumentChecker(call, core.refuse)
            check.instance("query", query, OcclusionQuery, "an OcclusionQuery from device.occlusion_query()")
            inverted = check.flag("inverted", inverted)
        if query.emulated:
            core.refuse(
                rules.DEVICE_CAPABILITY, call, "an emulated query", "a native one: device.occlusion_query()"
            )
        self._core = core
        self._query = query
        self._inverted = inverted

    def _check(self) -> None:
        core, query = self._core, self._query
        if query._state is not _ENDED or query.destroyed or query._core is not core:
            query.check_usable(core, "device.conditional")
            query.check_ended(core, "device.conditional")

    def __enter__(self) -> None:
        core = self._core
        core.check_scope()
        if core.condition_open:
            core.refuse(rules.CONDITION_NESTED, "device.conditional", "a condition inside another")
        self._check()
        core.scopes.push(self)
        core.condition_open = True
        try:
            core.backend.begin_conditional(self._query.id, self._inverted)
        except BaseException:  # whether it has begun or not
            self.cut_off()
            raise
        core.condition_count += 1

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        core = self._core
        if core.closed:
            return
        if core.thread != get_ident():
            core.check_thread("the end of a condition")
        scopes = core.scopes
        if scopes._data[scopes._index - 1] is self:
            self.finish(error is not None)
        else:
            scopes.leave(self, error)

    def describe(self) -> str:
        """Return the scope's text in messages."""
        return "a condition"

    def finish(self, failed: bool) -> None:
        """Pop the scope, the innermost one, and end the condition."""
        core = self._core
        scopes = core.scopes
        index = (
            scopes._index - 1
        )  # from here on nothing may be interrupted before the `try`, so it calls nothing
        scopes._data[index] = None
        scopes._index = index
        core.condition_open = False
        try:
            core.resume_scope()
            core.backend.end_conditional()
        except BaseException:  # whether it has ended or not
            core.backend.end_conditional()
            raise
