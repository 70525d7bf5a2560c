"""Readbacks: futures of reads from textures and buffers, to be polled, waited for or awaited.

`Texture.read_async` and `Buffer.read_async` copy on the device, in the order of the commands, and return at
once. So what is changed or destroyed afterwards doesn't affect the result.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Id
from rhi.device.core.core import Core
from rhi.device.core.event_loop import pause_until
from rhi.errors.device_objects import DeviceObject


class Readback(DeviceObject):
    """The future of a read: `done` polls, `result` waits, and `await` waits beside other tasks of asyncio.

    Attributes:
        fence: the fence value after which the result is available, as in `device.completed` and
            `device.wait`.
    """

    __slots__ = (
        "__weakref__",
        "_array",
        "_core",
        "_dtype",
        "_lowest",
        "_memory",
        "_row_bytes",
        "_rows",
        "_shape",
        "fence",
    )

    def __init__(
        self,
        core: Core,
        dtype: np.dtype[Any],
        shape: tuple[int, ...],
        rows: int = 1,
        row_bytes: int = 0,
        lowest: int | None = None,
    ) -> None:
        """Prepare a read of an array, whose `rows` rows begin `row_bytes` apart. Numbers below `lowest` are
        read as `lowest`."""
        self._core = core
        self._dtype = dtype
        self._shape = shape
        self._rows = rows
        self._row_bytes = row_bytes
        self._lowest = lowest
        self._array: NDArray[Any] | None = None
        self._memory: Id = 0
        self.fence = core.timeline.signalled

    def __repr__(self) -> str:
        # `asyncio.wrap_future` refuses what isn't from concurrent.futures by an assertion, which shows this.
        state = "fetched" if self._array is not None else f"fence {self.fence}"
        return f"Readback({state}; await it, or pass it to asyncio.ensure_future)"

    @property
    def done(self) -> bool:
        """True if `result` returns without waiting. Never blocks."""
        if self._array is not None:
            return True
        self._core.check_ready()
        return self._core.timeline.completed >= self.fence

    def result(self) -> NDArray[Any]:
        """Return the array, waiting for the device if it isn't `done`. Later calls return the same array.

        Raises:
            ValidationError: `device-closed` if the device was closed before the first call.
        """
        if self._array is None:
            self.fetch()
        assert self._array is not None
        return self._array

    def __await__(self) -> Generator[Any, None, NDArray[Any]]:
        """Wait for the array without blocking the event loop: `texels = await texture.read_async()`.

        Under asyncio other tasks run meanwhile; without its loop, this waits as `result` does. The loop runs
        on the device's thread. `asyncio.gather`, `wait_for` and `ensure_future` take a readback as it is;
        `wrap_future` doesn't, because only threads complete what it takes. A cancelled wait leaves the
        readback as it was: it can be awaited again.

        Raises:
            ValidationError: as `result`.
        """
        yield from pause_until(lambda: self.done)
        return self.result()

    def take_memory(self) -> Id:
        """Return the buffer that the device copies into."""
        self._memory = self._core.readbacks.take(self, self._rows * self._row_bytes)
        return self._memory

    def begin(self) -> None:
        """Signal the fence behind the copy."""
        self.fence = self._core.signal()

    def complete(self, array: NDArray[Any]) -> None:
        """Set the result."""
        if self._lowest is not None:
            array = np.maximum(array, self._dtype.type(self._lowest))
        self._array = array.reshape(self._shape)

    def fetch(self) -> None:
        """Wait for the result, copy it from the pool's buffer, and give the buffer back."""
        core = self._core
        core.check_ready()
        core.timeline.wait(self.fence)
        data = core.backend.read_buffer(self._memory, 0, self._rows * self._row_bytes)
        size = self._dtype.itemsize * int(np.prod(self._shape)) // self._rows
        rows = np.frombuffer(data, np.uint8).reshape(self._rows, self._row_bytes)[:, :size]
        self.complete(rows.copy().reshape(-1).view(self._dtype))
        core.readbacks.give_back(self._memory)
