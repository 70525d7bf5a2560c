"""Results of queries, on a device that rasterises nothing.

- Answers come from a number, a script, a mapping by query, a function, or a run on another backend.
- An answer belongs to one use of a query: its n-th begin (for a counter, its n-th write).
- `AnswerLog` is a backend in front of another that records the answers of its queries. Ids are assigned in
  the order of creation, so the same program uses the same ids on the null device.
- None means that the answer is unknown. It is never treated as zero.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from rhi.commands.recorder import ForwardingBackend
from rhi.contract.backend import Backend
from rhi.contract.descriptors import Id
from rhi.errors.data_classes import dataclass


@dataclass(frozen=True)
class RecordedAnswers:
    """The answers of queries in another run: samples by (query, n-th use, from 0)."""

    samples: Mapping[tuple[Id, int], int]

    def save(self, path: str | Path) -> None:
        """Write the answers as JSON: a list of [query, use, samples]."""
        rows = [[query, use, samples] for (query, use), samples in sorted(self.samples.items())]
        Path(path).write_text(json.dumps(rows), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> RecordedAnswers:
        """Read a file that `save` wrote."""
        rows = json.loads(Path(path).read_text(encoding="utf-8"))
        return cls({(int(query), int(use)): int(samples) for query, use, samples in rows})


Answers: TypeAlias = (
    int | Sequence[int | None] | Mapping[Id, int] | Callable[[Id], int | None] | RecordedAnswers
)
"""Samples of queries: one number for all; a script, in the order in which OCCLUSION queries end; a mapping by
query id; a function of the id; or the answers of another run. None, a missing key and the end of a script
mean unknown."""

AnswerFunction: TypeAlias = Callable[[Id, int, int], object]
"""A function (query id, number of its use, index among the ended queries or −1) → samples."""


def make_answer_function(answers: Answers) -> AnswerFunction:
    """Return answers of any form as one function, which returns None for unknown answers."""
    answer: Any = answers
    if isinstance(answers, RecordedAnswers):
        return lambda query, use, result_index: answers.samples.get((query, use))
    if callable(answers):
        return lambda query, use, result_index: answer(query)
    if isinstance(answers, Mapping):
        return lambda query, use, result_index: answer.get(query)
    if isinstance(answers, Sequence) and not isinstance(answers, str):
        script = tuple(answers)
        return lambda query, use, result_index: (
            script[result_index] if 0 <= result_index < len(script) else None
        )
    return lambda query, use, result_index: answer


class AnswerLog(ForwardingBackend):
    """A backend in front of another that records the answers of its queries:
    `rhi.Device(AnswerLog(backend))`.

    Only answers that the program reads are recorded. If a query begins twice and is read once, one use stays
    unknown.
    """

    def __init__(self, backend: Backend) -> None:
        super().__init__(backend)
        self._uses: Counter[Id] = Counter()
        self._samples: dict[tuple[Id, int], int] = {}

    @property
    def answers(self) -> RecordedAnswers:
        """The answers so far."""
        return RecordedAnswers(self._samples.copy())

    def begin_query(self, query: Id) -> None:
        self.backend.begin_query(query)
        self._uses[query] += 1

    def write_query(self, query: Id) -> None:
        self.backend.write_query(query)
        self._uses[query] += 1

    def read_query(self, query: Id) -> int | None:
        answer = self.backend.read_query(query)
        if answer is not None:
            self._samples[query, self._uses[query] - 1] = answer
        return answer
