"""The first batch of a view, and its repetitions: commands that are recorded once, and arguments that they
refer to.

An algorithm that knows all visible objects before the first draw draws them in one batch. Which objects these
are, and their order, changes with the camera; how they are drawn doesn't. So the draws' arguments lie in a
buffer, and the commands depend only on their number, which is rounded up: the rest are draws of nothing. So
`none` records them once, and `frustum` mostly submits what it has recorded, although a moving camera sees
more objects or fewer in each frame. Further passes and the second eye draw the same objects, so they use the
same arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.shaders import DRAW_LISTS
from renderer.visibility.command_cache import CommandCache
from rhi import DRAW, Buffer, Device, Encoder, IndirectDraws

_STEP: Final = 32
"""The step to which the number of draws is rounded up. A draw of nothing takes no measurable time."""


class BatchCommands:
    """The commands that draw a batch, for one pass of a view after the other.

    Attributes:
        pass_index: the number of passes that this frame has drawn; 0 begins a frame.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._passes: list[CommandCache] = []
        self.pass_index = 0

    def next(self) -> CommandCache:
        """The commands of the next pass."""
        if self.pass_index == len(self._passes):
            self._passes.append(CommandCache(self._device, ""))
        self.pass_index += 1
        return self._passes[self.pass_index - 1]


class FrameBatch:
    """The draw arguments of a frame that is one batch, in a buffer that is written only if they change.

    Attributes:
        last_order: the last call of `order` and its result; None begins a frame, whose objects have moved.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._draws: NDArray[Any] | None = None  # of which the buffer has `_rows`, in this order
        self._with_nothing = np.zeros(0, DRAW)  # the same, and a draw of nothing
        self._rows = np.zeros(0, np.int64)
        self._written: Sequence[NDArray[np.int64]] | None = None  # the parts that these rows are of
        self._counts: list[int] = []
        self._starts: list[int] = []
        self._buffer: Buffer | None = None
        self.last_order: tuple[NDArray[np.int64], bytes, list[NDArray[np.int64]]] | None = None

    def order(
        self,
        object_indices: NDArray[np.int64],
        backward: NDArray[np.float64],
        arrange: Callable[[], list[NDArray[np.int64]]],
    ) -> list[NDArray[np.int64]]:
        """The result of `arrange` for these objects and direction to the viewer, computed once per frame."""
        key, cached = backward.tobytes(), self.last_order
        if cached is None or cached[0] is not object_indices or cached[1] != key:
            self.last_order = cached = object_indices, key, arrange()
        return cached[2]

    def execute(
        self,
        commands: CommandCache,
        key: tuple[object, ...],
        draws: NDArray[Any],
        parts: Sequence[NDArray[np.int64]],
        issue: Callable[[Encoder, list[IndirectDraws | None]], None],
    ) -> None:
        """Execute the commands that `issue` records with an encoder; see `CommandCache.execute`.

        Args:
            draws: (n,) of `rhi.DRAW`, one for each object; another array stands for another scene.
            parts: the rows (k,) of each part that is drawn by a command of its own; `issue` gets their
                arguments, None for an empty part.
        """
        room = len(draws) + _STEP * max(len(parts), DRAW_LISTS)
        if self._buffer is None or draws is not self._draws or room > self._buffer.count:
            self.destroy()
            self._buffer = self._device.buffer(room, DRAW, label="batch")
            self._draws, self._with_nothing = draws, np.append(draws, np.zeros(1, DRAW))
        if parts is not self._written:  # other passes and the second eye draw the same
            counts = self._counts = []
            for part in parts:
                counts.append(-(-len(part) // _STEP) * _STEP)
            *self._starts, count = accumulate(counts, initial=0)
            self._write_rows(self._buffer, parts, count)
            self._written = parts
        buffer, counts, starts = self._buffer, self._counts, self._starts  # other passes may change these

        def issue_batch(encoder: Encoder) -> None:
            arguments = [
                IndirectDraws(buffer, count, start * DRAW.itemsize) if count else None
                for start, count in zip(starts, counts, strict=True)
            ]
            issue(encoder, arguments)

        commands.execute((*key, buffer, *counts), issue_batch)

    def repeat(
        self, commands: CommandCache, key: tuple[object, ...], parts: Sequence[NDArray[np.int64]]
    ) -> bool:
        """`execute` recorded commands for other rows, if they draw as many as in the last frame; return whether they
        are executed."""
        buffer, counts = self._buffer, [-(-len(part) // _STEP) * _STEP for part in parts]
        if buffer is None or self._counts != counts:
            return False
        self._write_rows(buffer, parts, sum(counts))
        self._written = parts
        return commands.repeat((*key, buffer, *counts))

    def _write_rows(self, buffer: Buffer, parts: Sequence[NDArray[np.int64]], count: int) -> None:
        """Write `count` draws, those of the parts from `_starts` on, unless the buffer has them."""
        object_indices = np.empty(count, np.int64)
        object_indices.fill(len(self._with_nothing) - 1)  # a draw of nothing
        for part, start in zip(parts, self._starts, strict=True):
            object_indices[start : start + len(part)] = part
        if object_indices.tobytes() != self._rows.tobytes():
            # `take` is much faster than an index, and refuses indices of 64 bits where pointers have 32.
            buffer.write(self._with_nothing.take(np.asarray(object_indices, np.intp)))
            self._rows = object_indices

    def destroy(self) -> None:
        """Destroy the buffer."""
        self._rows, self._written = np.zeros(0, np.int64), None
        if self._buffer is not None:
            self._buffer.destroy()
            self._buffer = None
