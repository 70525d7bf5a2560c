"""Answers that come late: each query is looked at so many times before its answer is there."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from rhi import OcclusionQuery, QuerySet

_PATIENCE: Final = 10.0  # seconds, for a device that never answers
_BEGINS: Final[tuple[tuple[Any, str], ...]] = ((OcclusionQuery, "begin"), (QuerySet, "draw"))


@contextmanager
def late_answers(looks: int) -> Iterator[None]:
    """Let every query and query set of this process be looked at (`is_finished`) so many times before its answer is
    there, and no more often, as quick or slow as the GPU may be; waiting for it always helps."""
    late = delay_methods(looks)
    own = [(kind, name, kind.__dict__.get(name)) for kind, name, _ in late]
    for kind, name, method in late:
        setattr(kind, name, method)
    try:
        yield
    finally:
        for kind, name, method in own:
            if method is None:  # it is inherited
                delattr(kind, name)
            else:
                setattr(kind, name, method)


def delay_methods(looks: int) -> list[tuple[Any, str, Any]]:
    """Return the methods that delay answers: each with its class and its name."""
    left: dict[int, int] = {}
    return [method for kind, begins in _BEGINS for method in _delay(kind, begins, looks, left)]


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

    return [(kind, begins, begin_late), (kind, "is_finished", property(is_finished)), (kind, "wait", wait_late)]
