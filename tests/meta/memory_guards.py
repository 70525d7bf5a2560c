"""Checked memory: every buffer of the OpenCL backend lies between guards, and writes there are found.

- `install` gives the memory of buffers, which kernels use in place, `GUARD` bytes of a pattern before and behind.
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

from rhi.backends.cl.context import NOTHING, allocate_pages
from rhi.backends.cl.memory import buffers, planes, pools, textures
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
    """A buffer to which a weak reference can be made."""


def _guard(size: int, contents: NDArray[Any]) -> _Guarded:
    made = _Guarded(size)
    made.used[: contents.nbytes] = contents.view(np.uint8)
    _known.append(made)
    return made


def _allocate_pages(size: int, contents: NDArray[Any] = NOTHING) -> NDArray[np.uint8]:
    return _guard(size, contents).used


def _allocate(context: cl.Context, size: int, contents: NDArray[Any] = NOTHING) -> cl.Buffer:
    made = _guard(planes.round_to_grain(size) + planes.GRAIN, contents)
    made.keep_free(size)
    buffer = _GuardedBuffer(context, _flags.READ_WRITE | _flags.USE_HOST_PTR, hostbuf=made.used)
    made.owner = weakref.ref(buffer)
    return buffer


def _reserve(self: pools.Pool, size: int) -> int:
    """Reserve exactly `size` bytes, in new memory."""
    made = _guard(size, NOTHING)
    lent = made.used[:]  # held by the pool, then until the device has finished
    made.owner = weakref.ref(lent)
    self._in_flight.add(self._memory)
    self._memory, self.size, self._address = lent, size, lent.ctypes.data
    return self._address


def install(replace: Callable[[Any, str, Any], None] = setattr) -> None:
    """Guard all memory allocated from here on; `replace` sets an attribute, for instance `monkeypatch.setattr`."""
    _known.clear()
    for user in (buffers, textures):
        replace(user, "allocate", _allocate)
    replace(pools.Pool, "reserve", _reserve)
    for module in (pools, queries):
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
