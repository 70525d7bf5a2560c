"""Functions applied to many values in threads, or one after another where Python has no threads: in a page."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from os import cpu_count
from typing import Final, TypeVar

T = TypeVar("T")
R = TypeVar("R")
_MAX_THREADS: Final = 16


@contextmanager
def map_in_threads(function: Callable[[T], R], values: Iterable[T]) -> Iterator[Iterator[R]]:
    """Yield the results of a function, in order, computed in as many threads as there are processors.

    If the block fails, calls that haven't begun are cancelled.
    """
    if sys.platform == "emscripten":
        yield map(function, values)
        return
    with ThreadPoolExecutor(min(cpu_count() or 1, _MAX_THREADS)) as pool:
        try:
            yield pool.map(function, values)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
