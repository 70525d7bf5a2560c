"""Checked memory: every buffer of the OpenCL backend lies between guards, and writes there are found.

- `install` makes buffers host memory that kernels use in place, with `GUARD` bytes of a pattern before and behind.
- The backend's own padding behind a buffer, for loads that run past the end, holds the pattern too. Scratch memory is
  exactly as large as requested.
- `find_writes` returns where the pattern has changed.

As a plugin it watches any tests:

    PYTHONPATH=tests/meta python -m pytest -p memory_guards --pyargs rhi.conformance --rhi-backend cl
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from rhi.backends.cl.context import ClContext, allocate_pages
from rhi.backends.cl.memory import buffers, planes, textures
from rhi.backends.cl.memory import pools as memory
from rhi.backends.cl.raster import queries

GUARD: Final = 1 << 14
PATTERN: Final = 0xB7
_flags: Final = cl.mem_flags
_Buffer: Final[Any] = cl.Buffer


class _Guarded:
    """Memory between guards. `asked`: its size in bytes; `whole`: with the guards."""

    def __init__(self, size: int) -> None:
        self.whole = allocate_pages(size + 2 * GUARD)
        self.whole[:] = PATTERN
        self.used = self.whole[GUARD : GUARD + size]
        self.used[:] = 0
        self.asked = size
        self.owner: weakref.ref[Any] | None = None

    def keep_free(self, asked: int) -> None:
        """Make everything behind the first `asked` bytes part of the guard."""
        self.used[asked:] = PATTERN
        self.asked = asked

    def find_write(self) -> str:
        """Return where the pattern has changed; empty if it hasn't."""
        begin, end = GUARD, GUARD + self.asked
        places = np.concatenate(
            [np.flatnonzero(self.whole[:begin] != PATTERN), end + np.flatnonzero(self.whole[end:] != PATTERN)]
        )
        if not len(places):
            return ""
        first, last = (int(place) - begin for place in (places[0], places[-1]))
        return f"{len(places)} bytes from {first} to {last} of a buffer of {self.asked}"


_known: list[_Guarded] = []


class _GuardedBuffer(_Buffer):  # type: ignore[misc]
    def __init__(self, context: cl.Context, flags: int, size: int = 0, hostbuf: Any = None) -> None:
        if flags & _flags.USE_HOST_PTR:  # from `_allocate_pages`
            super().__init__(context, flags, size, hostbuf)
            return
        made = _Guarded(size or memoryview(hostbuf).nbytes)
        if flags & _flags.COPY_HOST_PTR:
            made.used[:] = np.frombuffer(memoryview(hostbuf).cast("B"), np.uint8)
            flags &= ~_flags.COPY_HOST_PTR
        super().__init__(context, flags | _flags.USE_HOST_PTR, hostbuf=made.used)
        self.guarded = made
        made.owner = weakref.ref(self)
        _known.append(made)


def _allocate_pages(size: int) -> NDArray[np.uint8]:
    made = _Guarded(size)
    _known.append(made)
    return made.used


def _allocate(context: ClContext, size: int) -> Any:
    made = _unguarded_allocate(context, size)
    context.queue.finish()  # it is being cleared
    made.guarded.keep_free(size)
    return made


def _reserve(self: memory.Pool, size: int) -> int:
    """Reserve exactly `size` bytes, in new memory."""
    made: Any = memory.allocate_raw(self._context, size)
    self._context.queue.finish()
    made.guarded.keep_free(size)
    if self._memory is not None:
        self._retired.add(self._memory)
    self._memory, self.size, self._address = made, size, self._addresses.find(made)
    return self._address


_unguarded_allocate: Final = planes.allocate


def install(replace: Callable[[Any, str, Any], None] = setattr) -> None:
    """Guard all buffers created from here on; `replace` sets an attribute, for instance `monkeypatch.setattr`."""
    _known.clear()
    replace(cl, "Buffer", _GuardedBuffer)
    for module in (buffers, textures):
        replace(module, "allocate", _allocate)
    replace(memory.Pool, "reserve", _reserve)
    for module in (buffers, memory, queries):
        replace(module, "allocate_pages", _allocate_pages)


def find_writes() -> list[str]:
    """Return the writes outside of buffers, each once."""
    found = []
    for made in list(_known):
        told = made.find_write()
        if told:
            found.append(told)
        if told or (made.owner is not None and made.owner() is None):
            _known.remove(made)
    return found


def count_guarded() -> int:
    """Return the number of guarded buffers."""
    return len(_known)


# -- as a plugin ---------------------------------------------------------------------------------------------


def pytest_configure(config: pytest.Config) -> None:
    """Guard the backend of all tests."""
    install()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Any:
    """Fail the test during which a write outside of a buffer happened, or the one after it."""
    result = yield
    written = find_writes()
    assert not written, "; ".join(written)
    return result
