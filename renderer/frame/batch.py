"""The only batch of a view's first pass: commands that are recorded once, and arguments that they refer to.

An algorithm that knows all visible objects before the first draw draws them in one batch. Which objects these are, and
their order, changes with the camera; how they are drawn doesn't. So the draws' arguments lie in a buffer, and the
commands depend only on their number: `none` records them once, `frustum` again when another number of objects is
visible in two frames in a row.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.visibility.repeated import RepeatedCommands
from rhi import DRAW, Buffer, Device, Encoder, IndirectDraws

__rhi_internal__ = True


class FrameBatch:
    """The draws of a frame that is one batch, on a device. The buffer is written when they differ from the last
    frame's."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._draws: NDArray[Any] | None = None  # of which the buffer has `_rows`, in this order
        self._rows = np.zeros(0, np.int64)
        self._buffer: Buffer | None = None
        self._commands = RepeatedCommands(device, "")

    def execute(
        self,
        key: tuple[object, ...],
        draws: NDArray[Any],
        parts: Sequence[NDArray[np.int64]],
        issue: Callable[[Encoder, list[IndirectDraws | None]], None],
    ) -> None:
        """Execute the commands that `issue` gives to an encoder; see `RepeatedCommands.execute`.

        Args:
            draws: (n,) of `rhi.DRAW`, one for each object; another array stands for another scene.
            parts: the rows (k,) of each part that is drawn by a command of its own; `issue` gets their arguments, None
                for an empty part.
        """
        if self._buffer is None or draws is not self._draws:
            self.destroy()
            self._buffer = self._device.buffer(len(draws), DRAW, label="batch")
            self._draws = draws
        rows = np.concatenate(parts)
        if not np.array_equal(rows, self._rows):
            self._buffer.write(draws[rows])
            self._rows = rows
        counts = [len(part) for part in parts]
        starts = np.cumsum([0, *counts[:-1]]).tolist()
        buffer = self._buffer

        def issue_batch(encoder: Encoder) -> None:
            arguments = [
                IndirectDraws(buffer, count, start * DRAW.itemsize) if count else None
                for start, count in zip(starts, counts, strict=True)
            ]
            issue(encoder, arguments)

        self._commands.execute((*key, *counts), issue_batch)

    def destroy(self) -> None:
        """Destroy the buffer, and drop the commands that refer to it."""
        self._commands.forget()
        self._rows = np.zeros(0, np.int64)
        if self._buffer is not None:
            self._buffer.destroy()
            self._buffer = None
