"""Queries and the fence, on a device that rasterises nothing: who knows what is seen has to say so.

- `count_samples(f)`: `f(draw)` gives the samples that a draw passes. It feeds the running counter (COUNTER
  queries) and the counts of OCCLUSION queries, so emulated queries work as on hardware.
- `answer_queries(a)`: the answers themselves, in place of a count (`visibility`).
- What neither knows is refused when it is read (`null-samples`); it is never zero. Zero is known without
  help where no draw was executed.
- A counter that has passed an unknown draw stays unknown: the difference of two values would be wrong.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence

from rhi.backends.null.answers import Answers, Oracle, RecordedAnswers, make_oracle
from rhi.backends.null.draws import Draw
from rhi.contract.descriptors import Id, QueryKind
from rhi.errors import refuse
from rhi.errors.rules import NULL_ANSWER, NULL_SAMPLES

__rhi_internal__ = True


class _QueryState:
    __slots__ = ("finished", "kind", "place", "use", "value")

    def __init__(self, kind: QueryKind) -> None:
        self.kind = kind
        self.finished = False
        self.value: int | None = None  # None: not known
        self.use = -1  # how often it was begun or written, less one
        self.place = -1  # of its latest end among all ends of OCCLUSION queries


class Queries:
    """All queries of a device, by id.

    Attributes:
        passed: all samples known to have passed.
        unknown: draws of which nobody could say what they passed.
    """

    def __init__(self) -> None:
        self.passed = 0
        self.unknown = 0
        self._queries: dict[Id, _QueryState] = {}
        self._open: _QueryState | None = None
        self._counter: int | None = 0
        self._samples: Callable[[Draw], int | None] | None = None
        self._oracle: Oracle = lambda query, use, place: None
        self._ended = 0

    def count_samples(self, samples: Callable[[Draw], int | None] | None) -> None:
        self._samples = samples

    def answer(self, answers: Answers) -> None:
        if not (callable(answers) or isinstance(answers, (Mapping, Sequence, RecordedAnswers))):
            _check_samples("answer_queries", answers)
        self._oracle = make_oracle(answers)

    @property
    def counts(self) -> bool:
        """Whether draws must be passed to `add_draw` one by one."""
        return self._samples is not None

    @property
    def counter(self) -> int | None:
        """The running counter of samples, None since it passed a draw that nobody knows."""
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
        ended.place = self._ended
        self._ended += 1
        self._open = None

    def write_query(self, query: Id, nanoseconds: int) -> None:
        """Take the counter, or the time, which is `nanoseconds`."""
        written = self._queries[query]
        written.finished = True
        written.use += 1
        written.value = nanoseconds if written.kind is QueryKind.TIMESTAMP else self._counter

    def expect(self, query: Id) -> None:
        """A counter that will be taken later."""
        written = self._queries[query]
        written.finished = False
        written.use += 1

    def take(self, query: Id, counter: int | None) -> None:
        """What the counter was when it was taken, None if nobody knows."""
        taken = self._queries[query]
        taken.finished, taken.value = True, counter

    def add_draw(self, draw: Draw) -> None:
        """Count the samples of an executed draw."""
        samples = None
        try:
            if self._samples is not None:
                samples = _check_samples("count_samples", self._samples(draw))
        finally:  # also when that raised: the count would miss a draw from here on
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
        """A draw of which nobody can say what it passed."""
        self.unknown += 1
        self._counter = None
        if self._open is not None:
            self._open.value = None

    # -- answers -----------------------------------------------------------------------------------------

    def samples(self, query: Id) -> int | None:
        """The samples a query counted, None if nobody knows (or it is unfinished)."""
        asked = self._queries[query]
        if not asked.finished:
            return None
        given = _check_samples("answer_queries", self._oracle(query, asked.use, asked.place))
        return asked.value if given is None else given

    def read(self, query: Id) -> int | None:
        """The answer, None while it isn't there; `null-samples` if it is there but not known."""
        asked = self._queries[query]
        if not asked.finished:
            return None
        if asked.kind is QueryKind.TIMESTAMP:
            return asked.value
        samples = self.samples(query)
        if samples is None:
            refuse(NULL_SAMPLES, f"the answer of {asked.kind.value} query {query}")
        return samples


def _check_samples(call: str, samples: object) -> int | None:
    if samples is None:
        return None
    try:
        count = operator.index(samples)  # type: ignore[arg-type]  # NumPy's integers too
    except TypeError:
        count = -1
    if count < 0:
        refuse(NULL_ANSWER, call, samples, "an integer of 0 or more, or None for what is not known")
    return count
