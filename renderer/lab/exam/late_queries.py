"""Late query results: a query isn't finished before it has been checked so many times."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from rhi import OcclusionQuery, QuerySet

_PATIENCE: Final = 10.0  # seconds, for a device whose queries never finish
_BEGIN_METHODS: Final[tuple[tuple[Any, str], ...]] = ((OcclusionQuery, "begin"), (QuerySet, "draw"))


@contextmanager
def late_query_results(looks: int) -> Iterator[None]:
    """Delay each query and query set of this process until `is_finished` was read `looks` times, regardless
    of how fast the GPU is. Waiting for a result always works."""
    late = delay_methods(looks)
    attributes = [(kind, name, kind.__dict__.get(name)) for kind, name, _ in late]
    for kind, name, method in late:
        setattr(kind, name, method)
    try:
        yield
    finally:
        for kind, name, method in attributes:
            if method is None:  # inherited
                delattr(kind, name)
            else:
                setattr(kind, name, method)


def delay_methods(looks: int) -> list[tuple[Any, str, Any]]:
    """The methods that delay query results, each with its class and name."""
    left: dict[int, int] = {}
    return [method for kind, begins in _BEGIN_METHODS for method in _delay(kind, begins, looks, left)]


def _delay(kind: Any, begins: str, looks: int, left: dict[int, int]) -> list[tuple[Any, str, Any]]:
    begin, wait, look = getattr(kind, begins), kind.wait, kind.is_finished.fget

    def begin_late(query: Any, *arguments: object) -> object:
        left[query.id] = looks
        return begin(query, *arguments)

    def is_finished(query: Any) -> bool:
        if left[query.id] > 0:
            left[query.id] -= 1
            return False
        if not look(query):  # in an open pass, looking doesn't submit it everywhere
            query.core.timeline.wait(query.core.signal())
        deadline = time.monotonic() + _PATIENCE
        while not look(query) and time.monotonic() < deadline:
            pass
        return bool(look(query))

    def wait_late(query: Any) -> object:
        left[query.id] = 0
        return wait(query)

    return [
        (kind, begins, begin_late),
        (kind, "is_finished", property(is_finished)),
        (kind, "wait", wait_late),
    ]
