"""Occlusion queries and the timer tree (thesis 4.4, Listing 4.11).

- A query is native where the backend has them. Elsewhere, or when asked for, it is emulated as in the
  thesis (4.4.2): the GPU takes its running samples-passed counter at two fence values, the difference is the
  answer, and it is final once the second fence has completed.
- `is_finished` never blocks. `visible_samples` gives the answer of a finished query and refuses an
  unfinished one; `wait` blocks.
- Timers: each `device.event` takes two timestamps when timing is on. A frame's tree is read when all of its
  timestamps are there, without waiting; `device.timers` is the tree of the latest such frame.
"""

from __future__ import annotations

import time
from types import TracebackType
from typing import Final, Generic, Self, TypeVar

from rhi.contract.descriptors import Id, QueryKind
from rhi.device.core.core import Core, describe_object
from rhi.errors import DeviceError
from rhi.errors.rules import (
    CONDITION_NESTED,
    DEVICE_ANSWER,
    DEVICE_CAPABILITY,
    DRAW_OUTSIDE_PASS,
    QUERY_NESTED,
    QUERY_STATE,
    QUERY_UNFINISHED,
    RESOURCE_DESTROYED,
    RESOURCE_FOREIGN,
)

__rhi_internal__ = True

T = TypeVar("T")

ANSWER_SECONDS: Final = 10.0
"""How long after its fence a query's answer may be late."""
_IDLE, _OPEN, _ENDED = "not begun", "open", "ended"


class PendingQuery(Generic[T]):
    """What a query and a set of queries have in common: an answer that comes some time after its end."""

    __slots__ = ("_answer", "_core", "_fence", "_ids", "_state", "destroyed", "emulated")

    def __init__(self, core: Core, count: int, emulated: bool, call: str) -> None:
        """For `count` OCCLUSION queries or, emulated, one COUNTER more."""
        capabilities = core.capabilities
        self.emulated = emulated or not capabilities.occlusion_queries
        if self.emulated and not capabilities.sample_counter:
            core.refuse(DEVICE_CAPABILITY, call, "an emulated query", "needs capabilities.sample_counter")
        self._core = core
        self._ids: list[Id] = []
        kind = QueryKind.COUNTER if self.emulated else QueryKind.OCCLUSION
        try:
            for _ in range(count + self.emulated):
                query = core.create_id()
                core.backend.create_query(query, kind)
                self._ids.append(query)
        except BaseException:
            for query in self._ids:
                core.timeline.retire(query)
            raise
        self._state = _IDLE
        self._answer: T | None = None
        self._fence = 0
        self.destroyed = False

    @property
    def ids(self) -> tuple[Id, ...]:
        """All its names in the command stream."""
        return tuple(self._ids)

    @property
    def core(self) -> Core:
        """Its device's."""
        return self._core

    @property
    def label(self) -> str:
        """It has none."""
        return ""

    @property
    def is_finished(self) -> bool:
        """Whether the answer is there; never blocks. False where nothing was asked."""
        if self._answer is None and self._state is _ENDED and not self.destroyed:
            self._core.check_open()
            if not self.emulated or self._core.timeline.completed >= self._fence:
                self._answer = self._read()
        return self._answer is not None

    @property
    def visible_samples(self) -> T:
        """The answer, once it is there.

        Raises:
            ValidationError: `query-unfinished` while it isn't, `query-state` if there is none to come.
        """
        if not self.is_finished:
            call = f"{type(self).__name__}.visible_samples"
            self.check_ended(self._core, call)
            self._core.refuse(QUERY_UNFINISHED, call, "an unfinished query")
        assert self._answer is not None
        return self._answer

    def wait(self) -> T:
        """Block until the answer is there.

        Raises:
            DeviceError: `device-no-answer` if it isn't, 10 s after the GPU has passed the query's end.
        """
        if not self.is_finished:
            call = f"{type(self).__name__}.wait"
            self.check_ended(self._core, call)
            self._core.timeline.wait(self._fence if self.emulated else self._core.signal())
            deadline = time.monotonic() + ANSWER_SECONDS
            while not self.is_finished:  # a driver may publish the result a moment after the fence
                if time.monotonic() > deadline:
                    given = (
                        f"query {self._ids[-1]}: no answer {ANSWER_SECONDS:g} s after the GPU passed its end"
                    )
                    self._core.refusals.fail(DeviceError(DEVICE_ANSWER, call, given))
                time.sleep(0)
        assert self._answer is not None
        return self._answer

    def destroy(self) -> None:
        """Give it back; an open query can't be destroyed."""
        if self._state is _OPEN:
            self._core.refuse(
                QUERY_STATE, f"{type(self).__name__}.destroy", "an open query", "a query that was ended"
            )
        if not self.destroyed:
            self.destroyed = True
            for query in self._ids:
                self._core.timeline.retire(query)

    def forget(self) -> None:
        """What is asked now isn't what was asked before."""
        self._answer = None
        self._state = _IDLE

    def mark_submitted(self, fence: int) -> None:
        """It was asked, all before `fence`."""
        self._answer = None
        self._state = _ENDED
        self._fence = fence

    def _read(self) -> T | None:
        """The answer, or None while it isn't there."""
        raise NotImplementedError

    def check_ended(self, core: Core, call: str) -> None:
        """Refuse a query that has no answer to come, in a call of `core`."""
        if self._state is not _ENDED or self.destroyed:
            state = "destroyed" if self.destroyed else self._state
            core.refuse(QUERY_STATE, call, f"a query that is {state}", "a query that was ended")


