"""Queries, on a device that rasterises nothing: the caller provides the numbers of samples.

- `count_samples(f)`: `f(draw)` returns the samples that a draw passes. They are added to the running counter
  (COUNTER queries) and to OCCLUSION queries, so emulated queries work as on hardware.
- `answer_queries(a)`: gives the answers themselves (`answers`).
- Reading an answer that is still unknown is refused (`null-samples`); it is never zero. It is known to be
  zero where no draw was executed.
- A counter that has passed a draw with unknown samples stays unknown: differences of its values would be
  wrong.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence

from rhi.backends.null.answers import AnswerFunction, Answers, RecordedAnswers, make_answer_function
from rhi.backends.null.null_draws import Draw
from rhi.contract.descriptors import Id, QueryKind
from rhi.errors import refuse
from rhi.errors.rules import NULL_ANSWER, NULL_SAMPLES


class _QueryState:
    """A query: its kind, its value, and how often it was used."""

    __slots__ = ("end_order", "finished", "kind", "use", "value")

    def __init__(self, kind: QueryKind) -> None:
        self.kind = kind
        self.finished = False
        self.value: int | None = None  # None if unknown
        self.use = -1  # number of the latest begin or write
        self.end_order = -1  # number of the latest end among the ends of all OCCLUSION queries


class Queries:
    """The queries of a device, by id.

    Attributes:
        passed: the number of samples that are known to have passed.
        unknown: the number of draws with unknown samples.
    """

    def __init__(self) -> None:
        self.passed = 0
        self.unknown = 0
        self._queries: dict[Id, _QueryState] = {}
        self._open: _QueryState | None = None
        self._counter: int | None = 0
        self._samples: Callable[[Draw], int | None] | None = None
        self._answers: AnswerFunction = lambda query, use, end_order: None
        self._ended = 0

    def count_samples(self, samples: Callable[[Draw], int | None] | None) -> None:
        self._samples = samples

    def answer(self, answers: Answers) -> None:
        if not (callable(answers) or isinstance(answers, (Mapping, Sequence, RecordedAnswers))):
            _check_samples("answer_queries", answers)
        self._answers = make_answer_function(answers)

    @property
    def counts(self) -> bool:
        """True if draws must be passed to `add_draw` one by one."""
        return self._samples is not None

    @property
    def counter(self) -> int | None:
        """The running counter of samples; None after a draw with unknown samples."""
        return self._counter

    def kind(self, query: Id) -> QueryKind:
        return self._queries[query].kind

    # -- commands ----------------------------------------------------------------------------------------

    def create_query(self, query: Id, kind: QueryKind) -> None:
        self._queries[query] = _QueryState(kind)

    def destroy(self, resource: Id) -> None:
        self._queries.pop(resource, None)

    def begin_query(self, query: Id) -> None:
        self._open = opened = self._queries[query]
        opened.finished, opened.value = False, 0
        opened.use += 1

    def end_query(self, query: Id) -> None:
        ended = self._queries[query]
        ended.finished = True
        ended.end_order = self._ended
        self._ended += 1
        self._open = None

    def write_query(self, query: Id, nanoseconds: int) -> None:
        """Write the counter's value, or for a TIMESTAMP the time in `nanoseconds`."""
        written = self._queries[query]
        written.finished = True
        written.use += 1
        written.value = nanoseconds if written.kind is QueryKind.TIMESTAMP else self._counter

    def begin_write(self, query: Id) -> None:
        """Mark a COUNTER as written, with a value that `finish_write` sets later."""
        written = self._queries[query]
        written.finished = False
        written.use += 1

    def finish_write(self, query: Id, counter: int | None) -> None:
        """Set the value of a COUNTER that `begin_write` marked; None if unknown."""
        taken = self._queries[query]
        taken.finished, taken.value = True, counter

    def add_draw(self, draw: Draw) -> None:
        """Count the samples of an executed draw."""
        samples = None
        try:
            if self._samples is not None:
                samples = _check_samples("count_samples", self._samples(draw))
        finally:  # also if that raised: from here on the count lacks a draw
            if samples is None:
                self.add_unknown()
        if samples is None:
            return
        self.passed += samples
        if self._counter is not None:
            self._counter += samples
        if self._open is not None and self._open.value is not None:
            self._open.value += samples

    def add_unknown(self) -> None:
        """Count a draw with unknown samples."""
        self.unknown += 1
        self._counter = None
        if self._open is not None:
            self._open.value = None

    # -- answers -----------------------------------------------------------------------------------------

    def samples(self, query: Id) -> int | None:
        """Return the samples that a query counted, None if they are unknown or the query is unfinished."""
        state = self._queries[query]
        if not state.finished:
            return None
        given = _check_samples("answer_queries", self._answers(query, state.use, state.end_order))
        return state.value if given is None else given

    def read(self, query: Id) -> int | None:
        """Return the answer of a query, None while it is unfinished.

        Raises:
            ValidationError: `null-samples` if the query is finished but its answer is unknown.
        """
        state = self._queries[query]
        if not state.finished:
            return None
        if state.kind is QueryKind.TIMESTAMP:
            return state.value
        samples = self.samples(query)
        if samples is None:
            refuse(NULL_SAMPLES, f"the answer of {state.kind.value} query {query}")
        return samples


def _check_samples(call: str, samples: object) -> int | None:
    if samples is None:
        return None
    try:
        count = operator.index(samples)  # type: ignore[arg-type]  # NumPy's integers too
    except TypeError:
        count = -1
    if count < 0:
        refuse(NULL_ANSWER, call, samples, "an integer of 0 or more, or None if unknown")
    return count
