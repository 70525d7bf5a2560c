"""Locks: a NumPy array for part of a resource, for the duration of a `with` block (thesis 4.1, Listing 4.1).

- READ copies from the device and waits for the work that may write there. WRITE copies to the device when the
  block ends and never waits. READ_WRITE does both. If the block raises, nothing is written.
- A locked resource can't be used by the device; every draw checks everything as long as there is a lock.
- The resource provides the functions that read, create and write the array.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from rhi.contract.descriptors import Access
from rhi.device.core.core import Owner, describe_object
from rhi.errors.device_objects import DeviceObject
from rhi.errors.rules import LOCK_CLOSED, LOCK_TWICE, RESOURCE_DESTROYED


class Lock(DeviceObject):
    """A `with buffer.lock(Access.WRITE) as array:` block; after it, and under READ, the array is
    read-only."""

    __slots__ = ("__weakref__", "_access", "_array", "_make", "_owner", "_read", "_write")

    def __init__(
        self,
        owner: Owner,
        access: Access,
        read: Callable[[], NDArray[Any]],
        make: Callable[[], NDArray[Any]],
        write: Callable[[NDArray[Any]], None],
    ) -> None:
        self._owner = owner
        self._access = access
        self._read = read
        self._make = make
        self._write = write
        self._array: NDArray[Any] | None = None

    def __enter__(self) -> NDArray[Any]:
        owner, core = self._owner, self._owner.core
        core.check_ready()
        if owner.destroyed:
            core.refuse(RESOURCE_DESTROYED, "lock", describe_object(owner))
        if core.is_locked(owner):
            core.refuse(LOCK_TWICE, "lock", describe_object(owner))
        array = self._read() if self._access.reads else self._make()
        array.flags.writeable = self._access.writes
        core.program = None  # from now on every draw checks whether it uses a locked resource
        self._array = array
        try:
            core.lock(owner, self)
        except BaseException:  # an interrupt; nobody will release it
            self._array = None
            core.unlock(self)
            raise
        return array

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        core = self._owner.core
        core.check_thread("the end of a lock")
        array, self._array = self._array, None
        if array is None:
            core.refuse(LOCK_CLOSED, "lock", "a lock that is not open")
        core.unlock(self)
        if kind is None and self._access.writes and not self._owner.destroyed and not core.closed:
            core.check_ready()
            self._write(array)
        array.flags.writeable = False
