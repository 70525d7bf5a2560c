"""Checked memory: every buffer of the OpenCL backend lies between guards, and writes there are found.

- `install` gives the memory of buffers, which kernels use in place, `GUARD` bytes of a pattern before and
  behind.
- The backend's own padding behind a buffer, for loads that run past the end, holds the pattern too. Scratch
  memory is exactly as large as requested.
- `collect_writes` returns where the pattern has changed.

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

from rhi.backends.cl.cl_context import EMPTY, allocate_pages
from rhi.backends.cl.memory import cl_buffers, cl_textures, planes, pools
from rhi.backends.cl.raster import cl_queries

GUARD: Final = 1 << 14
PATTERN: Final = 0xB7
_flags: Final = cl.mem_flags
_Buffer: Final[Any] = cl.Buffer


class _Guarded:
    """Memory between guards. `size_requested`: its size in bytes; `whole`: with the guards."""

    def __init__(self, size: int) -> None:
        self.whole = allocate_pages(size + 2 * GUARD)
        self.whole[:] = PATTERN
        self.used = self.whole[GUARD : GUARD + size]
        self.used[:] = 0
        self.size_requested = size
        self.owner: weakref.ref[Any] | None = None

    def extend_guard(self, size_requested: int) -> None:
        """Make everything behind the first `size_requested` bytes part of the guard."""
        self.used[size_requested:] = PATTERN
        self.size_requested = size_requested

    def changed_guard_bytes(self) -> str:
        """Return where the pattern has changed; empty if it hasn't."""
        begin, end = GUARD, GUARD + self.size_requested
        offsets = np.concatenate(
            [np.flatnonzero(self.whole[:begin] != PATTERN), end + np.flatnonzero(self.whole[end:] != PATTERN)]
        )
        if not len(offsets):
            return ""
        first, last = (int(offset) - begin for offset in (offsets[0], offsets[-1]))
        return f"{len(offsets)} bytes from {first} to {last} of a buffer of {self.size_requested}"


_guarded_buffers: list[_Guarded] = []


class _GuardedBuffer(_Buffer):  # type: ignore[misc]
    """A buffer to which a weak reference can be made."""


def _guard(size: int, data: NDArray[Any]) -> _Guarded:
    guarded = _Guarded(size)
    guarded.used[: data.nbytes] = data.view(np.uint8)
    _guarded_buffers.append(guarded)
    return guarded


def _allocate_pages(size: int, data: NDArray[Any] = EMPTY) -> NDArray[np.uint8]:
    return _guard(size, data).used


def _allocate(context: cl.Context, size: int, data: NDArray[Any] = EMPTY) -> cl.Buffer:
    guarded = _guard(planes.round_to_grain(size) + planes.GRAIN, data)
    guarded.extend_guard(size)
    buffer = _GuardedBuffer(context, _flags.READ_WRITE | _flags.USE_HOST_PTR, hostbuf=guarded.used)
    guarded.owner = weakref.ref(buffer)
    return buffer


def _reserve(self: pools.Pool, size: int) -> int:
    """Reserve exactly `size` bytes, in new memory."""
    guarded = _guard(size, EMPTY)
    lent = guarded.used[:]  # held by the pool, then until the device has finished
    guarded.owner = weakref.ref(lent)
    self._in_flight.add(self._memory)
    self._memory, self.size, self._address = lent, size, lent.ctypes.data
    return self._address


def install(replace: Callable[[Any, str, Any], None] = setattr) -> None:
    """Guard all memory allocated from here on; `replace` sets an attribute, for instance
    `monkeypatch.setattr`."""
    _guarded_buffers.clear()
    for user in (cl_buffers, cl_textures):
        replace(user, "allocate", _allocate)
    replace(pools.Pool, "reserve", _reserve)
    for module in (pools, cl_queries):
        replace(module, "allocate_pages", _allocate_pages)


def collect_writes() -> list[str]:
    """Return the writes outside of buffers, each once."""
    messages = []
    for guarded in list(_guarded_buffers):
        message = guarded.changed_guard_bytes()
        if message:
            messages.append(message)
        if message or (guarded.owner is not None and guarded.owner() is None):
            _guarded_buffers.remove(guarded)
    return messages


def count_guarded() -> int:
    """Return the number of guarded buffers."""
    return len(_guarded_buffers)


# -- as a plugin ---------------------------------------------------------------------------------------------


def pytest_configure(config: pytest.Config) -> None:
    """Guard the backend of all tests."""
    install()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Any:
    """Fail the test during which a write outside of a buffer happened, or the one after it."""
    result = yield
    written = collect_writes()
    assert not written, "; ".join(written)
    return result