class OcclusionQuery(PendingQuery[int]):
    """How many samples of the draws between begin and end passed all tests.

    One object may be used again and again; begin forgets the earlier answer. `with query:` is begin and end.
    """

    __slots__ = ()

    def __init__(self, core: Core, emulated: bool) -> None:
        super().__init__(core, 1, emulated, "device.occlusion_query")

    @property
    def id(self) -> Id:
        """Its name in the command stream (of an emulated query, the second counter's)."""
        return self._ids[-1]

    def begin(self) -> None:
        """Count from here; inside a render pass, one query at a time."""
        core = self._core
        core.check_open()
        if self.destroyed:
            self._core.refuse(RESOURCE_DESTROYED, "OcclusionQuery.begin", "a destroyed query")
        if core.open_query is not None:
            self._core.refuse(QUERY_NESTED, "OcclusionQuery.begin", "a second open query")
        if core.render_pass is None:
            self._core.refuse(DRAW_OUTSIDE_PASS, "OcclusionQuery.begin", "no open pass")
        self.write_begin(core)
        if self.emulated:
            core.signal()
        self._answer = None
        self._state = _OPEN
        core.open_query = self
        core.counters.queries += 1

    def end(self) -> None:
        """Stop counting and let the GPU start on what was submitted, so that the answer can come."""
        if self._state is not _OPEN:
            self._core.refuse(
                QUERY_STATE, "OcclusionQuery.end", f"a query that is {self._state}", "an open query"
            )
        self._core.open_query = None
        self._finish()
        self._state = _ENDED

    def _finish(self) -> None:
        core = self._core
        if core.closed:
            return
        self.write_end(core)
        if self.emulated:
            self._fence = core.signal()

    def abandon(self) -> None:
        """End it without an answer, as its pass ends."""
        self._finish()
        self._state = _IDLE

    def __enter__(self) -> Self:
        self.begin()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._state is _OPEN:
            self.end()

    def _read(self) -> int | None:
        backend = self._core.backend
        if not self.emulated:
            return backend.read_query(self._ids[0])
        first, second = (backend.read_query(query) for query in self._ids)
        return None if first is None or second is None else second - first

    # -- in command buffers --------------------------------------------------------------------------------

    def check_usable(self, core: Core, call: str) -> None:
        """Refuse another device's query, and a destroyed one."""
        if self._core is not core:
            core.refuse(RESOURCE_FOREIGN, call, describe_object(self))
        if self.destroyed:
            core.refuse(RESOURCE_DESTROYED, call, "a destroyed query")

    def write_begin(self, core: Core) -> None:
        """Command `core` to begin counting."""
        if self.emulated:
            core.backend.write_query(self._ids[0])
        else:
            core.backend.begin_query(self._ids[0])

    def write_end(self, core: Core) -> None:
        """Command `core` to end counting."""
        if self.emulated:
            core.backend.write_query(self._ids[1])
        else:
            core.backend.end_query(self._ids[0])


class Conditional:
    """`with device.conditional(query):` draws happen only if the query counted samples."""

    __slots__ = ("_core", "_inverted", "_query")

    def __init__(self, core: Core, query: OcclusionQuery, inverted: bool) -> None:
        call = "device.conditional"
        if not core.capabilities.conditional_rendering:
            core.refuse(
                DEVICE_CAPABILITY, call, "conditional rendering", "needs capabilities.conditional_rendering"
            )
        if query.emulated:
            core.refuse(
                DEVICE_CAPABILITY, call, "an emulated query", "a native one: device.occlusion_query()"
            )
        self._core = core
        self._query = query
        self._inverted = inverted

    def _check(self) -> None:
        self._query.check_ended(self._core, "device.conditional")

    def __enter__(self) -> None:
        core = self._core
        core.check_open()
        if core.condition_open:
            core.refuse(CONDITION_NESTED, "device.conditional", "a condition inside another")
        self._check()
        core.backend.begin_conditional(self._query.id, self._inverted)
        core.condition_open = True
        core.condition_count += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._core.condition_open = False
        if not self._core.closed:
            self._core.backend.end_conditional()
