"""Occlusion queries and timestamps.

Each submission uses its own query sets, from a pool. Their results are copied to a buffer that is mapped once
they are there, and stored at the next submission, whether or not anybody reads them: so the pool stays small.
A query that lies in several segments is the sum of a slot in each.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from rhi.backends.webgpu.command_encoder import Stream
from rhi.backends.webgpu.implementation import GpuObject, Handle, Mappings
from rhi.backends.webgpu.webgpu_buffers import READ
from rhi.backends.webgpu.webgpu_errors import translate_errors
from rhi.backends.webgpu.webgpu_flags import GpuBufferUsage
from rhi.contract.descriptors import Id, QueryKind
from rhi.contract.interrupts import DeferredInterrupts

_SLOTS: Final = 1024
_SPARE: Final = 64
"""Free slots that a set needs when a segment begins; otherwise the segment begins a new submission."""


class _Query:
    """A query. `use` counts its uses, so that late results of an earlier use are dropped."""

    __slots__ = ("kind", "missing", "open", "result", "sum", "use")

    def __init__(self, kind: QueryKind) -> None:
        self.kind = kind
        self.result: int | None = None
        self.use = 0
        self.missing = 0
        self.sum = 0
        self.open = False

    def begin(self, stays_open: bool) -> None:
        self.use += 1
        self.result = None
        self.sum = 0
        self.missing = 0
        self.open = stays_open


class _SlotSet:
    """A query set, the buffer that it is resolved to, and the buffer that is mapped."""

    def __init__(self, device: GpuObject, kind: str) -> None:
        with translate_errors("device.query", memory=True):
            self.object = device.create_query_set(type=kind, count=_SLOTS)
            usage = GpuBufferUsage.QUERY_RESOLVE | GpuBufferUsage.COPY_SRC
            self.resolved = device.create_buffer(size=8 * _SLOTS, usage=usage)
            self.mapped = device.create_buffer(size=8 * _SLOTS, usage=READ)
        self.kind = kind
        self.slots: list[tuple[_Query, int]] = []  # the query of each slot, and its use


class Queries:
    """The queries of a device."""

    def __init__(self, device: GpuObject, stream: Stream, mappings: Mappings, times_passes: bool) -> None:
        """`times_passes`: whether timestamps can be written inside passes."""
        self._device = device
        self._stream = stream
        self._mappings = mappings
        self._times_passes = times_passes
        self._implementation = stream.implementation
        self._period = self._implementation.timestamp_period(device)
        self._queries: dict[Id, _Query] = {}
        self._free: dict[str, list[_SlotSet]] = {"occlusion": [], "timestamp": []}
        self._current: dict[str, _SlotSet] = {}
        self._resolved: list[_SlotSet] = []
        self._waiting: deque[tuple[int, _SlotSet]] = deque()
        self._active: _Query | None = None
        self._running = False
        stream.before_submit.append(self._resolve)
        stream.after_submit.append(self._map)
        stream.query_set = self._occlusion_set
        stream.on_begin.append(self._begin_slot)
        stream.on_end.append(self._end_slot)

    def create(self, query: Id, kind: QueryKind) -> None:
        self._queries[query] = _Query(kind)

    def destroy(self, query: Id) -> None:
        del self._queries[query]

    # -- commands ----------------------------------------------------------------------------------------

    def begin(self, query: Id) -> None:
        if self._active is not None:  # an interrupt came before its end
            self._end(self._active)
        self._active = self._queries[query]
        self._active.begin(True)
        if self._stream.render is not None:
            self._begin_slot()

    def end(self, query: Id) -> None:
        self._end(self._queries[query])

    def _end(self, ended: _Query) -> None:
        self._end_slot()
        self._active = None
        ended.open = False
        if not ended.missing:
            ended.result = ended.sum

    def write(self, query: Id) -> None:
        """Write a timestamp."""
        if len(self._set("timestamp").slots) >= _SLOTS:
            self._stream.submit()
        written = self._queries[query]
        written.begin(False)
        current = self._set("timestamp")
        slot = self._take(current, written)
        if self._times_passes and self._stream.render is not None:
            self._implementation.write_pass_timestamp(self._stream.render, current.object._internal, slot)
        else:
            encoder = self._stream.outside()
            self._implementation.write_timestamp(encoder._internal, current.object._internal, slot)

    def read(self, query: Id) -> int | None:
        state = self._queries[query]
        if state.result is None and not state.open:
            if state.missing and not self._waiting_for(state) and self._stream.pass_ is None:
                self._stream.submit()  # polling is enough for a result
            self.collect()
        return state.result

    def _waiting_for(self, query: _Query) -> bool:
        return not any(query is owner for owned in self._current.values() for owner, _ in owned.slots)

    # -- slots -------------------------------------------------------------------------------------------

    def _set(self, kind: str) -> _SlotSet:
        if kind not in self._current:
            free = self._free[kind]
            self._current[kind] = free.pop() if free else _SlotSet(self._device, kind)
        return self._current[kind]

    def _take(self, owner: _SlotSet, query: _Query) -> int:
        owner.slots.append((query, query.use))
        query.missing += 1
        return len(owner.slots) - 1

    def _occlusion_set(self) -> Handle:
        """Return the set of a render pass that begins."""
        return self._set("occlusion").object._internal

    @property
    def is_full(self) -> bool:
        """True if the next pass should begin a submission, and with it another set."""
        return "occlusion" in self._current and len(self._current["occlusion"].slots) > _SLOTS - _SPARE

    @property
    def is_idle(self) -> bool:
        """True if no query is open."""
        return self._active is None

    def _begin_slot(self) -> None:
        if self._active is None or self._running:
            return
        if len(self._set("occlusion").slots) >= _SLOTS:
            self._stream.submit()
            self._stream.begin_segment()  # calls this again
            return
        with DeferredInterrupts():
            self._implementation.begin_occlusion_query(
                self._stream.render, self._take(self._set("occlusion"), self._active)
            )
            self._running = True

    def _end_slot(self) -> None:
        if self._running:
            with DeferredInterrupts():
                self._implementation.end_occlusion_query(self._stream.open_pass)
                self._running = False

    # -- results -----------------------------------------------------------------------------------------

    def _resolve(self) -> None:
        self._store_results()
        for kind, current in list(self._current.items()):
            count = len(current.slots)
            if count:
                encoder = self._stream.encoder()
                encoder.resolve_query_set(current.object, 0, count, current.resolved, 0)
                encoder.copy_buffer_to_buffer(current.resolved, 0, current.mapped, 0, 8 * count)
                self._resolved.append(current)
                del self._current[kind]

    def _map(self, submission: int) -> None:
        for owner in self._resolved:
            self._waiting.append((self._mappings.begin(owner.mapped, 8 * len(owner.slots)), owner))
        self._resolved.clear()

    def collect(self) -> None:
        """Store the results that are available."""
        if self._waiting:
            self._stream.fence.process()
        self._store_results()

    def _store_results(self) -> None:
        """Store the results of the sets that are mapped, and put the sets back into the pool."""
        while self._waiting and self._mappings.is_done(self._waiting[0][0]):
            with DeferredInterrupts():
                self._store_set(*self._waiting.popleft())

    def _store_set(self, ticket: int, owner: _SlotSet) -> None:
        with translate_errors("read_query"):
            data = self._mappings.end(ticket, owner.mapped, 0, 8 * len(owner.slots))
        scale = self._period if owner.kind == "timestamp" else 1
        for (query, use), value in zip(owner.slots, np.frombuffer(data, np.uint64).tolist(), strict=True):
            if query.use == use:
                query.sum += int(value * scale)
                query.missing -= 1
                if not query.missing and not query.open:
                    query.result = query.sum
        owner.slots.clear()
        self._free[owner.kind].append(owner)
