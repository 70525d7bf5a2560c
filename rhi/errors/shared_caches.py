"""Locks of what the threads of a process share: compiled shaders, interned values, and caches of objects.

- Threads with devices of their own share classes. Whatever is derived from a class is made under `SHARED`, so
  all threads get the same object, and none sees half of it.
- The thread that has a lock may take it again. Nothing waits for another thread while it has one.
- Lookups of what exists take none: they read a dictionary once. So a thread that compiles stops no frame of
  another.
- A process is forked while no other thread has one, so that its child can compile.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import update_wrapper
from threading import RLock
from typing import TYPE_CHECKING, Any, Final, TypeVar

if TYPE_CHECKING:
    from _thread import RLock as SharedLock

_Function = TypeVar("_Function", bound=Callable[..., Any])
_NAMED: Final = object()  # begins the keys of calls with named arguments

_locks: Final[list[SharedLock]] = []
"""All locks, in the order in which a thread may take several."""
_taken: Final[list[SharedLock]] = []
"""The locks of the thread that forks."""


def make_shared_lock() -> SharedLock:
    """Return a lock that a forked child finds free. A thread that has it takes none that was made before."""
    lock = RLock()
    _locks.append(lock)
    return lock


SHARED: Final = make_shared_lock()
"""Held while anything is compiled or derived from classes."""


def _take_all() -> None:
    for lock in list(_locks):
        lock.acquire()
        _taken.append(lock)


def _give_all() -> None:
    locks = list(_taken)
    _taken.clear()  # before another thread that forks gets the first
    for lock in reversed(locks):
        lock.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_take_all, after_in_parent=_give_all, after_in_child=_give_all)


def cache_once(function: _Function) -> _Function:
    """Cache a function like `functools.cache`, but call it once for equal arguments.

    Threads that call a function of `functools.cache` at the same moment get results of their own, such as two
    classes.
    """
    results: dict[Any, Any] = {}

    def call(*arguments: Any, **named: Any) -> Any:
        key = (_NAMED, arguments, *named.items()) if named else arguments
        try:
            return results[key]
        except KeyError:
            pass
        with SHARED:
            if key not in results:
                results[key] = function(*arguments, **named)
            return results[key]

    wrapped: Any = update_wrapper(call, function)
    wrapped.cache_clear = results.clear
    result: _Function = wrapped
    return result
